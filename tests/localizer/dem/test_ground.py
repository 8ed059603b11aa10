"""Metres of a map and metres of the ground, each way, against geodesics."""

import numpy as np
import pytest
from affine import Affine
from fakes.results import a_result
from hypothesis import given
from hypothesis import strategies as st
from pyproj import CRS, Geod, Transformer

from localizer.bundle import Prior
from localizer.dem.geodesy import enu_to_metric_jacobian, map_metres_at, rowcol_to_lonlat, rowcol_to_metric
from localizer.dem.ground import ground_distance_m, ground_offset_m, map_metres
from localizer.dem.horizon import prepare_terrain
from localizer.dem.lattice import dem_from_array
from localizer.fix import ellipse
from localizer.observation import Observation, PriorCircle
from localizer.search.answer import metric_covariance
from localizer.search.prior_circle import cells_within_prior
from localizer.show.candidates import ellipse_ring_m, places
from localizer.show.text import fix_text, sigmas_off
from localizer.truth import Truth

GEOD = Geod(ellps="WGS84")
MAPS = {
    "Web Mercator at 68 N": ("EPSG:3857", 15.1, 68.3),
    "Web Mercator, east of 180": ("EPSG:3857", -179.9, 52.0),
    "world Mercator": ("EPSG:3395", 15.1, 60.0),
    "plate carree": ("EPSG:4087", 10.0, 60.0),
    "UTM at its zone's edge": ("EPSG:32633", 12.0, 68.3),
    "polar stereographic": ("EPSG:3031", 166.7, -77.8),
    "UPS north": ("EPSG:5041", 30.0, 86.0),
    "Lambert azimuthal": ("EPSG:3035", -20.0, 64.5),
    "Albers": ("EPSG:5070", -121.0, 45.0),
}


def place(name):
    crs, lon_deg, lat_deg = MAPS[name]
    x, y = Transformer.from_crs("EPSG:4326", crs, always_xy=True).transform(lon_deg, lat_deg)
    return crs, float(x), float(y), lon_deg, lat_deg


def beside(crs, lon_deg, lat_deg, azimuth_deg, distance_m):
    """Where a geodesic leads, in the map."""
    lon, lat, _ = GEOD.fwd(lon_deg, lat_deg, azimuth_deg, distance_m)
    x, y = Transformer.from_crs("EPSG:4326", crs, always_xy=True).transform(lon, lat)
    return float(x), float(y)


@pytest.mark.parametrize("name", MAPS)
@pytest.mark.parametrize("azimuth_deg", [0.0, 33.0, 90.0, 200.0])
def test_a_step_on_the_ground_and_its_image_in_the_map(name, azimuth_deg):
    crs, x, y, lon_deg, lat_deg = place(name)
    here = map_metres(crs, x, y)
    step = 50.0 * np.array([np.sin(np.radians(azimuth_deg)), np.cos(np.radians(azimuth_deg))])
    end = np.array(beside(crs, lon_deg, lat_deg, azimuth_deg, 50.0))
    assert here.to_map @ step == pytest.approx(end - (x, y), abs=0.01)
    along_axes = here.grid_from_true @ step
    assert np.hypot(*along_axes) == pytest.approx(50.0)  # turned, and not stretched
    assert here.map_from_ground @ along_axes == pytest.approx(end - (x, y), abs=0.01)
    assert ground_distance_m(crs, (x, y), tuple(end)) == pytest.approx(50.0, abs=0.01)
    assert ground_offset_m(crs, (x, y), tuple(end)) == pytest.approx(along_axes, abs=0.01)


def test_scale_and_convergence_are_those_of_the_formulas():
    crs, x, y, _, lat_deg = place("Web Mercator at 68 N")
    here = map_metres(crs, x, y)
    sphere = 1.0 / np.cos(np.radians(lat_deg))  # of the sphere; the ellipsoid changes it by 0.3 %
    assert here.scale == pytest.approx(sphere, rel=3e-3)
    assert here.convergence_deg == pytest.approx(0.0, abs=1e-9)
    crs, x, y, _, _ = place("plate carree")
    assert map_metres(crs, x, y).axis_scales == pytest.approx((2.0, 1.0), rel=4e-3)
    crs, x, y, lon_deg, _ = place("polar stereographic")
    assert map_metres(crs, x, y).convergence_deg % 360.0 == pytest.approx(-lon_deg % 360.0, abs=1e-6)


@given(
    name=st.sampled_from(sorted(MAPS)),
    major=st.floats(0.5, 200.0),
    share=st.floats(0.05, 1.0),
    azimuth_deg=st.floats(0.0, 180.0),
)
def test_an_ellipse_keeps_its_axes_on_the_ground_and_finds_back(name, major, share, azimuth_deg):
    crs, x, y, _, _ = place(name)
    here = map_metres(crs, x, y)
    turn = np.radians(azimuth_deg)
    axes = np.array([[np.sin(turn), np.cos(turn)], [np.cos(turn), -np.sin(turn)]]).T
    of_true = axes @ np.diag([major**2, (share * major) ** 2]) @ axes.T
    of_ground = here.ground_covariance(of_true)
    (ee, en), (ne, nn) = of_ground.tolist()
    got = ellipse(((ee, en), (ne, nn)))
    assert (got.major_m, got.minor_m) == pytest.approx((major, share * major), rel=1e-6)
    assert here.true_covariance(of_ground) == pytest.approx(of_true, rel=1e-9, abs=1e-9 * major**2)
    assert here.map_covariance(of_ground) == pytest.approx(
        here.to_map @ of_true @ here.to_map.T, rel=1e-9, abs=1e-9 * major**2
    )


# ---- what is told of a DEM in such a map


def mercator_dem():
    """75 m of the map, 28 m of the ground, at 68.3 north."""
    x, y = place("Web Mercator at 68 N")[1:3]
    rows, cols = np.mgrid[:60, :80]
    return dem_from_array(
        500.0 + 200.0 * np.sin(rows / 9) * np.cos(cols / 7),
        Affine(75.0, 0.0, x - 3000.0, 0.0, -75.0, y + 2200.0),
        CRS.from_epsg(3857),
    )


class _Refined:
    """What of a refined place counts here."""

    def __init__(self, row, col, covariance_enu_m2):
        self.row, self.col, self.covariance_enu_m2 = row, col, covariance_enu_m2


def test_the_covariance_of_a_fix_is_of_the_ground():
    terrain = prepare_terrain(mercator_dem())
    assert metric_covariance(terrain, _Refined(30.0, 40.0, np.diag([9.0, 4.0]))) == pytest.approx(
        np.diag([9.0, 4.0]), rel=1e-9
    )


def test_the_true_error_is_of_the_ground():
    dem = mercator_dem()
    result = a_result(dem, [(30.0, 40.0, 0.999)], covariance_m2=((4.0, 0.0), (0.0, 4.0)))
    position = result.fix.position
    east_x, east_y = beside("EPSG:3857", position.lon_deg, position.lat_deg, 90.0, 10.0)
    truth = Truth(easting_m=east_x, northing_m=east_y, crs="EPSG:3857")
    assert abs(east_x - position.easting_m) > 25.0  # metres of the map
    assert truth.distance_m(position, dem) == pytest.approx(10.0, abs=0.01)
    assert sigmas_off(result.fix, truth, dem) == pytest.approx(5.0, abs=0.01)
    text = fix_text(result.fix, dem, truth)
    assert "1 sigma     2.0 m x 2.0 m" in text
    assert "(EPSG:3857; a metre of this map is 0.37 m here)" in text
    assert "true error  10.0 m  (5.0 sigma)" in text


def test_an_ellipse_is_drawn_in_the_map_s_own_metres():
    dem = mercator_dem()
    (found,) = places(a_result(dem, [(30.0, 40.0, 0.999)], covariance_m2=((9.0, 0.0), (0.0, 4.0))), dem)
    easting_m, northing_m = ellipse_ring_m(found)
    reach = np.sqrt(5.991)
    scale = map_metres_at(dem, 30.0, 40.0).axis_scales
    assert np.ptp(easting_m) == pytest.approx(2.0 * 3.0 * reach * scale[0], rel=2e-3)
    assert np.ptp(northing_m) == pytest.approx(2.0 * 2.0 * reach * scale[1], rel=2e-3)
    assert (found.axes.major_m, found.axes.minor_m) == pytest.approx((3.0, 2.0))


@pytest.mark.parametrize("radius_m", [200.0, 900.0])
def test_a_prior_s_circle_is_of_the_ground(radius_m):
    dem = mercator_dem()
    terrain = prepare_terrain(dem)
    lon_deg, lat_deg = (float(v) for v in rowcol_to_lonlat(dem, 25.3, 40.8))
    nothing = Observation((), 2.0, None, np.inf, 0.5, 0.02, PriorCircle(lat_deg, lon_deg, radius_m))
    row, col = np.mgrid[: dem.rows, : dem.cols]
    lon, lat = rowcol_to_lonlat(dem, row, col)
    off_m = GEOD.inv(np.full(lon.shape, lon_deg), np.full(lon.shape, lat_deg), lon, lat)[2]
    within = cells_within_prior(terrain, nothing)
    clear = np.abs(off_m - radius_m) > 0.5
    assert np.array_equal(within[clear], (off_m <= radius_m)[clear])


def test_a_prior_far_outside_holds_no_cell():
    terrain = prepare_terrain(mercator_dem())
    away = Observation((), 2.0, None, np.inf, 0.5, 0.02, PriorCircle(-40.0, 170.0, 1000.0))
    assert not cells_within_prior(terrain, away).any()
    assert Prior(lat_deg=0.0, lon_deg=241.8, radius_m=10.0).lon_deg == 241.8


def test_the_jacobian_is_that_of_the_map_s_metres():
    dem = mercator_dem()
    easting_m, northing_m = rowcol_to_metric(dem, 10.0, 20.0)
    here = map_metres(dem.metric_crs, float(easting_m), float(northing_m))
    assert enu_to_metric_jacobian(dem, 10.0, 20.0) == pytest.approx(here.to_map)


def test_us_survey_feet_are_no_metres():
    """A CRS in feet is left for UTM: eastings in metres are promised."""
    rows, cols = np.mgrid[:20, :20]
    dem = dem_from_array(
        100.0 + rows + cols, Affine(98.0, 0.0, 6_000_000.0, 0.0, -98.0, 2_100_000.0), CRS.from_epsg(2227)
    )
    assert dem.metric_crs.to_epsg() == 32610
    assert map_metres_at(dem, 9.0, 9.0).scale == pytest.approx(1.0, abs=1e-3)
    assert dem.spacing_ns_m == pytest.approx(98.0 * 1200 / 3937, rel=1e-3)
