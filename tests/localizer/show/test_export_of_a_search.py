"""From pictures to the files of a report, without anything in between being made up."""

import json

import cv2
import numpy as np
import pyogrio
import pytest
import rasterio

from localizer.bundle import Bundle, Camera, Frame, load_bundle, sha256_of
from localizer.camera import azimuth_elevation_deg, camera_to_world, pixel_rays
from localizer.dem.geodesy import lonlat_to_rowcol
from localizer.dem.horizon import horizon, prepare_terrain
from localizer.dem.lattice import load_dem
from localizer.search.locate import locate_bundle

PLACE = (300.3, 420.6)
COMPASS_ERROR_DEG = 0.4
MAST_HEIGHT_M = 2.0
CAMERA = Camera(width_px=320, height_px=240, fx_px=246.4, fy_px=246.4, cx_px=159.5, cy_px=119.5)


@pytest.fixture
def seen(santa_cruz_file, tmp_path):
    """A bundle of plain sky over plain ground, as the terrain has it around PLACE, with a compass that is off."""
    terrain = prepare_terrain(load_dem([santa_cruz_file]))
    altitude_m = float(terrain.dem.ground_m(*PLACE)) + MAST_HEIGHT_M
    around_deg = np.arange(-180.0, 180.0, 0.05)
    skyline_deg = horizon(terrain, *PLACE, altitude_m, around_deg)[0][0]
    u_px, v_px = np.meshgrid(np.arange(CAMERA.width_px), np.arange(CAMERA.height_px))
    frames = []
    for label, azimuth_deg in zip("NESW", (0.0, 90.0, 180.0, 270.0), strict=True):
        near = np.abs((around_deg - azimuth_deg + 180.0) % 360.0 - 180.0) < 30.0
        tilt_deg = float(np.median(skyline_deg[near]))
        rays = pixel_rays(CAMERA, u_px.ravel(), v_px.ravel()) @ camera_to_world(azimuth_deg, tilt_deg, 0.0).T
        ray_azimuth_deg, ray_elevation_deg = azimuth_elevation_deg(rays)
        edge_deg = np.interp(ray_azimuth_deg, around_deg, skyline_deg, period=360.0)
        blur = np.clip(0.5 + (ray_elevation_deg - edge_deg) / 0.2325, 0.0, 1.0).reshape(u_px.shape)[..., None]
        picture = blur * np.array([235.0, 200.0, 170.0]) + (1.0 - blur) * np.array([40.0, 60.0, 50.0])
        file = tmp_path / f"{label}.png"
        cv2.imwrite(str(file), np.round(picture).astype(np.uint8))
        frames.append(
            Frame(
                label=label,
                file=file.name,
                sha256=sha256_of(file),
                time="2026-11-23T04:31:40Z",
                azimuth_deg=(azimuth_deg + COMPASS_ERROR_DEG) % 360.0,
                azimuth_sigma_deg=0.02,
                tilt_deg=tilt_deg,
                tilt_sigma_deg=0.01,
                roll_deg=0.0,
                roll_sigma_deg=0.01,
            )
        )
    bundle = Bundle(
        id="whole",
        created="2026-11-23T04:31:51Z",
        camera=CAMERA,
        mast_height_m=MAST_HEIGHT_M,
        altitude={"value_m": altitude_m, "sigma_m": 5.0},
        azimuth_bias_sigma_deg=0.5,
        tilt_bias_sigma_deg=0.02,
        frames=frames,
    )
    (tmp_path / "bundle.json").write_text(bundle.to_json())
    return tmp_path


def test_a_report_of_a_search_leads_every_program_to_the_true_place(run, seen, santa_cruz_file):
    dem = load_dem([santa_cruz_file])
    folder = seen / "report"
    status, out, err = run("locate", seen, "--dem", santa_cruz_file, "--json", "--report", folder)
    assert (status, err) == (0, "")
    position = json.loads(out)["position"]
    for name, layer in (("candidates.geojson", None), ("fix.gpx", "waypoints"), ("fix.kml", None)):
        lon_deg, lat_deg = np.frombuffer(pyogrio.raw.read(folder / name, layer=layer)[2][0], "<f8", 2, 5)
        assert (lat_deg, lon_deg) == pytest.approx((position["lat_deg"], position["lon_deg"]), abs=1e-7)
        assert [float(v) for v in lonlat_to_rowcol(dem, lon_deg, lat_deg)] == pytest.approx(PLACE, abs=0.2)
    with rasterio.open(folder / "posterior.tif") as raster:
        probability = raster.read(1)
        row, col = np.unravel_index(int(probability.argmax()), probability.shape)
        x, y = raster.xy(row, col)
    assert probability.clip(0.0).sum() == pytest.approx(1.0, abs=1e-3)
    assert np.round(lonlat_to_rowcol(dem, x, y)) == pytest.approx(np.round(PLACE))


def test_the_details_of_a_search_hold_what_the_report_shows(seen, santa_cruz_file):
    result = locate_bundle(load_bundle(seen), load_dem([santa_cruz_file]))
    fix, details = result.fix, result.details
    assert details.candidate_covariances_m2[0] == pytest.approx(np.array(fix.covariance_m2))
    assert details.candidates_rowcol[0] == pytest.approx((fix.position.row, fix.position.col))
    assert len(details.candidates_rowcol) == len(details.candidate_covariances_m2) == len(fix.candidates)
    assert fix.nuisance.azimuth_bias_deg == pytest.approx(COMPASS_ERROR_DEG, abs=0.05)
    assert details.errors.inlier_share > 0.95
    assert details.errors.dem_error_m < 1.0
    for frame in details.frames:
        assert np.abs(frame.errors_deg).max() < 0.03


@pytest.mark.long
def test_a_frame_that_contradicts_is_named_and_the_place_is_found_without_it(run, seen, santa_cruz_file):
    fields = json.loads((seen / "bundle.json").read_text())
    fields["frames"][1]["tilt_deg"] += 2.0
    (seen / "bundle.json").write_text(json.dumps(fields))
    folder = seen / "report"
    status, out, err = run("locate", seen, "--dem", santa_cruz_file, "--json", "--report", folder)
    assert status == 0
    assert err.startswith("localizer: frame E: left out, for it contradicts the others")
    assert err.count("\n") == 1
    fix = json.loads(out)
    assert sorted(fix["residual"]) == ["N", "S", "W"]
    assert (fix["position"]["row"], fix["position"]["col"]) == pytest.approx(PLACE, abs=0.3)
    assert "frame E: left out" in (folder / "report.html").read_text()
