"""Horizon and elevation at latitudes and longitudes: shapes, edges, refraction."""

import numpy as np
import pytest
from affine import Affine

import localizer

SOUTH_WEST = Affine(30.0, 0.0, 560_000.0, 0.0, -30.0, 5_120_000.0)
PLACE = (46.21447, -122.20442)  # row 60, col 45


@pytest.fixture(scope="module")
def dem() -> localizer.Dem:
    """A plain with a wall across its north, and a void in its south-east."""
    z_m = np.full((80, 90), 100.0)
    z_m[10:12] = 400.0
    z_m[70:75, 80:85] = np.nan
    return localizer.dem_from_array(z_m, SOUTH_WEST, "EPSG:32610")


def test_the_elevation_has_the_shape_of_the_places(dem: localizer.Dem) -> None:
    assert localizer.ground_elevation_m(dem, *PLACE) == pytest.approx(100.0)
    assert localizer.ground_elevation_m(dem, [[PLACE[0]], [PLACE[0]]], PLACE[1]).shape == (2, 1)
    assert np.isnan(localizer.ground_elevation_m(dem, 10.0, 10.0))


def test_the_horizons_shape_is_that_of_the_places_and_then_that_of_the_azimuths(dem: localizer.Dem) -> None:
    lat_deg, lon_deg = PLACE
    places = np.full((2, 3), lat_deg)
    for place, azimuth_deg, shape in [
        (lat_deg, 0.0, ()),
        (lat_deg, [0.0, 90.0], (2,)),
        (places, 0.0, (2, 3)),
        (places, [0.0, 10.0, 20.0, 30.0], (2, 3, 4)),
    ]:
        seen = localizer.horizon(dem, place, lon_deg, 102.0, azimuth_deg)
        assert seen.elevation_deg.shape == seen.distance_m.shape == shape


def test_the_horizon_is_the_wall_in_the_north(dem: localizer.Dem) -> None:
    seen = localizer.horizon(dem, *PLACE, 102.0, 0.0)
    # PROJ has the place in row 60.0129; true north lies 0.574 degrees beside the map's, whose scale is 0.999646:
    # (60.0129 - 11) x 30 m / cos(0.574 deg) / 0.999646. The Earth's curvature takes 0.15 m off the 298 m above the eye.
    assert seen.distance_m == pytest.approx(1470.98, abs=0.05)
    assert np.tan(np.radians(seen.elevation_deg)) == pytest.approx((298.0 - 0.15) / 1470.98, abs=1e-5)


def test_without_terrain_there_is_no_horizon(dem: localizer.Dem) -> None:
    elevation_deg, distance_m = localizer.horizon(dem, *PLACE, 2000.0, 180.0)
    on_edge = localizer.horizon(dem, *localizer.rowcol_to_lonlat(dem, 0.0, 45.0)[::-1], 102.0, 0.0)
    assert elevation_deg < 0.0 < distance_m
    assert np.isnan(on_edge.elevation_deg)
    assert np.isnan(on_edge.distance_m)


def test_refraction_lifts_the_horizon(dem: localizer.Dem) -> None:
    straight, bent = (
        localizer.horizon(dem, *PLACE, 102.0, 0.0, refraction_coefficient=k) for k in (0.0, 0.13)
    )
    # The tangent changes by 0.13 x / (2 R), and the angle by that times cos^2 of itself.
    lift = 0.13 * 1470.98 / (2.0 * 6371008.8) * np.cos(np.radians(11.447)) ** 2
    assert np.radians(bent.elevation_deg - straight.elevation_deg) == pytest.approx(lift, rel=1e-3)
    assert bent == localizer.horizon(dem, *PLACE, 102.0, 0.0)


def test_a_place_outside_the_dem_is_named(dem: localizer.Dem) -> None:
    with pytest.raises(localizer.DemError, match=r"^-122.20442,46.21447 lies outside the DEM"):
        localizer.horizon(dem, PLACE[1], PLACE[0], 102.0, 0.0)


@pytest.mark.parametrize(
    ("altitude_m", "azimuth_deg", "what"),
    [(np.nan, 0.0, "altitude_m"), (102.0, np.inf, "azimuth_deg"), (102.0, [[0.0]], "azimuth_deg")],
)
def test_a_wrong_argument_is_named(
    dem: localizer.Dem, altitude_m: float, azimuth_deg: object, what: str
) -> None:
    with pytest.raises(ValueError, match=what):
        localizer.horizon(dem, *PLACE, altitude_m, azimuth_deg)  # type: ignore[arg-type]


def test_an_array_that_horizons_were_computed_from_cannot_be_changed_unseen() -> None:
    dem = localizer.dem_from_array(np.full((20, 20), 100.0), SOUTH_WEST, "EPSG:32610")
    dem.z_m[5, 5] = 300.0
    lon_deg, lat_deg = localizer.rowcol_to_lonlat(dem, 10.0, 5.0)
    assert localizer.horizon(dem, lat_deg, lon_deg, 102.0, 0.0).elevation_deg > 45.0
    with pytest.raises(ValueError, match="read-only"):
        dem.z_m[5, 5] = 0.0


def test_what_is_computed_of_a_dem_ends_with_it() -> None:
    import gc
    import weakref

    dem = localizer.dem_from_array(np.full((20, 20), 100.0), SOUTH_WEST, "EPSG:32610")
    lon_deg, lat_deg = localizer.rowcol_to_lonlat(dem, 10.0, 10.0)
    localizer.horizon(dem, lat_deg, lon_deg, 102.0, 0.0)
    gone = weakref.ref(dem)
    del dem
    gc.collect()
    assert gone() is None


def test_the_crs_of_an_array_may_be_named_and_a_wrong_one_is() -> None:
    with pytest.raises(localizer.DemError, match="crs: EPSG:nothing is not a coordinate reference system"):
        localizer.dem_from_array(np.zeros((20, 20)), SOUTH_WEST, "EPSG:nothing")


def test_a_dem_is_loaded_from_one_name_or_several(write_raster, ramp) -> None:
    path = write_raster(ramp)
    one, same = localizer.load_dem(str(path)), localizer.load_dem([path])
    assert np.array_equal(one.z_m, same.z_m)


def test_an_unknown_unit_is_named(write_raster, ramp) -> None:
    with pytest.raises(localizer.DemError, match="furlong"):
        localizer.load_dem(write_raster(ramp), vertical_unit="furlong")


def test_the_predicted_skyline_is_the_horizon_from_the_mast(dem: localizer.Dem) -> None:
    skyline = localizer.predict_skyline(dem, *PLACE, mast_height_m=3.0, azimuth_deg=10.0, fov_deg=60.0)
    seen = localizer.horizon(dem, *PLACE, skyline.standpoint.altitude_m, skyline.azimuth_deg)
    assert skyline.standpoint.altitude_m == pytest.approx(103.0)
    assert np.allclose(skyline.elevation_deg, seen.elevation_deg, atol=1e-9, equal_nan=True)
    assert skyline.azimuth_deg[0] == pytest.approx(340.0)
    assert skyline.offset_deg[[0, -1]] == pytest.approx([-30.0, 30.0])
    assert not (skyline.reliable & skyline.at_dem_edge).any()


def test_the_default_view_goes_all_round(dem: localizer.Dem) -> None:
    skyline = localizer.predict_skyline(dem, *PLACE)
    assert skyline.offset_deg[[0, -1]] == pytest.approx([-180.0, 180.0])
    assert any("edge of the DEM" in warning for warning in skyline.warnings)


@pytest.mark.parametrize(
    "options", [{"fov_deg": 0.0}, {"fov_deg": 361.0}, {"mast_height_m": -1.0}, {"azimuth_deg": np.nan}]
)
def test_a_view_out_of_range_is_refused(dem: localizer.Dem, options: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(options))):
        localizer.predict_skyline(dem, *PLACE, **options)


def test_a_standpoint_in_a_void_is_named(dem: localizer.Dem) -> None:
    lon_deg, lat_deg = localizer.rowcol_to_lonlat(dem, 72.0, 82.0)
    with pytest.raises(localizer.SkyfixError, match="lies in a void of the DEM"):
        localizer.predict_skyline(dem, float(lat_deg), float(lon_deg))
