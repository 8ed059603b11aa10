"""The candidates of a result, with the quantities that all export formats need."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from localizer.dem.geodesy import map_metres_at, metric_to_lonlat, rowcol_to_lonlat, rowcol_to_metric
from localizer.dem.ground import MapMetres
from localizer.dem.lattice import Dem
from localizer.fix import EllipseAxes, Status, ellipse
from localizer.search.details import LocateResult
from localizer.show.text import CHI2_95

RING_POINTS = 72


@dataclass(frozen=True)
class CandidatePlace:
    """One candidate; ``rank`` 1 is the most probable, the position of the fix."""

    rank: int
    row: float
    col: float
    easting_m: float
    northing_m: float
    lat_deg: float
    lon_deg: float
    ground_m: float
    """NaN beyond the DEM's outermost cell centres."""
    covariance_m2: NDArray[np.float64]
    """(2, 2) of easting and northing, metres of the ground."""
    here: MapMetres
    """Scale and convergence of the map there."""
    probability: float
    rms_px: float
    axes: EllipseAxes
    azimuth_deg: float
    """Of the ellipse's major axis, from true north, 0 to 180."""


def places(result: LocateResult, dem: Dem) -> tuple[CandidatePlace, ...]:
    """All places of a result by rank; none where its status is "none"."""
    out = []
    details = result.details
    for i, (candidate, (row, col), covariance_m2) in enumerate(
        zip(result.fix.candidates, details.candidates_rowcol, details.candidate_covariances_m2, strict=True)
    ):
        easting_m, northing_m = rowcol_to_metric(dem, row, col)
        lon_deg, lat_deg = rowcol_to_lonlat(dem, row, col)
        (ee, en), (ne, nn) = covariance_m2.tolist()
        axes = ellipse(((ee, en), (ne, nn)))
        here = map_metres_at(dem, float(row), float(col))
        out.append(
            CandidatePlace(
                rank=i + 1,
                row=float(row),
                col=float(col),
                easting_m=float(easting_m),
                northing_m=float(northing_m),
                lat_deg=float(lat_deg),
                lon_deg=float(lon_deg),
                ground_m=float(dem.ground_m(row, col)),
                covariance_m2=covariance_m2,
                here=here,
                probability=candidate.probability,
                rms_px=candidate.rms_px,
                axes=axes,
                azimuth_deg=(axes.grid_azimuth_deg + here.convergence_deg) % 180.0,
            )
        )
    return tuple(out)


def ellipse_ring_m(place: CandidatePlace) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Eastings and northings (RING_POINTS,) of the ellipse that holds 95 %, in the map's own metres.

    Counter-clockwise, not closed.
    """
    angle = np.linspace(0.0, 2.0 * np.pi, RING_POINTS, endpoint=False)
    variances, axes = np.linalg.eigh(place.covariance_m2)
    axes[:, 0] *= np.sign(np.linalg.det(axes))  # a mirrored pair would run clockwise
    along = np.sqrt(CHI2_95 * np.clip(variances, 0.0, None))[:, None] * [np.cos(angle), np.sin(angle)]
    east_m, north_m = place.here.map_from_ground @ axes @ along
    return place.easting_m + east_m, place.northing_m + north_m


def ellipse_ring_lonlat(place: CandidatePlace, dem: Dem) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The same ring in WGS84 longitudes, -180 <= lon < 180, and latitudes, the accuracy of the operation between the datums
    included.
    """
    wider = replace(place, covariance_m2=place.covariance_m2 + dem.lonlat_accuracy_m**2 * np.eye(2))
    return metric_to_lonlat(dem, *ellipse_ring_m(wider))


def place_name(place: CandidatePlace, status: Status, count: int, bundle: str) -> str:
    """The label of the place on a map. Only a fix is called one, since a map often shows nothing but the label."""
    if status == "fix":
        return f"fix {bundle}"
    return f"candidate {place.rank} of {count} (ambiguous) {bundle}"


def place_description(place: CandidatePlace, status: Status) -> str:
    """Status, uncertainty and probability in a line."""
    return (
        f"status {status}; 1 sigma {place.axes.major_m:.1f} m x {place.axes.minor_m:.1f} m, the longer towards "
        f"{place.azimuth_deg:.0f} deg true; probability {place.probability:.3f}; rms {place.rms_px:.2f} px"
    )
