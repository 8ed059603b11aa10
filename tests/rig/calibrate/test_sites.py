"""A far skyline determines the boresight better, and ``rig calibrate sites`` finds such places."""

import numpy as np
import pytest
from affine import Affine
from numpy.typing import NDArray
from pyproj import CRS

from localizer.dem.lattice import dem_from_array
from rig.calibrate.boresight.dem_error_model import covariance_deg2, fit_dem_error_model
from rig.calibrate.boresight.known_place import KnownPlace, PlaceSigmas
from rig.calibrate.boresight.sites import AZIMUTHS_DEG, SPACING_M, _apart_m, best_sites, expected_sigmas_deg
from rig.config.calibration_files import CalibrationError

Vector = NDArray[np.float64]

SIGMAS = PlaceSigmas(4.0, 1.5, 1.5)
CELL_M = 30.0
LATTICE = Affine(CELL_M, 0.0, 560000.0, 0.0, -CELL_M, 5119000.0)


def rugged(distance_m: float) -> tuple[Vector, Vector]:
    rng = np.random.default_rng(1)
    elevation = 5.0 + sum(
        rng.normal(0.0, 1.5) * np.sin(np.radians(k * AZIMUTHS_DEG) + rng.uniform(0.0, 6.28))
        for k in range(1, 30)
    )
    return elevation, np.full(len(AZIMUTHS_DEG), distance_m) * np.exp(rng.normal(0.0, 0.3, len(AZIMUTHS_DEG)))


def test_far_ridges_tell_more() -> None:
    near, far = (expected_sigmas_deg(*rugged(d), SIGMAS) for d in (200.0, 6000.0))
    assert far[0] < 0.5 * near[0]
    assert far[1] < 0.2 * near[1]
    assert far[1] < 0.02 < near[1]


def test_points_of_one_ridge_err_alike_and_of_others_do_not() -> None:
    azimuth, distance = np.array([10.0, 10.2, 200.0]), np.array([2000.0, 2000.0, 40000.0])
    covariance = covariance_deg2(np.ones(3), azimuth, distance)
    assert np.diag(covariance) == pytest.approx([1.0, 1.0, 1.0])
    assert covariance[0, 1] > 0.9
    assert covariance[0, 2] < 0.02


def test_the_error_of_the_dem_is_found_from_what_is_left() -> None:
    rng = np.random.default_rng(4)
    azimuth = np.arange(0.0, 360.0, 1.0)
    distance = np.exp(rng.uniform(np.log(300.0), np.log(8000.0), len(azimuth)))
    told = np.degrees(1.5 / distance)
    alike = covariance_deg2(told, azimuth, distance)
    image = np.full(len(azimuth), 0.03)
    residuals = 3.0 * np.linalg.cholesky(alike) @ rng.normal(size=len(azimuth)) + image * rng.normal(
        size=len(azimuth)
    )
    found = fit_dem_error_model(residuals, image, told, alike)
    assert 2.0 < found.dem_factor < 4.5
    assert np.std(found.whiten @ residuals) == pytest.approx(1.0, abs=0.25)


def basin(rim_m: float) -> KnownPlace:
    """A wide basin with gentle ground, and a rugged rim round its middle."""
    rows, cols = np.mgrid[-150:150, -150:150] * CELL_M
    radius, angle = np.hypot(rows, cols), np.arctan2(cols, rows)
    height = (
        100.0
        + 0.02 * radius
        + np.where(np.abs(radius - 2500.0) < 200.0, rim_m * (2.0 + np.sin(7 * angle)), 0.0)
    )
    dem = dem_from_array(height.astype(np.float32), LATTICE, CRS.from_epsg(32610))
    middle = float(dem.ground_m(150.0, 150.0))
    return KnownPlace(46.1, -122.2, dem, 150.0, 150.0, middle)


def test_sites_are_inside_apart_and_best_first() -> None:
    near = basin(100.0)
    sites = best_sites(near, 1500.0, 2.0, SIGMAS, 3)
    assert len(sites) == 3
    assert all(_apart_m(a, b) >= SPACING_M for i, a in enumerate(sites) for b in sites[:i])
    assert sites[0].tilt_sigma_deg < 0.05
    assert all(site.far_share > 0.3 for site in sites)


def test_a_plain_without_skyline_has_no_site() -> None:
    near = basin(100.0)
    flat = dem_from_array(np.full((300, 300), 10.0, np.float32), LATTICE, CRS.from_epsg(32610))
    with pytest.raises(CalibrationError, match="no place within"):
        best_sites(KnownPlace(46.1, -122.2, flat, 150.0, 150.0, near.ground_m), 1500.0, 2.0, SIGMAS, 3)
