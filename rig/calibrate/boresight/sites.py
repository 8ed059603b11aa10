"""Recommends places for the boresight calibration: drivable, ranked by how well their skyline determines azimuth and
tilt.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pyproj import Geod

from localizer.dem.geodesy import enu_to_metric_jacobian, metric_to_rowcol, rowcol_to_lonlat, rowcol_to_metric
from localizer.dem.horizon import horizon, prepare_terrain
from localizer.dem.lattice import Dem
from rig.calibrate.boresight.dem_error_model import covariance_deg2
from rig.calibrate.boresight.horizon_profile import NEAREST_M
from rig.calibrate.boresight.known_place import KnownPlace, PlaceSigmas
from rig.config.calibration_files import CalibrationError

Vector = NDArray[np.float64]

_GEOD = Geod(ellps="WGS84")
CANDIDATES = 300
STEEPEST_DEG = 12.0
AZIMUTHS_DEG = np.arange(0.0, 360.0, 1.5)
IMAGE_SIGMA_DEG = 0.05
FROM_EDGE_M = 1000.0
ENCLOSED = 0.9  # share of the skyline: beyond the DEM's edge higher ridges may be hidden
FAR_M = 1000.0
SPACING_M = 300.0
GOOD_SIGMAS_DEG = (0.05, 0.02)  # sigmas of azimuth and tilt of a good site
GOLDEN_ANGLE = np.pi * (3.0 - np.sqrt(5.0))


@dataclass(frozen=True)
class Site:
    """A place, its ground height, the expected sigmas of azimuth sum and tilt, and the share of far ridges."""

    lat_deg: float
    lon_deg: float
    ground_m: float
    azimuth_sigma_deg: float
    tilt_sigma_deg: float
    far_share: float


def best_sites(
    near: KnownPlace, within_m: float, mast_height_m: float, sigmas: PlaceSigmas, count: int
) -> list[Site]:
    """The best places within ``within_m``, spaced apart, best first. ``CalibrationError`` if there is none."""
    dem = near.dem
    rows, cols = _candidates(near, within_m)
    ground_m = dem.ground_m(rows, cols)
    distances, elevations = _skylines(dem, rows, cols, ground_m + mast_height_m)
    sites: list[Site] = []
    for i in range(len(rows)):
        if _enclosed_share(dem, float(rows[i]), float(cols[i]), distances[i]) < ENCLOSED:
            continue
        azimuth_deg, tilt_deg = expected_sigmas_deg(elevations[i], distances[i], sigmas)
        lon, lat = rowcol_to_lonlat(dem, rows[i], cols[i])
        far = float(np.mean(~(distances[i] < FAR_M)))
        sites.append(Site(float(lat), float(lon), float(ground_m[i]), azimuth_deg, tilt_deg, far))
    if not sites:
        raise CalibrationError(
            f"no place within {within_m / 1000.0:g} km has ground that a vehicle can stand on and a skyline inside the DEM; "
            "look further with --within, or take a larger DEM"
        )
    return _apart(sorted(sites, key=_rank), count)


def expected_sigmas_deg(
    elevation_deg: Vector, distance_m: Vector, sigmas: PlaceSigmas
) -> tuple[float, float]:
    """Expected sigmas of azimuth and tilt from one full turn over the skyline at ``AZIMUTHS_DEG``; NaN without a
    skyline.
    """
    seen = np.isfinite(elevation_deg) & np.isfinite(distance_m)
    step_deg = AZIMUTHS_DEG[1] - AZIMUTHS_DEG[0]
    slope = ((np.roll(elevation_deg, -1) - np.roll(elevation_deg, 1)) / (2.0 * step_deg))[seen]
    seen_slope = np.nan_to_num(slope)
    azimuth, elevation = np.radians(AZIMUTHS_DEG[seen]), np.radians(elevation_deg[seen])
    distance = np.maximum(distance_m[seen], NEAREST_M)
    across = np.sqrt(1.0 + (seen_slope / np.cos(elevation)) ** 2)
    by_metre = np.degrees(1.0 / distance)
    # A step towards a ridge raises it; a step sideways shifts it along the skyline.
    east = by_metre * (np.tan(elevation) * np.sin(azimuth) + seen_slope * np.cos(azimuth))
    north = by_metre * (np.tan(elevation) * np.cos(azimuth) - seen_slope * np.sin(azimuth))
    design = np.column_stack([-seen_slope, np.ones(len(distance)), east, north, -by_metre]) / across[:, None]
    alike = covariance_deg2(
        np.degrees(sigmas.dem_m / distance) / across, AZIMUTHS_DEG[seen], distance_m[seen]
    )
    weight = np.linalg.inv(alike + np.eye(len(distance)) * IMAGE_SIGMA_DEG**2)
    known = np.array([1e-6, 1e-6, sigmas.horizontal_m**-2, sigmas.horizontal_m**-2, sigmas.altitude_m**-2])
    covariance = np.linalg.inv(design.T @ weight @ design + np.diag(known))
    return float(np.sqrt(covariance[0, 0])), float(np.sqrt(covariance[1, 1]))


def _candidates(near: KnownPlace, within_m: float) -> tuple[Vector, Vector]:
    """Rows and columns of places spread evenly over the disc, excluding steep ground and water (flat)."""
    dem = near.dem
    number = np.arange(CANDIDATES)
    radius_m = within_m * np.sqrt(number / CANDIDATES)
    steps_m = radius_m[:, None] * np.column_stack(
        [np.sin(number * GOLDEN_ANGLE), np.cos(number * GOLDEN_ANGLE)]
    )
    x, y = rowcol_to_metric(dem, near.row, near.col)
    to_metric = enu_to_metric_jacobian(dem, near.row, near.col).T
    aside = steps_m @ to_metric
    rows, cols = metric_to_rowcol(dem, float(x) + aside[:, 0], float(y) + aside[:, 1])
    height = dem.ground_m(rows, cols)
    south = (dem.ground_m(rows + 1.0, cols) - dem.ground_m(rows - 1.0, cols)) / (2.0 * abs(dem.spacing_ns_m))
    east = (dem.ground_m(rows, cols + 1.0) - dem.ground_m(rows, cols - 1.0)) / (2.0 * abs(dem.spacing_ew_m))
    slope_deg = np.degrees(np.arctan(np.hypot(south, east)))
    fit = np.isfinite(height) & (slope_deg > 0.0) & (slope_deg < STEEPEST_DEG)
    return np.asarray(rows[fit]), np.asarray(cols[fit])


def _skylines(dem: Dem, rows: Vector, cols: Vector, altitude_m: Vector) -> tuple[Vector, Vector]:
    if not len(rows):
        return np.empty((0, len(AZIMUTHS_DEG))), np.empty((0, len(AZIMUTHS_DEG)))
    elevation, distance = horizon(prepare_terrain(dem), rows, cols, altitude_m, AZIMUTHS_DEG)
    return np.asarray(distance), np.asarray(elevation)


def _enclosed_share(dem: Dem, row: float, col: float, distance_m: Vector) -> float:
    """Share of the skyline that is terrain at least ``FROM_EDGE_M`` inside the DEM."""
    azimuth = np.radians(AZIMUTHS_DEG)
    reach_m = np.where(np.isfinite(distance_m), distance_m, 0.0) + FROM_EDGE_M
    x, y = rowcol_to_metric(dem, row, col)
    aside = enu_to_metric_jacobian(dem, row, col) @ (reach_m * np.stack([np.sin(azimuth), np.cos(azimuth)]))
    rows, cols = metric_to_rowcol(dem, float(x) + aside[0], float(y) + aside[1])
    inside = (rows >= 0.0) & (rows <= dem.rows - 1.0) & (cols >= 0.0) & (cols <= dem.cols - 1.0)
    return float(np.mean(inside & np.isfinite(distance_m)))


def _rank(site: Site) -> float:
    return float(
        np.hypot(site.azimuth_sigma_deg / GOOD_SIGMAS_DEG[0], site.tilt_sigma_deg / GOOD_SIGMAS_DEG[1])
    )


def _apart(sites: Sequence[Site], count: int) -> list[Site]:
    """The first sites of the list that are not near a better one."""
    chosen: list[Site] = []
    for site in sites:
        if len(chosen) < count and all(_apart_m(site, other) >= SPACING_M for other in chosen):
            chosen.append(site)
    return chosen


def _apart_m(site: Site, other: Site) -> float:
    return float(_GEOD.inv(site.lon_deg, site.lat_deg, other.lon_deg, other.lat_deg)[2])
