"""The skyline predicted for a place: as high, as far and where the terrain's ridges are, with honest doubts."""

import json

import cv2
import numpy as np
import pytest
from affine import Affine
from pyproj import CRS, Geod

from localizer.dem.geodesy import lonlat_to_rowcol, rowcol_to_lonlat
from localizer.dem.horizon import EARTH_RADIUS_M, REFRACTION, prepare_terrain
from localizer.dem.lattice import dem_from_array, load_dem
from localizer.predict.depth import panorama
from localizer.predict.views import standpoint, view, warnings

SIDE, CELL_M = 201, 30.0
MIDDLE = (SIDE - 1) / 2


def terrain(z_m):
    transform = Affine(CELL_M, 0.0, 500_000.0 - SIDE * CELL_M / 2, 0.0, -CELL_M, 5_120_000.0)
    return prepare_terrain(dem_from_array(z_m, transform, CRS.from_epsg(32610)))


def plain_with(row, col, height_m, z_m=100.0):
    """A plain with a hill of a single cell."""
    out = np.full((SIDE, SIDE), z_m)
    out[row, col] += height_m
    return terrain(out)


def place_on(ground, mast_height_m=2.0, row=MIDDLE, col=MIDDLE):
    lon_deg, lat_deg = rowcol_to_lonlat(ground.dem, row, col)
    return standpoint(ground.dem, float(lat_deg), float(lon_deg), mast_height_m)


def test_a_summit_is_found_where_the_hill_stands():
    ground = plain_with(40, 100, 300.0)
    place = place_on(ground)
    (summit,) = view(ground, place, 10.0, 66.0).summits
    lon_deg, lat_deg = (float(v) for v in rowcol_to_lonlat(ground.dem, 40, 100))
    off_m = Geod(ellps="WGS84").inv(summit.lon_deg, summit.lat_deg, lon_deg, lat_deg)[2]
    assert off_m < 3.0
    assert summit.height_m == pytest.approx(400.0, abs=5.0)
    far_m = 60 * CELL_M
    drop_m = (1.0 - REFRACTION) * far_m**2 / (2.0 * EARTH_RADIUS_M)
    assert summit.distance_m == pytest.approx(far_m, abs=3.0)
    assert summit.elevation_deg == pytest.approx(np.degrees(np.arctan((298.0 - drop_m) / far_m)), abs=0.05)
    assert abs((summit.azimuth_deg + 180.0) % 360.0 - 180.0) < 0.1


def test_the_edge_of_the_dem_is_no_skyline_to_rely_upon():
    ground = plain_with(100, 150, 300.0)
    seen = view(ground, place_on(ground), 90.0, 20.0)
    hill = np.abs(seen.offset_deg) < 1.0
    assert not seen.at_edge[hill].any()
    assert seen.at_edge[np.abs(seen.offset_deg) > 3.0].all()
    assert any("edge of the DEM" in warning for warning in warnings(seen))
    (summit,) = seen.summits
    assert summit.azimuth_deg == pytest.approx(90.0, abs=0.1)


def test_the_border_of_a_void_is_as_unreliable_as_the_edge():
    z_m = np.full((SIDE, SIDE), 100.0)
    z_m[:, 130] = 150.0  # a wall in the east, and nothing known behind it
    solid = view(terrain(z_m), place_on(terrain(z_m)), 90.0, 40.0)
    assert not solid.at_edge.any()
    z_m[:, 131:] = np.nan
    assert view(terrain(z_m), place_on(terrain(z_m)), 90.0, 40.0).at_edge.all()


def test_land_beyond_the_edge_may_overtop_a_low_skyline_but_not_a_high_one():
    z_m = np.full((SIDE, SIDE), 100.0)
    z_m[:, 130] = 150.0  # a low wall in the east: 900 m away, the edge lies 3 km away
    z_m[:, 70] = 700.0  # a high one in the west
    z_m[5, 5] = 800.0  # as high as land is hereabouts
    ground = terrain(z_m)
    place = place_on(ground)
    assert view(ground, place, 90.0, 20.0).may_be_overtopped.all()
    assert not view(ground, place, 270.0, 20.0).may_be_overtopped.any()


def test_a_skyline_nearer_than_two_cells_is_reported():
    near, far = plain_with(100, 101, 30.0), plain_with(100, 104, 30.0)
    seen = view(near, place_on(near), 90.0, 10.0)
    assert seen.too_near.all()
    assert any("too coarse" in warning for warning in warnings(seen))
    assert not view(far, place_on(far), 90.0, 10.0).too_near.any()


def test_a_view_runs_on_through_north():
    ground = plain_with(40, 100, 300.0)
    place = place_on(ground)
    north = view(ground, place, 0.0, 60.0)
    around = view(ground, place, 350.0, 60.0)
    assert (np.diff(around.offset_deg) > 0.0).all()
    assert around.summits[0].azimuth_deg == pytest.approx(north.summits[0].azimuth_deg, abs=0.06)


def test_nearer_ridges_stand_before_farther_ones():
    z_m = np.full((SIDE, SIDE), 100.0)
    z_m[90] = 110.0  # 300 m north, 10 m high: up to 1.5°
    z_m[50] = 250.0  # 1500 m north: up to 5.6°
    ground = terrain(z_m)
    place = place_on(ground)
    land = panorama(ground, place, view(ground, place, 0.0, 10.0), -10.0, 10.0)
    distance_m, _ = land.at(np.zeros(4), np.array([-3.0, 0.9, 3.0, 6.0]))
    assert distance_m[0] < 100.0
    assert distance_m[1] == pytest.approx(300.0, abs=30.0)
    assert distance_m[2] == pytest.approx(1490.0, abs=40.0)
    assert np.isnan(distance_m[3])


# ---- the command


AT = ("--at", "37.25,-122.15")


@pytest.fixture
def predict(run, santa_cruz_file):
    def predict(*arguments):
        return run("predict", "--dem", santa_cruz_file, *arguments)

    return predict


def test_predict_says_north_east_south_and_west_in_true_degrees(predict):
    status, out, err = predict(*AT)
    assert (status, err) == (0, "")
    assert [line[0] for line in out.splitlines() if ": azimuth" in line] == list("NESW")
    assert "37.25000°, -122.15000° (WGS84), ground 630.0 m, camera 632.0 m" in out


def test_predicted_summits_lie_where_their_azimuth_and_distance_say(predict, santa_cruz_file):
    dem = load_dem([santa_cruz_file])
    out = json.loads(predict(*AT, "--azimuth", "20", "--azimuth", "-300", "--json")[1])
    assert [seen["azimuth_deg"] for seen in out["views"]] == [20.0, 60.0]
    summits = [summit for seen in out["views"] for summit in seen["summits"]]
    assert len(summits) > 3
    for summit in summits:
        azimuth_deg, _, distance_m = Geod(ellps="WGS84").inv(
            -122.15, 37.25, summit["lon_deg"], summit["lat_deg"]
        )
        assert azimuth_deg % 360.0 == pytest.approx(summit["azimuth_deg"], abs=0.01)
        assert distance_m == pytest.approx(summit["distance_m"], rel=1e-4)
        height_m = float(dem.ground_m(*lonlat_to_rowcol(dem, summit["lon_deg"], summit["lat_deg"])))
        assert summit["height_m"] == pytest.approx(height_m, abs=0.1)
        rise_m = height_m - 632.0 - (1 - REFRACTION) * distance_m**2 / (2 * EARTH_RADIUS_M)
        assert summit["elevation_deg"] == pytest.approx(np.degrees(np.arctan2(rise_m, distance_m)), abs=0.01)


def test_a_higher_mast_sees_the_skyline_lower(predict):
    low, high = (
        json.loads(predict(*AT, "--json", "--mast-height", height)[1])["views"][1]["skyline"]
        for height in ("2", "50")
    )
    assert all(b["elevation_deg"] < a["elevation_deg"] for a, b in zip(low, high, strict=True))


@pytest.mark.parametrize("by_camera", [False, True])
def test_predict_draws_a_picture_per_azimuth(predict, tmp_path, bundle_dir, by_camera):
    picture = tmp_path / "view.png"
    more = ("--camera", bundle_dir) if by_camera else ("--fov-deg", "40")
    assert predict(*AT, "--azimuth", "0", "--azimuth", "90", "--out", picture, *more)[0] == 0
    image = cv2.imread(str(picture)).astype(int)
    assert image.shape[0] > 400
    blue, green, red = np.moveaxis(image, -1, 0)
    assert ((green > blue + 20) & (green > red)).mean() > 0.02  # land
    assert ((blue > red + 10) & (blue > 235)).mean() > 0.1  # sky


def test_a_skyline_that_a_picture_cannot_hold_is_told(predict, tmp_path):
    camera = {"width_px": 640, "height_px": 24, "fx_px": 500.0, "fy_px": 500.0, "cx_px": 319.5, "cy_px": 11.5}
    file = tmp_path / "camera.json"
    file.write_text(json.dumps(camera))
    assert "lies above or below the picture" in predict(*AT, "--camera", file, "--azimuth", "270")[1]


def test_a_panorama_is_one_view_from_north_to_north_unless_asked_for_others(run, santa_cruz_file):
    def directions(*arguments):
        status, out, _ = run(
            "predict", "--dem", santa_cruz_file, *AT, "--fov-deg", "360", "--json", *arguments
        )
        assert status == 0
        return [seen["azimuth_deg"] for seen in json.loads(out)["views"]]

    assert directions() == [180.0]
    assert directions("--azimuth", "30", "--azimuth", "60") == [30.0, 60.0]


def test_every_bad_input_of_predict_is_told_in_one_line(
    refused, santa_cruz_file, write_raster, tmp_path, bundle_dir
):
    def bad(*arguments):
        return refused("predict", "--dem", santa_cruz_file, *arguments)

    assert "--at" in bad()
    for text in ("here", "37.25", "37.25,-122.15,3", "37.25;-122.15"):
        assert "is not LAT,LON" in bad("--at", text)
    for text in ("-122.15,37.25", "nan,1"):
        assert "the latitude comes first" in bad("--at", text)
    assert "lies outside the DEM, which reaches from 37.125" in bad("--at", "38,-122")
    assert "--azimuth" in bad(*AT, "--azimuth", "north")
    assert "--azimuth" in bad(*AT, "--azimuth", "nan")
    assert "--mast-height" in bad(*AT, "--mast-height", "-1")
    assert "--fov-deg" in bad(*AT, "--fov-deg", "0")
    for option in ("--mast-height", "--fov-deg"):
        assert "is not a finite number" in bad(*AT, option, "nan")
    assert "give one of" in bad(*AT, "--fov-deg", "60", "--camera", bundle_dir)
    assert "no picture format" in bad(*AT, "--out", tmp_path / "view.txt")
    assert "no such folder" in bad(*AT, "--out", tmp_path / "nowhere" / "view.png")
    (tmp_path / "folder.png").mkdir()
    assert "is a folder; name a file" in bad(*AT, "--out", tmp_path / "folder.png")
    assert "No such file" in bad(*AT, "--camera", tmp_path / "nowhere.json")
    broken = tmp_path / "broken.json"
    broken.write_text("{")
    assert "is not JSON" in bad(*AT, "--camera", broken)
    broken.write_text("[" * 100_000)
    assert "is not JSON" in bad(*AT, "--camera", broken)
    broken.write_text('{"camera": {"width_px": 640}}')
    assert "camera.height_px" in bad(*AT, "--camera", broken)
    broken.write_text("[]")
    assert "camera" in bad(*AT, "--camera", broken)
    assert "no such file" in refused("predict", "--dem", tmp_path / "nowhere.tif", *AT)
    z = np.full((40, 50), 900.0, np.float32)
    z[10:30, 10:30] = np.nan
    void = write_raster(z, "void.tif", crs="EPSG:4326", transform=Affine(0.001, 0, -122.0, 0, -0.001, 37.0))
    assert "lies in a void" in refused("predict", "--dem", void, "--at", "36.98,-121.98")
