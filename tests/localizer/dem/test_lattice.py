import os
import warnings
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from hypothesis import given
from hypothesis import strategies as st
from pyproj import CRS

from localizer.dem.geodesy import rowcol_to_lonlat, rowcol_to_xy
from localizer.dem.lattice import DemError, dem_from_array, load_dem

UTM = Affine(30.0, 0.0, 560_000.0, 0.0, -30.0, 5_120_000.0)


@pytest.fixture(autouse=True)
def _no_warnings():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


# ---- what a file holds


def test_a_projected_file_keeps_its_grid_and_crs(write_raster, ramp):
    dem = load_dem([write_raster(ramp)])
    assert np.array_equal(dem.z_m, ramp)
    assert dem.z_m.dtype == np.float32
    assert dem.crs == dem.metric_crs == CRS.from_epsg(32610)
    assert [float(value) for value in rowcol_to_xy(dem, 0, 0)] == [560_015.0, 5_119_985.0]
    assert dem.spacing_ns_m == pytest.approx(30.0, rel=1e-3)
    assert dem.spacing_ew_m == pytest.approx(30.0, rel=1e-3)


def test_the_terrain_that_ships_is_geographic_and_pixel_is_point(santa_cruz_file):
    dem = load_dem([santa_cruz_file])
    assert dem.z_m.shape == (800, 800)
    assert (np.nanmin(dem.z_m), np.nanmax(dem.z_m)) == (28.0, 996.0)
    assert dem.metric_crs == CRS.from_epsg(32610)
    assert dem.files[0].pixel_is == "point"
    # samples of a pixel-is-point file lie on whole arc seconds
    lon_deg, lat_deg = rowcol_to_lonlat(dem, 0, 0)
    assert float(lon_deg) * 3600 == pytest.approx(round(float(lon_deg) * 3600), abs=1e-6)
    assert float(lat_deg) * 3600 == pytest.approx(round(float(lat_deg) * 3600), abs=1e-6)
    assert dem.spacing_ns_m == pytest.approx(30.83, abs=0.01)
    assert dem.spacing_ew_m == pytest.approx(24.67, abs=0.05)


def test_pixel_is_point_and_pixel_is_area_name_the_same_place_once_rasterio_has_read_them(write_raster, ramp):
    area, point = (load_dem([write_raster(ramp, f"{p}.tif", point=p)]) for p in (False, True))
    assert (area.files[0].pixel_is, point.files[0].pixel_is) == ("area", "point")
    for dem in (area, point):  # 30 m cells from 560000, 5120000 on: the centres are at half cells
        assert [float(v) for v in rowcol_to_xy(dem, 2, 3)] == [560_105.0, 5_119_925.0]


@pytest.mark.parametrize(
    ("unit", "metres"),
    [("metre", 1.0), ("m", 1.0), ("ft", 0.3048), ("feet", 0.3048), ("US survey foot", 1200 / 3937)],
)
def test_the_band_s_unit_is_honoured(write_raster, ramp, unit, metres):
    dem = load_dem([write_raster(ramp, unit=unit)])
    assert np.allclose(dem.z_m, ramp * metres, rtol=1e-6)
    assert dem.files[0].vertical_unit_from == "band"


def test_scale_and_offset_of_the_band_come_before_the_unit(write_raster, ramp):
    dem = load_dem([write_raster(ramp, unit="ft", scale=0.1, offset=100.0)])
    assert np.allclose(dem.z_m, (ramp * 0.1 + 100.0) * 0.3048, rtol=1e-6)


def test_a_compound_crs_states_the_vertical_unit(write_raster, ramp):
    dem = load_dem([write_raster(ramp, crs="EPSG:6339+6360")])  # NAVD88 height in US survey feet
    assert np.allclose(dem.z_m, ramp * (1200 / 3937), rtol=1e-6)
    assert dem.crs == CRS.from_epsg(6339)


@pytest.mark.parametrize(
    ("crs", "unit", "metres"),
    [
        ("EPSG:6339+6360", "us-ft", 1200 / 3937),
        ("EPSG:6339+8228", "ft", 0.3048),
        ("EPSG:6339+5703", "m", 1.0),
    ],
)
def test_a_vertical_unit_that_only_the_crs_states_is_honoured(write_raster, ramp, crs, unit, metres):
    """GDAL copies the unit of a file's own CRS to the band; a CRS that is told has its unit in itself alone."""
    dem = load_dem([write_raster(ramp, crs=None)], crs=crs)
    assert (dem.files[0].vertical_unit, dem.files[0].vertical_unit_from) == (unit, "CRS")
    assert np.allclose(dem.z_m, ramp * metres, rtol=1e-6)


def test_a_vertical_unit_of_the_crs_that_is_not_known_is_named(write_raster, ramp):
    metres = CRS.from_user_input("EPSG:4326+5773").to_wkt()
    fathoms = 'LENGTHUNIT["fathom",1.8288]'.join(metres.rsplit('LENGTHUNIT["metre",1]', 1))
    degrees = Affine(0.001, 0.0, 7.0, 0.0, -0.001, 46.0)
    path = write_raster(ramp, crs=None, transform=degrees)
    with pytest.raises(DemError, match=r"vertical axis \(fathom\) is unknown; .* --vertical-unit"):
        load_dem([path], crs=fathoms)


def test_the_option_overrules_the_file(write_raster, ramp):
    dem = load_dem([write_raster(ramp, unit="m")], vertical_unit="ft")
    assert np.allclose(dem.z_m, ramp * 0.3048, rtol=1e-6)


def test_a_grid_in_feet_gets_a_metric_crs_beside_its_own(write_raster, ramp):
    transform = Affine(100.0, 0.0, 6_000_000.0, 0.0, -100.0, 2_000_000.0)
    dem = load_dem([write_raster(ramp, crs="EPSG:2227", transform=transform)], vertical_unit="us-ft")
    assert dem.metric_crs == CRS.from_epsg(32610)
    assert dem.spacing_ns_m == pytest.approx(30.48, abs=0.01)


def test_a_crs_without_a_name_is_the_listed_one_that_it_is(write_raster, ramp):
    """As GDAL makes it of a USGS DEM, which has no names but a zone and a datum."""
    listed = CRS.from_epsg(26710)
    unnamed = listed.to_wkt("WKT1_GDAL").replace('PROJCS["NAD27 / UTM zone 10N"', 'PROJCS["unnamed"')
    assert CRS.from_wkt(unnamed).name == "unnamed"
    assert load_dem([write_raster(ramp, crs=unnamed)]).crs.name == "NAD27 / UTM zone 10N"


def test_what_an_option_overrules_is_noted_with_what_the_file_says(write_raster, ramp):
    path = write_raster(ramp, unit="ft", scale=0.5)
    dem = load_dem([path], crs="EPSG:26910", vertical_unit="m", scale=2.0)
    assert dem.files[0].overruled == (
        f"{path}: says WGS 84 / UTM zone 10N; --crs takes it for NAD83 / UTM zone 10N",
        f"{path}: says its elevations are in ft; --vertical-unit takes them for m",
        f"{path}: says its scale is 0.5; --scale takes it for 2",
    )
    same = load_dem([path], crs="EPSG:32610", vertical_unit="ft", scale=0.5)
    assert same.files[0].overruled == ()
    plain = load_dem([write_raster(ramp, "plain.tif")], vertical_unit="ft", scale=2.0)
    assert plain.files[0].overruled == (), "a file that says nothing is not overruled"


def test_unit_and_scale_are_those_of_the_band_that_is_taken(write_raster, ramp):
    path = write_raster(ramp, bands=2)
    with rasterio.open(path, "r+") as dataset:
        dataset.set_band_unit(1, "ft")
        dataset.set_band_unit(2, "m")
        dataset.scales, dataset.offsets = (0.1, 0.5), (7.0, 100.0)
    dem = load_dem([path], band=2)
    assert np.allclose(dem.z_m, ramp * 0.5 + 100.0)
    assert (dem.files[0].band, dem.files[0].scale, dem.files[0].vertical_unit) == (2, 0.5, "m")
    first = load_dem([path], band=1)
    assert np.allclose(first.z_m, (ramp * 0.1 + 7.0) * 0.3048)
    other = load_dem([path], band=2, vertical_unit="ft", scale=3.0)
    assert other.files[0].overruled == (
        f"{path}: says its elevations are in m; --vertical-unit takes them for ft",
        f"{path}: says its scale is 0.5; --scale takes it for 3",
    )


# ---- voids


def test_nodata_nan_and_implausible_values_are_voids(write_raster, ramp):
    z = ramp.astype(np.float32)
    z[0, 0], z[1, 1], z[2, 2], z[3, 3], z[4, 4] = -9999.0, np.nan, -32768.0, 1e20, 9001.0
    z[5, 0] = 499.0
    dem = load_dem([write_raster(z, nodata=499.0)])
    assert np.argwhere(np.isnan(dem.z_m)).tolist() == [[0, 0], [1, 1], [2, 2], [3, 3], [4, 4], [5, 0]]
    assert dem.files[0].voids == 6


def test_zero_is_an_elevation_unless_told_otherwise(write_raster, ramp):
    path = write_raster(ramp)
    assert load_dem([path]).z_m[0, 0] == 0.0
    assert np.argwhere(np.isnan(load_dem([path], nodata=0.0).z_m)).tolist() == [[0, 0]]


def test_nodata_counts_in_the_file_s_own_unit(write_raster, ramp):
    dem = load_dem([write_raster(ramp, unit="ft")], nodata=204.0)
    assert np.argwhere(np.isnan(dem.z_m)).tolist() == [[2, 4]]


def test_nodata_that_is_no_round_number_in_the_file_s_own_precision(write_raster, ramp):
    z = ramp.astype(np.float32)
    z[1, 2] = -9.99
    assert np.argwhere(np.isnan(load_dem([write_raster(z)], nodata=-9.99).z_m)).tolist() == [[1, 2]]


@pytest.mark.parametrize("nodata", [204.5, 1e10, np.nan])
def test_nodata_that_whole_numbers_cannot_be_makes_no_void_of_them(write_raster, ramp, nodata):
    assert load_dem([write_raster(ramp)], nodata=nodata).files[0].voids == 0


# ---- orientation


def test_a_south_up_file_is_turned_so_that_row_0_is_northernmost(write_raster, ramp):
    south_up = UTM @ Affine(1, 0, 0, 0, -1, ramp.shape[0])
    flipped, plain = (
        load_dem([write_raster(z, f"{i}.tif", transform=t)])
        for i, (z, t) in enumerate([(ramp[::-1], south_up), (ramp, UTM)])
    )
    assert np.array_equal(flipped.z_m, plain.z_m)
    assert flipped.transform.almost_equals(plain.transform)


def test_a_mirrored_file_is_turned_so_that_column_0_is_westernmost(write_raster, ramp):
    mirrored = UTM @ Affine(-1, 0, ramp.shape[1], 0, 1, 0)
    dem = load_dem([write_raster(ramp[:, ::-1], transform=mirrored)])
    assert np.array_equal(dem.z_m, ramp)
    assert dem.transform.almost_equals(UTM)


# ---- several files


@pytest.mark.parametrize("overlap", [0, 1, 2])
def test_adjoining_files_become_one(write_raster, ramp, overlap):
    west = write_raster(ramp[:, : 2 + overlap], "west.tif")
    east = write_raster(ramp[:, 2:], "east.tif", transform=UTM @ Affine.translation(2, 0))
    for paths in ([west, east], [east, west]):
        dem = load_dem(paths)
        assert np.array_equal(dem.z_m, ramp)
        assert dem.transform.almost_equals(UTM)
        assert dem.source == tuple(paths)


def test_where_files_overlap_the_first_counts(write_raster, ramp):
    """Two files, the second 1000 m higher, that share column 2."""
    west = write_raster(ramp[:, :3], "west.tif")
    east = write_raster(ramp[:, 2:] + 1000, "east.tif", transform=UTM @ Affine.translation(2, 0))
    expected = ramp + np.where(np.arange(5) >= 3, 1000, 0)
    assert np.array_equal(load_dem([west, east]).z_m, expected)
    assert np.array_equal(load_dem([east, west]).z_m, ramp + np.where(np.arange(5) >= 2, 1000, 0))


def test_files_on_both_sides_of_the_date_line_adjoin(write_raster, ramp):
    grid = Affine(0.01, 0.0, 179.97, 0.0, -0.01, -17.0)
    west = write_raster(ramp[:, :3], "west.tif", crs="EPSG:4326", transform=grid)
    beyond = Affine.translation(-360.0, 0.0) @ grid @ Affine.translation(3, 0)
    east = write_raster(ramp[:, 3:], "east.tif", crs="EPSG:4326", transform=beyond)
    for paths, start in (((west, east), 179.97), ((east, west), -180.03)):
        dem = load_dem(paths)
        assert np.array_equal(dem.z_m, ramp)
        assert dem.transform.c == pytest.approx(start)


def test_the_gap_of_an_l_shape_is_void_and_a_void_is_filled_by_the_other_file(write_raster, ramp):
    z = ramp.astype(np.float32)
    z[2, 2] = np.nan
    first = write_raster(z[:3], "first.tif")
    second = write_raster(
        ramp[2:, 2:].astype(np.float32), "second.tif", transform=UTM @ Affine.translation(2, 2)
    )
    dem = load_dem([first, second])
    assert np.isnan(dem.z_m[3:, :2]).all()
    assert dem.z_m[2, 2] == ramp[2, 2]
    assert np.count_nonzero(np.isnan(dem.z_m)) == 6


@pytest.mark.parametrize(
    ("transform", "crs", "complaint"),
    [
        (UTM @ Affine.translation(6, 0), "EPSG:32610", "no overlap"),
        (UTM @ Affine.translation(0, -9), "EPSG:32610", "no overlap"),
        (UTM @ Affine.translation(2.5, 0), "EPSG:32610", "part of a cell"),
        (UTM @ Affine.scale(1.5), "EPSG:32610", "differ in size"),
        (UTM, "EPSG:32611", "their CRS differ"),
    ],
)
def test_files_that_do_not_fit_together_are_refused(write_raster, ramp, transform, crs, complaint):
    first = write_raster(ramp, "first.tif")
    second = write_raster(ramp, "second.tif", transform=transform, crs=crs)
    with pytest.raises(DemError, match=complaint) as refusal:
        load_dem([first, second])
    assert str(first) in str(refusal.value)
    assert str(second) in str(refusal.value)


# ---- what is refused


@pytest.mark.parametrize(
    ("layout", "complaint"),
    [
        ({"crs": None}, "--crs"),
        ({"bands": 3}, "3 bands"),
        ({"transform": Affine.identity()}, "not georeferenced"),
        ({"transform": UTM @ Affine.rotation(5.0)}, "rotated"),
        # sheared by a fiftieth of a cell over six rows, and over five columns
        ({"transform": Affine(30.0, 0.1, 560_000.0, 0.0, -30.0, 5_120_000.0)}, "rotated"),
        ({"transform": Affine(30.0, 0.0, 560_000.0, 0.12, -30.0, 5_120_000.0)}, "rotated"),
        ({"transform": Affine(30.0, -0.1, 560_000.0, 0.0, -30.0, 5_120_000.0)}, "rotated"),
        ({"transform": Affine(30.0, 0.0, 560_000.0, -0.12, -30.0, 5_120_000.0)}, "rotated"),
        ({"transform": Affine(0.0, 30.0, 560_000.0, 30.0, -30.0, 5_120_000.0)}, "not georeferenced"),
        ({"unit": "degC"}, "'degC' is unknown; name it with --vertical-unit"),
        ({"crs": "EPSG:2227"}, "vertical unit is not stated; name it with --vertical-unit"),
        ({"crs": "EPSG:4326"}, "no degrees"),
        ({"crs": "EPSG:4978"}, "neither geographic nor projected"),
        ({"transform": Affine(1e-3, 0, 560_000.0, 0, -1e-3, 5_120_000.0)}, "its cells measure"),
    ],
)
def test_a_file_that_cannot_be_a_dem_is_refused_in_one_line(write_raster, ramp, layout, complaint):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        path = write_raster(ramp, **layout)
    with pytest.raises(DemError, match=complaint) as refusal:
        load_dem([path])
    assert str(path) in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_rounding_in_the_transform_is_no_rotation(write_raster, ramp):
    """Less than a hundredth of a cell over the whole file."""
    almost = Affine(30.0, 0.04, 560_000.0, 0.05, -30.0, 5_120_000.0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # rasterio's own, where a transform has such terms
        assert load_dem([write_raster(ramp, transform=almost)]).transform == UTM


def test_all_void_and_too_small_are_refused(write_raster, ramp):
    with pytest.raises(DemError, match="all void"):
        load_dem([write_raster(np.full((6, 5), -32767, np.int16))])
    with pytest.raises(DemError, match="too few"):
        load_dem([write_raster(ramp[:2])])


def test_no_file_a_directory_no_raster_and_a_cut_file_are_refused(tmp_path, write_raster):
    with pytest.raises(DemError, match="no such file"):
        load_dem([tmp_path / "nowhere.tif"])
    with pytest.raises(DemError, match="is a directory"):
        load_dem([tmp_path])
    os.mkfifo(tmp_path / "pipe.tif")
    with pytest.raises(DemError, match="is a pipe or a device"):
        load_dem([tmp_path / "pipe.tif"])
    text = tmp_path / "notes.txt"
    text.write_text("not a raster")
    with pytest.raises(DemError, match="not an elevation raster"):
        load_dem([text])
    whole = write_raster(np.random.default_rng(1).integers(0, 3000, (300, 300)).astype(np.int16))
    cut = tmp_path / "cut.tif"
    cut.write_bytes(whole.read_bytes()[:50_000])
    with pytest.raises(DemError, match="not an elevation raster"):
        load_dem([cut])
    with pytest.raises(DemError, match="no elevation file"):
        load_dem([])


def test_a_wrong_option_is_refused(write_raster, ramp):
    path = write_raster(ramp)
    with pytest.raises(DemError, match=r"--crs: not a coordinate reference system: 'EPSG:nonsense'"):
        load_dem([path], crs="EPSG:nonsense")
    with pytest.raises(DemError, match=r"--crs: not a coordinate reference system: ''"):
        load_dem([path], crs="")
    with pytest.raises(DemError, match="--vertical-unit: furlong"):
        load_dem([path], vertical_unit="furlong")


# ---- elevations between the cells


def test_the_dem_covers_its_cells_to_their_outer_edges(write_raster, ramp):
    dem = load_dem([write_raster(ramp)])  # 6 rows, 5 columns
    inside = [(-0.5, -0.5), (-0.5, 4.5), (5.5, -0.5), (5.5, 4.5), (2.0, 2.0)]
    outside = [(-0.51, 2.0), (5.51, 2.0), (2.0, -0.51), (2.0, 4.51)]
    assert [dem.covers(*place) for place in inside + outside] == [True] * 5 + [False] * 4


def test_the_surface_is_bilinear_and_ends_at_the_outermost_cell_centres(write_raster, ramp):
    dem = load_dem([write_raster(ramp)])
    assert dem.ground_m(2.25, 1.5) == pytest.approx(226.5)
    assert dem.ground_m(5, 4) == 504.0
    outside = dem.ground_m([-0.01, 5.01, 0, 0, np.nan], [0, 0, -0.01, 4.01, 0])
    assert np.isnan(outside).all()


def test_a_rounding_error_beyond_the_outermost_centres_is_no_outside(write_raster, ramp):
    """A millionth of a cell."""
    dem = load_dem([write_raster(ramp)])
    just = 5e-7
    assert dem.ground_m([-just, 5 + just, 2, 2], [2, 2, -just, 4 + just]) == pytest.approx(
        [2.0, 502.0, 200.0, 204.0]
    )
    beyond = 2e-6
    assert np.isnan(dem.ground_m([-beyond, 5 + beyond, 2, 2], [2, 2, -beyond, 4 + beyond])).all()


@pytest.mark.parametrize("shape", [(2, 9), (9, 2)])
def test_fewer_than_three_rows_or_columns_are_too_few(shape):
    with pytest.raises(DemError, match=f"{shape[0]} x {shape[1]} cells are too few"):
        dem_from_array(np.zeros(shape), UTM, "EPSG:32610")
    assert dem_from_array(np.zeros((3, 3)), UTM, "EPSG:32610").rows == 3


@pytest.mark.parametrize(
    ("cell_x", "cell_y", "fits"),
    [
        (0.051, 1.0, True),
        (0.049, 1.0, False),
        (1.0, 0.049, False),
        (9_900.0, 9_900.0, True),
        (10_100.0, 30.0, False),
    ],
)
def test_cells_measure_5_cm_to_10_km(cell_x, cell_y, fits):
    grid = Affine(cell_x, 0.0, 500_000.0 - cell_x, 0.0, -cell_y, 5_120_000.0)
    if fits:
        dem = dem_from_array(np.zeros((3, 3)), grid, "EPSG:32610")
        # on the central meridian the map's scale is 0.9996
        assert (dem.spacing_ew_m, dem.spacing_ns_m) == pytest.approx(
            (cell_x / 0.9996, cell_y / 0.9996), rel=1e-5
        )
    else:
        with pytest.raises(DemError, match=r"its cells measure .* x .* m, as no elevation model's do"):
            dem_from_array(np.zeros((3, 3)), grid, "EPSG:32610")


@pytest.mark.parametrize(("north", "fits"), [(90.05, True), (90.2, False), (-89.9, True), (-90.0, False)])
def test_latitudes_reach_to_the_poles_and_half_a_cell_farther(north, fits):
    """Of three cells of 0.05 degrees: the northern edge at most at 90.1, the southern one at least at -90.1."""
    grid = Affine(0.05, 0.0, 7.0, 0.0, -0.05, north)
    if fits:
        assert dem_from_array(np.zeros((3, 3)), grid, "EPSG:4326").transform == grid
    else:
        with pytest.raises(DemError, match="its coordinates are no degrees, but its CRS is WGS 84"):
            dem_from_array(np.zeros((3, 3)), grid, "EPSG:4326")


def test_a_void_spoils_the_cells_around_it_but_not_the_grid_lines_beside_it(write_raster, ramp):
    z = ramp.astype(np.float32)
    z[2, 2] = np.nan
    dem = load_dem([write_raster(z)])
    assert np.isnan(dem.ground_m([2, 1.5, 2.5, 2], [2, 2.5, 1.5, 1.5])).all()
    assert np.isfinite(dem.ground_m([1, 1.5, 3, 2], [2, 1, 2.5, 1])).all()


@given(row=st.floats(0, 5), col=st.floats(0, 4))
def test_on_a_plane_the_surface_is_the_plane(row, col):
    z_m = np.add.outer(100.0 * np.arange(6), np.arange(5))
    dem = dem_from_array(z_m, UTM, CRS.from_epsg(32610))
    assert dem.ground_m(row, col) == pytest.approx(100.0 * row + col, abs=1e-6)


# ---- files as they come from the archives


@pytest.mark.parametrize(
    ("file", "options", "shape", "elevations_m", "voids", "crs", "metric_crs", "unit_from"),
    [
        ("terrain/N44W072.hgt", {}, (1201, 1201), (115, 1908), 0, 4326, 32619, "band"),
        ("terrain/sthelens_usgs_30m.dem", {}, (468, 327), (682, 2543), 4151, 26710, 26710, "band"),
        ("terrain/ventoux_srtm_3s_voids.tif", {}, (1201, 1201), (32, 2757), 4822, 4326, 32631, "assumed"),
        ("terrain/bigtujunga_srtm_30m.tif", {}, (643, 1197), (315, 2295), 0, 32611, 32611, "assumed"),
        ("terrain/yosemite_ned_1s.tif", {}, (875, 1027), (1175.38, 3567.53), 0, 4269, 32611, "assumed"),
        (
            "terrain/colorado_frontrange_srtm_3s.asc",
            {"crs": "EPSG:4326"},
            (144, 240),
            (1943, 3286),
            0,
            4326,
            32613,
            "assumed",
        ),
        (
            "photos/aletsch_aster_25m.tif",
            {"nodata": 0.0},
            (720, 693),
            (854, 4152),
            6891,
            21781,
            21781,
            "assumed",
        ),
    ],
)
def test_golden_files(skyfix_data, file, options, shape, elevations_m, voids, crs, metric_crs, unit_from):
    dem = load_dem([skyfix_data / file], **options)
    assert dem.z_m.shape == shape
    assert (np.nanmin(dem.z_m), np.nanmax(dem.z_m)) == pytest.approx(elevations_m, abs=0.01)
    assert np.count_nonzero(np.isnan(dem.z_m)) == voids == dem.files[0].voids
    assert dem.crs.to_epsg() == crs
    assert dem.metric_crs.to_epsg() == metric_crs
    assert dem.files[0].vertical_unit_from == unit_from


def test_an_ascii_grid_asks_for_its_crs(skyfix_data):
    with pytest.raises(DemError, match=r"colorado_frontrange_srtm_3s\.asc: .*--crs"):
        load_dem([skyfix_data / "terrain/colorado_frontrange_srtm_3s.asc"])


def test_tiles_cut_from_the_embedded_terrain_are_put_together_again(santa_cruz_file, tmp_path):
    whole = load_dem([santa_cruz_file])
    paths = []
    with rasterio.open(santa_cruz_file) as dataset:
        for name, rows, cols in (
            ("nw", (0, 401), (0, 300)),
            ("ne", (0, 401), (300, 800)),
            ("s", (400, 800), (0, 800)),
        ):
            window = rasterio.windows.Window.from_slices(rows, cols)
            path = Path(tmp_path / f"{name}.tif")
            profile = dataset.profile | {
                "height": rows[1] - rows[0],
                "width": cols[1] - cols[0],
                "transform": dataset.transform @ Affine.translation(cols[0], rows[0]),
                "tiled": False,
            }
            profile.pop("blockxsize", None)
            profile.pop("blockysize", None)
            with rasterio.open(path, "w", **profile) as part:
                part.write(dataset.read(1, window=window), 1)
            paths.append(path)
    assert np.array_equal(load_dem(paths).z_m, whole.z_m)
