"""The DEM's skyline around one place, and its derivatives by position."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d

from localizer.dem.geodesy import enu_to_metric_jacobian, metric_to_rowcol, rowcol_to_metric
from localizer.dem.horizon import at_dem_edge, horizon, prepare_terrain
from rig.calibrate.boresight.known_place import KnownPlace
from rig.config.calibration_files import CalibrationError

Vector = NDArray[np.float64]

STEP_DEG = 0.02
ASIDE_M = 5.0
NEAREST_M = 30.0  # nearer terrain is too inaccurate to be a reference
OPEN_LIMIT = 0.5
END_MARGIN_DEG = 1.0


@dataclass(frozen=True)
class HorizonProfile:
    """Elevation and distance (m,) at equally spaced azimuths from north; derivatives (3, m) by metres east, north, up.

    ``at_end`` (m,): whether the skyline lies at the DEM's edge, so that the real one may be farther.
    """

    elevation_deg: Vector
    distance_m: Vector
    by_place: Vector
    at_end: NDArray[np.bool_]

    def elevation(self, azimuth_deg: Vector) -> Vector:
        """Elevation at any azimuths (n,)."""
        return self._between(self.elevation_deg, azimuth_deg)

    def distance(self, azimuth_deg: Vector) -> Vector:
        """Distance of the ridge (n,), metres, at any azimuths (n,)."""
        return self._between(self.distance_m, azimuth_deg)

    def ends(self, azimuth_deg: Vector) -> NDArray[np.bool_]:
        """Whether the skyline (n,) lies at the DEM's edge near these azimuths."""
        widened = maximum_filter1d(self.at_end, round(2.0 * END_MARGIN_DEG / STEP_DEG) + 1, mode="wrap")
        return np.asarray(self._between(widened.astype(float), azimuth_deg) > 0.0)

    def at(self, azimuth_deg: Vector, off_m: Vector, dem_sigma_m: float) -> tuple[Vector, Vector, Vector]:
        """Elevation from a position shifted by (3,) metres, its slope along azimuth, and its sigma from the DEM's
        height error.
        """
        profile = self.elevation_deg + off_m @ self.by_place
        slope = (np.roll(profile, -1) - np.roll(profile, 1)) / (2.0 * STEP_DEG)
        sigma = np.degrees(dem_sigma_m / np.maximum(self.distance_m, NEAREST_M))
        return (
            self._between(profile, azimuth_deg),
            self._between(slope, azimuth_deg),
            self._between(sigma, azimuth_deg),
        )

    def _between(self, values: Vector, azimuth_deg: Vector) -> Vector:
        place = (azimuth_deg % 360.0) / STEP_DEG
        before = np.floor(place).astype(np.int64)
        share = place - before
        count = len(values)
        return np.asarray((1.0 - share) * values[before % count] + share * values[(before + 1) % count])


def horizon_profile(place: KnownPlace, altitude_m: float) -> HorizonProfile:
    """The profile seen from ``altitude_m``. ``CalibrationError`` if the DEM ends before the skyline."""
    terrain = prepare_terrain(place.dem)
    azimuths_deg = np.arange(0.0, 360.0, STEP_DEG)
    x, y = rowcol_to_metric(place.dem, place.row, place.col)
    jacobian = enu_to_metric_jacobian(place.dem, place.row, place.col)
    steps_m = ASIDE_M * np.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    aside = steps_m @ jacobian.T
    rows, cols = metric_to_rowcol(place.dem, float(x) + aside[:, 0], float(y) + aside[:, 1])
    elevation, distance = horizon(terrain, rows, cols, np.full(len(rows), altitude_m), azimuths_deg)
    nowhere = np.isnan(distance[0])
    at_end = at_dem_edge(terrain, place.row, place.col, np.radians(azimuths_deg), distance[0])
    open_share = float(np.mean(at_end))
    if open_share > OPEN_LIMIT:
        raise CalibrationError(
            f"the DEM ends before or at the skyline in {open_share:.0%} of the directions at --at; take a larger one"
        )
    seen_m = np.where(nowhere, 1e6, distance[0])
    up = -np.degrees(1.0 / seen_m) * np.cos(np.radians(elevation[0])) ** 2
    east = (elevation[1] - elevation[2]) / (2.0 * ASIDE_M)
    north = (elevation[3] - elevation[4]) / (2.0 * ASIDE_M)
    # No derivative where a step sideways reveals another ridge.
    limit = 4.0 * np.abs(up) + np.degrees(1.0 / seen_m)
    by_place = np.stack([np.clip(east, -limit, limit), np.clip(north, -limit, limit), up])
    return HorizonProfile(elevation[0], seen_m, by_place, at_end)
