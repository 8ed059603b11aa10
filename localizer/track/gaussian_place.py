"""Gaussian places, in metres to true east and north about a point on WGS84, and their fusion by split covariance intersection.

Measurements from neighbouring places share errors of the DEM, the lens and refraction. Fused as independent ones, ten of them
would claim a third of the error of one. Each covariance therefore has a *common* part, whose correlation with that of other
places is unknown, and an independent rest. Split covariance intersection (Julier and Uhlmann, "General decentralized data
fusion with covariance intersection", 2001) is consistent for any such correlation.
"""

from typing import Annotated, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator
from pyproj import Geod

from localizer.dem.crs import wrapped_lon_deg

Floats = NDArray[np.float64]
Matrix = tuple[tuple[float, float], tuple[float, float]]

GEOD = Geod(ellps="WGS84")
LEAST_WEIGHT = 1e-3
"""Least weight of either place in a fusion."""
LOG_AREA_TOLERANCE = 1e-6
"""Areas whose logarithms differ by less count as equal."""


class GaussianPlace(BaseModel):
    """A place with its covariance, of true (east, north), square metres."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    lat_deg: Annotated[float, Field(ge=-90.0, le=90.0)]
    lon_deg: Annotated[float, AfterValidator(wrapped_lon_deg)]
    covariance_enu_m2: Matrix
    common_enu_m2: Matrix = ((0.0, 0.0), (0.0, 0.0))
    """The part of ``covariance_enu_m2`` that other measurements may have in common."""

    @model_validator(mode="after")
    def _covariances(self) -> Self:
        whole, common = np.array(self.covariance_enu_m2), np.array(self.common_enu_m2)
        slack = 1e-9 * max(1.0, float(np.abs(whole).max()))
        for matrix in (whole, common, whole - common):
            if abs(matrix[0, 1] - matrix[1, 0]) > slack or np.linalg.eigvalsh(matrix)[0] < -slack:
                raise ValueError("a covariance is symmetric and positive, and holds its common part")
        return self

    @property
    def covariance(self) -> Floats:
        """(2, 2), square metres of true east and north."""
        return np.array(self.covariance_enu_m2)

    @property
    def common(self) -> Floats:
        """(2, 2), square metres: the common part."""
        return np.array(self.common_enu_m2)

    @property
    def widest_m(self) -> float:
        """The largest standard deviation in any direction."""
        return float(np.sqrt(np.linalg.eigvalsh(self.covariance)[-1]))


def gaussian_place(lat_deg: float, lon_deg: float, covariance: Floats, common: Floats) -> GaussianPlace:
    """A place from arrays (2, 2)."""
    return GaussianPlace(
        lat_deg=lat_deg, lon_deg=lon_deg, covariance_enu_m2=matrix(covariance), common_enu_m2=matrix(common)
    )


def matrix(values: Floats) -> Matrix:
    """Symmetric and as plain numbers; ``values`` (2, 2)."""
    off = float(values[0, 1] + values[1, 0]) / 2.0
    return (float(values[0, 0]), off), (off, float(values[1, 1]))


def offset_m(start: GaussianPlace, end: GaussianPlace) -> Floats:
    """(2,): metres to true east and north from one place's centre to another's."""
    azimuth_deg, _, distance_m = GEOD.inv(start.lon_deg, start.lat_deg, end.lon_deg, end.lat_deg)
    azimuth = np.radians(azimuth_deg)
    return np.asarray(distance_m * np.array([np.sin(azimuth), np.cos(azimuth)]), np.float64)


def displaced(start: GaussianPlace, step_m: Floats, covariance: Floats) -> GaussianPlace:
    """The place after a step (2,) east and north that is known to ``covariance`` (2, 2)."""
    lat_deg, lon_deg = _point(start, step_m)
    return gaussian_place(lat_deg, lon_deg, start.covariance + covariance, start.common)


def log_density(start: GaussianPlace, end: GaussianPlace, model_error_m: float) -> float:
    """Log density, per square metre, of both being one place; ``model_error_m``: an additional standard deviation."""
    spread = start.covariance + end.covariance + model_error_m**2 * np.eye(2)
    off = offset_m(start, end)
    return float(
        -0.5 * off @ np.linalg.solve(spread, off) - 0.5 * np.linalg.slogdet(spread)[1] - np.log(2.0 * np.pi)
    )


def fuse(first: GaussianPlace, second: GaussianPlace) -> GaussianPlace:
    """The fusion of two estimates of one place. Its ellipse is no larger than that of either."""
    from scipy.optimize import minimize_scalar  # slow to import, and large in memory

    own = [p.covariance - p.common for p in (first, second)]
    common = [first.common, second.common]

    def fused(share: float) -> tuple[Floats, Floats, Floats]:
        """The gain towards the second, the covariance and its common part, the first having this share."""
        one, two = common[0] / share + own[0], common[1] / (1.0 - share) + own[1]
        gain = one @ np.linalg.inv(one + two)
        stay = np.eye(2) - gain
        whole = stay @ one @ stay.T + gain @ two @ gain.T
        return gain, whole, whole - stay @ own[0] @ stay.T - gain @ own[1] @ gain.T

    def area(share: float) -> float:
        return float(np.linalg.slogdet(fused(share)[1])[1])

    # if everything is common, all weights can give the same area: prefer equal weights
    share = float(
        minimize_scalar(
            lambda share: area(share) + LOG_AREA_TOLERANCE * (share - 0.5) ** 2,
            bounds=(LEAST_WEIGHT, 1.0 - LEAST_WEIGHT),
            method="bounded",
        ).x
    )
    for alone in sorted((first, second), key=lambda p: float(np.linalg.det(p.covariance))):
        if np.linalg.slogdet(alone.covariance)[1] < area(share) - LOG_AREA_TOLERANCE:
            return alone
    gain, whole, shared = fused(share)
    lat_deg, lon_deg = _point(first, gain @ offset_m(first, second))
    return gaussian_place(lat_deg, lon_deg, whole, shared)


def merged(places: list[GaussianPlace], weights: list[float]) -> GaussianPlace:
    """One Gaussian with the mean and the covariance of a mixture."""
    share = np.array(weights) / np.sum(weights)
    offsets = np.array([offset_m(places[0], p) for p in places])
    mean = share @ offsets
    spread = offsets - mean
    covariance = np.einsum("k,kij->ij", share, [p.covariance for p in places])
    common = np.einsum("k,kij->ij", share, [p.common for p in places])
    lat_deg, lon_deg = _point(places[0], mean)
    return gaussian_place(lat_deg, lon_deg, covariance + (spread.T * share) @ spread, common)


def _point(start: GaussianPlace, step_m: Floats) -> tuple[float, float]:
    """Latitude and longitude a step (2,) to the east and north of a place's centre."""
    azimuth_deg = float(np.degrees(np.arctan2(step_m[0], step_m[1])))
    lon_deg, lat_deg, _ = GEOD.fwd(start.lon_deg, start.lat_deg, azimuth_deg, float(np.hypot(*step_m)))
    return float(lat_deg), wrapped_lon_deg(lon_deg)
