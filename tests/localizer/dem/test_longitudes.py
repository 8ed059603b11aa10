"""Longitudes beyond 180: elevation models in 0..360 or -360..0, on both sides of the date line, on a cylinder beyond its seam.

Whatever goes in, -180 <= lon < 180 comes out, and a place is found by either of its longitudes.
"""

import itertools
import json
import xml.etree.ElementTree as ET

import numpy as np
import pytest
import rasterio
from affine import Affine
from click.testing import CliRunner
from fakes.results import a_result
from hypothesis import given
from hypothesis import strategies as st
from pyproj import CRS, Geod

from localizer.bundle import load_bundle
from localizer.commands.cli import localizer
from localizer.commands.predict import parse_place
from localizer.dem.crs import utm_crs, wrapped_deg, wrapped_lon_deg, x_period
from localizer.dem.geodesy import (
    bounds_deg,
    geodesic_expansion,
    lonlat_to_rowcol,
    rowcol_to_lonlat,
    rowcol_to_metric,
)
from localizer.dem.horizon import prepare_terrain
from localizer.dem.lattice import dem_from_array, load_dem
from localizer.fix import Position, lat_lon
from localizer.observation import Observation, PriorCircle
from localizer.predict.views import standpoint
from localizer.search.prior_circle import cells_within_prior
from localizer.show.candidates import places
from localizer.show.posterior import posterior
from localizer.show.report_folder import files_beside
from localizer.track.gaussian_place import displaced, gaussian_place

GEOD = Geod(ellps="WGS84")
STEP = 1 / 3600
ROWS, COLS = 40, 60
# west edge of the lattice in its own CRS, and the longitude of its middle
LATTICES = {
    "0..360": (4326, 241.78, -118.22),
    "-540..-180": (4326, -478.22, -118.22),
    "ordinary": (4326, -118.22, -118.22),
    "across 180, the west first": (4326, 180.0 - COLS / 2 * STEP, 180.0),
    "across -180, the east first": (4326, -180.0 - COLS / 2 * STEP, 180.0),
    "just west of 180": (4326, 180.0 - COLS * STEP, 180.0),
    "just east of 180": (4326, 180.0, -180.0),
    "just east of -180": (4326, -180.0, -180.0),
    "grads from Paris": (4807, 195.0, None),
}


def lattice(name):
    epsg, west, _ = LATTICES[name]
    rows, cols = np.mgrid[:ROWS, :COLS]
    z_m = 900.0 + 200.0 * np.sin(rows / 9) * np.cos(cols / 7)
    return dem_from_array(z_m, Affine(STEP, 0.0, west, 0.0, -STEP, 52.0), CRS.from_epsg(epsg))


def on_a_cylinder():
    """Web Mercator from 179.9 degrees on, beyond the seam at 20037508 m."""
    rows, cols = np.mgrid[:ROWS, :COLS]
    return dem_from_array(
        500.0 + 5.0 * rows + cols,
        Affine(300.0, 0.0, 20037508.34 - 9_000.0, 0.0, -300.0, 6_800_000.0),
        CRS.from_epsg(3857),
    )


def wrapped(lon):
    return (np.asarray(lon) >= -180.0).all() and (np.asarray(lon) < 180.0).all()


@given(st.floats(-1e5, 1e5))
def test_wrapping_is_by_whole_turns_into_the_half_open_range(lon_deg):
    out = wrapped_lon_deg(lon_deg)
    assert -180.0 <= out < 180.0
    assert (out - lon_deg) / 360.0 == pytest.approx(round((out - lon_deg) / 360.0), abs=1e-9)
    if -180.0 <= lon_deg < 180.0:
        assert out == lon_deg  # to the last bit


def test_what_is_nowhere_stays_nowhere():
    assert np.array_equal(wrapped_deg([np.inf, 190.0, np.nan]), [np.inf, -170.0, np.nan], equal_nan=True)
    assert wrapped_lon_deg(180.0) == wrapped_lon_deg(-180.0) == wrapped_lon_deg(540.0) == -180.0


@pytest.mark.parametrize("name", LATTICES)
def test_every_place_comes_out_wrapped_and_is_found_by_either_longitude(name):
    dem = lattice(name)
    row, col = np.mgrid[0 : ROWS - 1 : 7j, 0 : COLS - 1 : 7j]
    lon_deg, lat_deg = rowcol_to_lonlat(dem, row, col)
    assert wrapped(lon_deg)
    for turns in (-1, 0, 1):
        back = lonlat_to_rowcol(dem, lon_deg + 360.0 * turns, lat_deg)
        assert back[0] == pytest.approx(row, abs=1e-3)  # a datum there and back costs some
        assert back[1] == pytest.approx(col, abs=1e-3)


def test_a_map_on_a_cylinder_goes_on_beyond_its_seam():
    dem = on_a_cylinder()
    assert x_period(dem.crs) == pytest.approx(2.0 * np.pi * 6378137.0)
    row, col = np.mgrid[0 : ROWS - 1 : 5j, 0 : COLS - 1 : 9j]
    lon_deg, lat_deg = rowcol_to_lonlat(dem, row, col)
    assert wrapped(lon_deg)
    assert (lon_deg > 179.0).any()
    assert (lon_deg < -179.0).any()
    back = lonlat_to_rowcol(dem, lon_deg, lat_deg)
    assert back[1] == pytest.approx(col, abs=1e-6)
    easting_m, _ = rowcol_to_metric(dem, row, col)
    assert np.ptp(easting_m) == pytest.approx(300.0 * (COLS - 1))
    # rays run on over the seam
    steps = geodesic_expansion(dem).coefficients[..., 1, 0]
    assert np.ptp(steps) < 1e-2 * abs(steps.mean())


@pytest.mark.parametrize("name", [name for name in LATTICES if LATTICES[name][2] is not None])
def test_a_prior_s_circle_lies_where_it_is_in_either_convention(name):
    terrain = prepare_terrain(lattice(name))
    lon_deg, lat_deg = (float(v) for v in rowcol_to_lonlat(terrain.dem, 20.0, 30.0))
    for turned in (lon_deg, lon_deg + 360.0, lon_deg - 360.0):
        circle = PriorCircle(lat_deg, turned, 200.0)
        within = cells_within_prior(terrain, Observation((), 2.0, None, np.inf, 0.5, 0.02, circle))
        assert within[20, 30]
        assert 100 < within.sum() < 400


def test_a_position_is_wrapped_whoever_makes_it():
    there = {"easting_m": 0.0, "northing_m": 0.0, "crs": "EPSG:32611", "lat_deg": 34.3, "lon_deg": 241.78}
    made = Position(**there, ground_m=1.0, row=1.0, col=1.0)
    assert made.lon_deg == pytest.approx(-118.22)
    assert lat_lon(made).endswith("118.22000° W")
    assert json.loads(made.model_dump_json())["lon_deg"] == pytest.approx(-118.22)


def test_a_vehicle_that_drives_over_the_date_line_is_tracked_over_it():
    sigma = np.eye(2)
    there = displaced(gaussian_place(52.0, 179.9999, sigma, 0.0 * sigma), np.array([50.0, 0.0]), sigma)
    assert -180.0 <= there.lon_deg < -179.9
    back = displaced(there, np.array([-50.0, 0.0]), sigma)
    assert back.lon_deg == pytest.approx(179.9999, abs=1e-6)
    assert displaced(gaussian_place(0.0, 180.0, sigma, 0.0 * sigma), np.zeros(2), sigma).lon_deg == -180.0


@pytest.mark.parametrize("text", ["34.3,241.8", "34.3,-118.2", "34.3, -118.2"])
def test_a_place_is_named_in_either_convention(text):
    dem = lattice("0..360")
    _, lon_deg = parse_place(text)
    assert lon_deg == pytest.approx(-118.2)
    centre = rowcol_to_lonlat(dem, 20.0, 30.0)
    for turned in (0.0, 360.0):
        at = standpoint(dem, float(centre[1]), float(centre[0]) + turned, 2.0)
        assert (at.row, at.col) == pytest.approx((20.0, 30.0), abs=1e-6)


def test_bounds_across_the_date_line_run_from_the_west_to_the_east():
    south, west, north, east = bounds_deg(lattice("across 180, the west first"), [0, ROWS - 1], [0, COLS - 1])
    assert west == pytest.approx(180.0 - 29.5 * STEP)
    assert east == pytest.approx(-180.0 + 29.5 * STEP)
    assert south < north


@pytest.mark.parametrize("order", list(itertools.permutations(["W", "E"])))
@pytest.mark.parametrize("east_of", [-180.0, 180.0])
def test_tiles_at_the_date_line_join_in_any_order(tmp_path, order, east_of):
    edges = {"W": 180.0 - 30 * STEP, "E": east_of}
    for tile, west in edges.items():
        with rasterio.open(
            tmp_path / f"{tile}.tif",
            "w",
            driver="GTiff",
            height=ROWS,
            width=30,
            count=1,
            dtype="float32",
            crs="EPSG:4326",
            transform=Affine(STEP, 0.0, west, 0.0, -STEP, 52.0),
        ) as file:
            file.write(np.full((ROWS, 30), 300.0 if tile == "W" else 500.0, np.float32), 1)
    dem = load_dem([tmp_path / f"{tile}.tif" for tile in order])
    assert dem.z_m.shape == (ROWS, 60)
    lon_deg, lat_deg = rowcol_to_lonlat(dem, 10.0, np.array([29.0, 30.0]))
    assert wrapped(lon_deg)
    assert lon_deg == pytest.approx([180.0 - 0.5 * STEP, -180.0 + 0.5 * STEP])
    assert dem.ground_m(*lonlat_to_rowcol(dem, lon_deg, lat_deg)) == pytest.approx([300.0, 500.0])


# ---- exports


def exported(dem, bundle_dir, col, covariance_m2=((900.0, 0.0), (0.0, 400.0))):
    result = a_result(dem, [(20.0, col, 0.999)], covariance_m2=covariance_m2)
    found = places(result, dem)
    files = files_beside(found, posterior(found, dem), load_bundle(bundle_dir), result, dem)
    return found[0], files


def rings_of(geometry):
    if geometry["type"] == "Polygon":
        return [geometry["coordinates"][0]]
    return [polygon[0] for polygon in geometry["coordinates"]]


def area(ring):
    """Signed, of a closed ring: positive counter-clockwise."""
    x, y = np.array(ring).T
    return 0.5 * float(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]))


@pytest.mark.parametrize("name", ["across 180, the west first", "across -180, the east first"])
@pytest.mark.parametrize("col", [25.0, 29.0, 29.5, 30.0, 34.0])
def test_an_ellipse_over_the_date_line_is_cut_there(bundle_dir, name, col):
    """RFC 7946, 3.1.9: in two parts, none of which crosses it."""
    found, files = exported(lattice(name), bundle_dir, col)
    point, polygon = json.loads(files["candidates.geojson"])["features"]
    assert -180.0 <= point["geometry"]["coordinates"][0] < 180.0
    rings = rings_of(polygon["geometry"])
    assert len(rings) == (2 if 26.0 <= col <= 33.0 else 1) or col in (25.0, 34.0)
    whole = 0.0
    for ring in rings:
        lon = np.array(ring)[:, 0]
        assert (np.abs(lon) <= 180.0).all()
        assert np.ptp(lon) < 1.0
        assert ring[0] == ring[-1]
        assert area(ring) > 0.0  # counter-clockwise
        whole += area(ring)
    per_degree_m = 111_320.0 * np.cos(np.radians(found.lat_deg)), 111_250.0
    expected_m2 = np.pi * 5.991 * 30.0 * 20.0
    assert whole * per_degree_m[0] * per_degree_m[1] == pytest.approx(expected_m2, rel=0.02)


@pytest.mark.parametrize("epsg", [3413, 3031])
@pytest.mark.parametrize("col", [29.5, 31.0])
def test_an_ellipse_around_a_pole_reaches_up_to_it_at_all_longitudes(bundle_dir, epsg, col):
    dem = dem_from_array(
        np.full((ROWS, COLS), 900.0), Affine(30.0, 0.0, -900.0, 0.0, -30.0, 600.0), CRS.from_epsg(epsg)
    )
    _, files = exported(dem, bundle_dir, col)
    point, polygon = json.loads(files["candidates.geojson"])["features"]
    (ring,) = rings_of(polygon["geometry"])
    lon, lat = np.array(ring).T
    assert (lon.min(), lon.max()) == (-180.0, 180.0)
    assert ring[0] == ring[-1]
    assert area(ring) > 0.0
    pole = 90.0 if epsg == 3413 else -90.0
    assert sorted(lon[lat == pole].tolist())[-1] == 180.0
    assert np.abs(lat - pole).max() * 111_690.0 < 2.5 * 30.0 + 30.0 * abs(col - 29.5) + 5.0
    assert abs(point["geometry"]["coordinates"][1]) <= 90.0


@pytest.mark.parametrize("name", ["0..360", "-540..-180", "across 180, the west first"])
def test_waypoints_and_placemarks_lie_within_what_their_schemas_allow(bundle_dir, name):
    found, files = exported(lattice(name), bundle_dir, 31.0)
    (waypoint,) = ET.fromstring(files["fix.gpx"]).findall("{*}wpt")
    assert float(waypoint.get("lon")) == pytest.approx(found.lon_deg, abs=1e-7)
    assert -180.0 <= float(waypoint.get("lon")) < 180.0  # GPX 1.1, longitudeType
    (text,) = [e.text for e in ET.fromstring(files["fix.kml"]).iter() if e.tag.endswith("coordinates")]
    assert float(text.split(",")[0]) == pytest.approx(found.lon_deg, abs=1e-7)


@pytest.mark.parametrize("lon_deg", [179.99999998, -179.99999998])
def test_a_place_that_rounds_to_the_date_line_is_still_below_180(bundle_dir, lon_deg):
    dem = lattice("across 180, the west first")
    row, col = (float(v) for v in lonlat_to_rowcol(dem, lon_deg, 51.99))
    result = a_result(dem, [(row, col, 0.999)])
    found = places(result, dem)
    files = files_beside(found, posterior(found, dem), load_bundle(bundle_dir), result, dem)
    (waypoint,) = ET.fromstring(files["fix.gpx"]).findall("{*}wpt")
    assert float(waypoint.get("lon")) == -180.0
    assert json.loads(files["candidates.geojson"])["features"][0]["geometry"]["coordinates"][0] == -180.0


# ---- the map's zone


@pytest.mark.parametrize(
    ("lat_deg", "lon_deg", "epsg"),
    [
        (34.3, -118.2, 32611),
        (34.3, 241.8, 32611),
        (52.0, 180.0, 32601),
        (52.0, -180.0, 32601),
        (52.0, -180.0 - 1e-9, 32660),
        (52.0, 179.9999, 32660),
        (60.4, 5.3, 32632),  # Bergen lies in 32V
        (60.4, 2.9, 32631),
        (64.0, 5.3, 32631),
        (78.2, 15.6, 32633),  # Longyearbyen, 33X
        (78.2, 8.9, 32631),
        (78.2, 21.0, 32635),
        (78.2, 41.9, 32637),
        # 32V reaches from 3 to 12 degrees east and from 56 to 64 north, Svalbard's zones from 72 north on
        (56.0, 3.0, 32632),
        (55.99, 3.0, 32631),
        (63.99, 11.99, 32632),
        (60.0, 12.0, 32633),
        (72.0, 8.99, 32631),
        (72.0, 9.0, 32633),
        (71.99, 9.0, 32632),
        (75.0, 0.0, 32631),
        (75.0, -0.01, 32630),
        (75.0, 33.0, 32637),
        (75.0, 42.0, 32638),
        (0.0, 9.0, 32632),
        (-0.001, 9.0, 32732),
        (-80.0, 10.0, 32732),
        (-33.4, -70.6, 32719),
        (84.0, 10.0, 32633),
        (84.1, 10.0, 5041),
        (-80.1, 10.0, 5042),
    ],
)
def test_the_zone_of_a_place_is_the_grid_s_own(lat_deg, lon_deg, epsg):
    assert utm_crs(float(lon_deg), lat_deg).to_epsg() == epsg


# ---- by the command


def written(path, west):
    rows, cols = np.mgrid[:80, :120]
    z_m = (600 + 250 * np.sin(rows / 9) * np.cos(cols / 11)).astype(np.float32)
    with rasterio.open(
        path,
        "w",
        driver="GTiff",
        height=80,
        width=120,
        count=1,
        dtype="float32",
        crs="EPSG:4326",
        transform=Affine(STEP, 0.0, west, 0.0, -STEP, 52.0),
    ) as file:
        file.write(z_m, 1)
    return path


@pytest.mark.parametrize(("west", "lon_deg"), [(241.78, -118.20), (180.0 - 60 * STEP, -179.9995)])
def test_predict_says_longitudes_that_everybody_knows(tmp_path, west, lon_deg):
    dem = written(tmp_path / "dem.tif", west)
    told = []
    for given_lon in (lon_deg, lon_deg + 360.0):
        done = CliRunner().invoke(
            localizer,
            ["predict", "--dem", str(dem), "--at", f"51.99,{given_lon}", "--azimuth", "90", "--json"],
        )
        assert done.exit_code == 0, done.output
        told.append(json.loads(done.output))
    assert told[0]["place"] == pytest.approx(told[1]["place"])
    assert told[0]["place"]["lon_deg"] == pytest.approx(lon_deg)
    assert wrapped([summit["lon_deg"] for view in told[0]["views"] for summit in view["summits"]])


def test_a_place_outside_is_told_the_bounds_that_everybody_knows(tmp_path):
    dem = written(tmp_path / "dem.tif", 241.78)
    done = CliRunner().invoke(localizer, ["predict", "--dem", str(dem), "--at", "51.99,10"])
    assert "from -118.21986 to -118.18681 east" in str(done.exception)
