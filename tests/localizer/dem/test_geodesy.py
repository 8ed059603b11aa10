import time

import numpy as np
import pytest
from affine import Affine
from hypothesis import given
from hypothesis import strategies as st
from pyproj import CRS, Proj

from localizer.dem.crs import own_lonlat_deg, own_xy
from localizer.dem.geodesy import (
    enu_to_metric_jacobian,
    geod,
    geodesic_expansion,
    lonlat_to_rowcol,
    meridian_convergence_deg,
    metric_to_rowcol,
    rowcol_to_lonlat,
    rowcol_to_metric,
    rowcol_to_xy,
    xy_to_rowcol,
)
from localizer.dem.lattice import Dem, dem_from_array

ARC_SECOND = 1 / 3600


def flat(crs: int, x: float, y: float, spacing: float, cells: int = 1000) -> Dem:
    """A DEM whose heights do not matter, with its north-west corner at x, y."""
    z_m = np.zeros((cells, cells), np.float32)
    return dem_from_array(z_m, Affine(spacing, 0.0, x, 0.0, -spacing, y), CRS.from_epsg(crs))


DEMS = {
    "UTM": flat(32611, 376_313.0, 3_807_917.0, 30.0),
    "geographic, lat 37": flat(4326, -122.3, 37.35, ARC_SECOND),
    "geographic, lat 46": flat(4326, 7.0, 46.5, ARC_SECOND),
    "Swiss": flat(21781, 637_342.0, 154_037.0, 25.0),
    "NAD27 UTM": flat(26710, 557_805.0, 5_122_005.0, 30.0),
    "US survey feet": flat(2227, 6_000_000.0, 2_000_000.0, 100.0),
    "Mercator": flat(3857, 1e6, 6e6, 30.0),
    "across the date line": flat(4326, 179.9, -17.0, ARC_SECOND),
    "far south": flat(32719, 500_000.0, 4_500_000.0, 30.0),
}
dems = pytest.mark.parametrize("dem", DEMS.values(), ids=DEMS.keys())
inside = st.floats(0.0, 999.0)


@dems
@given(row=inside, col=inside)
def test_there_and_back_again(dem, row, col):
    assert np.allclose(xy_to_rowcol(dem, *rowcol_to_xy(dem, row, col)), (row, col), rtol=0, atol=1e-6)
    assert np.allclose(metric_to_rowcol(dem, *rowcol_to_metric(dem, row, col)), (row, col), rtol=0, atol=1e-6)
    # datum shifts are their own inverse only to a millimetre or so
    assert np.allclose(lonlat_to_rowcol(dem, *rowcol_to_lonlat(dem, row, col)), (row, col), rtol=0, atol=1e-3)


def test_longitudes_may_be_off_by_a_turn():
    dem = DEMS["across the date line"]
    for lon_deg in (-179.95, 180.05, 540.05):
        _, col = lonlat_to_rowcol(dem, lon_deg, -17.1)
        assert float(col) == pytest.approx(0.15 * 3600 - 0.5, abs=1e-6)


def test_a_place_is_told_by_the_turn_that_is_nearest_to_the_middle_of_the_dem():
    """A DEM from 36 degrees west to 36 degrees east; 0.08 degrees a cell."""
    wide = flat(4326, -36.0, 36.0, 0.08, cells=900)
    for lon_deg in (-179.0, -36.0, 0.0, 36.0, 179.0):
        for turned in (lon_deg - 360.0, lon_deg, lon_deg + 360.0):
            row, col = lonlat_to_rowcol(wide, turned, 0.0)
            assert (float(row), float(col)) == pytest.approx((449.5, 449.5 + lon_deg / 0.08), abs=1e-6)


def test_nad27_lies_some_100_m_from_wgs84():
    dem = DEMS["NAD27 UTM"]
    lon_deg, lat_deg = rowcol_to_lonlat(dem, 0, 0)
    own_lon_deg, own_lat_deg = own_lonlat_deg(dem.crs, *rowcol_to_xy(dem, 0, 0))
    _, _, distance_m = geod(dem).inv(lon_deg, lat_deg, own_lon_deg, own_lat_deg)
    assert 50.0 < float(distance_m) < 150.0


# ---- grid north and true north


@dems
def test_convergence_is_pyproj_s(dem):
    row, col = np.array([0.0, 500.0, 999.0]), np.array([0.0, 700.0, 30.0])
    # of the metric CRS, at the place's coordinates on that CRS's own datum
    lon_deg, lat_deg = own_lonlat_deg(dem.metric_crs, *rowcol_to_metric(dem, row, col))
    expected = Proj(dem.metric_crs).get_factors(lon_deg, lat_deg).meridian_convergence
    assert np.allclose(meridian_convergence_deg(dem, row, col), expected, rtol=0, atol=2e-4)


def test_grid_north_lies_clockwise_of_true_north_east_of_the_central_meridian():
    east_of_it = flat(32611, 600_000.0, 3_800_000.0, 30.0)
    assert meridian_convergence_deg(east_of_it, 0, 0) > 0.0
    assert meridian_convergence_deg(DEMS["UTM"], 0, 0) < 0.0


@dems
def test_true_azimuth_minus_convergence_is_grid_azimuth(dem):
    row, col = np.array(300.0), np.array(200.0)
    convergence_deg = meridian_convergence_deg(dem, row, col)
    easting_m, northing_m = rowcol_to_metric(dem, row, col)
    lon_deg, lat_deg = own_lonlat_deg(dem.crs, *rowcol_to_xy(dem, row, col))
    for azimuth_deg in (0.0, 77.0, 200.0):
        to_lon, to_lat, _ = geod(dem).fwd(lon_deg, lat_deg, azimuth_deg, 100.0)
        to_easting_m, to_northing_m = rowcol_to_metric(
            dem, *xy_to_rowcol(dem, *own_xy(dem.crs, to_lon, to_lat))
        )
        grid_azimuth_deg = np.degrees(np.arctan2(to_easting_m - easting_m, to_northing_m - northing_m))
        difference = (grid_azimuth_deg - (azimuth_deg - convergence_deg) + 180.0) % 360.0 - 180.0
        assert abs(difference) < 0.12  # web Mercator, not quite conformal, is the worst


def test_the_jacobian_of_utm_is_a_rotation_times_the_map_scale():
    dem = DEMS["UTM"]
    jacobian = enu_to_metric_jacobian(dem, 500.0, 500.0)
    gamma = np.radians(float(meridian_convergence_deg(dem, 500.0, 500.0)))
    lon_deg, lat_deg = rowcol_to_lonlat(dem, 500.0, 500.0)
    scale = Proj(dem.crs).get_factors(float(lon_deg), float(lat_deg)).meridional_scale
    rotation = np.array([[np.cos(gamma), -np.sin(gamma)], [np.sin(gamma), np.cos(gamma)]])
    assert np.allclose(jacobian, scale * rotation, rtol=0, atol=1e-8)


def test_jacobians_come_in_the_shape_of_the_positions():
    assert enu_to_metric_jacobian(DEMS["UTM"], np.zeros((3, 4)), 1.0).shape == (3, 4, 2, 2)


# ---- where a true azimuth leads


@dems
@pytest.mark.parametrize(
    ("distance_m", "tolerance_m"), [(100.0, 0.001), (1e3, 0.01), (10e3, 0.05), (30e3, 0.5)]
)
def test_the_expansion_follows_geodesics(dem, distance_m, tolerance_m):
    rng = np.random.default_rng(7)
    row, col = rng.uniform(0, 999, (2, 2000))
    azimuth_deg = rng.uniform(0, 360, 2000)
    e, n = distance_m * np.sin(np.radians(azimuth_deg)), distance_m * np.cos(np.radians(azimuth_deg))
    terms = np.stack([e, n, e * e, e * n, n * n], axis=-1)
    reached = np.stack([row, col], -1) + np.einsum("kij,kj->ki", geodesic_expansion(dem).at(row, col), terms)

    lon_deg, lat_deg = own_lonlat_deg(dem.crs, *rowcol_to_xy(dem, row, col))
    to_lon, to_lat, _ = geod(dem).fwd(lon_deg, lat_deg, azimuth_deg, np.full(2000, distance_m))
    expected = np.stack(xy_to_rowcol(dem, *own_xy(dem.crs, to_lon, to_lat)), -1)
    error_m = np.hypot(*((reached - expected) * [dem.spacing_ns_m, dem.spacing_ew_m]).T)
    assert error_m.max() < tolerance_m


def test_the_expansion_holds_over_a_whole_degree_tile():
    dem = flat(4326, 7.0, 47.0, ARC_SECOND, cells=3601)
    row, col = np.array([1.0, 1800.3, 3599.0]), np.array([17.0, 900.7, 3590.0])
    e, n = 30e3 * np.sin(1.0), 30e3 * np.cos(1.0)
    reached = geodesic_expansion(dem).at(row, col) @ [e, n, e * e, e * n, n * n] + np.stack([row, col], -1)
    lon_deg, lat_deg = own_lonlat_deg(dem.crs, *rowcol_to_xy(dem, row, col))
    to_lon, to_lat, _ = geod(dem).fwd(lon_deg, lat_deg, np.full(3, np.degrees(1.0)), np.full(3, 30e3))
    expected = np.stack(xy_to_rowcol(dem, to_lon, to_lat), -1)
    assert np.hypot(*((reached - expected) * [dem.spacing_ns_m, dem.spacing_ew_m]).T).max() < 0.5


def test_north_is_up_and_east_is_right():
    (r_e, r_n, *_), (c_e, c_n, *_) = geodesic_expansion(DEMS["geographic, lat 46"]).at(500.0, 500.0)[0]
    assert r_n == pytest.approx(-1 / DEMS["geographic, lat 46"].spacing_ns_m, rel=1e-4)
    assert c_e == pytest.approx(1 / DEMS["geographic, lat 46"].spacing_ew_m, rel=1e-4)
    assert abs(r_e) < 1e-9
    assert abs(c_n) < 1e-9


def test_the_expansion_is_fast_for_a_hundred_thousand_positions():
    expansion = geodesic_expansion(DEMS["Swiss"])
    row, col = np.random.default_rng(1).uniform(0, 999, (2, 100_000))
    start = time.thread_time()
    assert expansion.at(row, col).shape == (100_000, 2, 5)
    assert time.thread_time() - start < 0.5
