"""From the rig to the fix on elevation models of 0..360 degrees, at the date line, and in Web Mercator at 68 north."""

import json
import subprocess
from pathlib import Path

import numpy as np
import pytest
from pyproj import Geod

from localizer.dem.geodesy import lonlat_to_rowcol, map_metres_at, rowcol_to_lonlat
from localizer.dem.ground import ground_distance_m
from localizer.dem.lattice import load_dem
from sim.launch.child_command import find_command
from sim.world.terrain import read_terrain

MODELS = {"geo360": ["geo360.tif"], "date line": ["dl_W.tif", "dl_E.tif"], "mercator": ["merc68.tif"]}
GEOD = Geod(ellps="WGS84")


def files_of(skyfix_data: Path, name: str) -> list[Path]:
    return [skyfix_data / "reports" / "dem" / file for file in MODELS[name]]


@pytest.mark.parametrize("name", MODELS)
def test_both_programs_agree_on_every_place_and_on_its_metres(skyfix_data: Path, name: str) -> None:
    files = files_of(skyfix_data, name)
    dem, terrain = load_dem(files), read_terrain(files)
    assert terrain.height_m.shape == dem.z_m.shape
    assert terrain.metric_crs == dem.metric_crs
    assert terrain.cell_size_m() == pytest.approx((dem.spacing_ns_m, dem.spacing_ew_m), rel=1e-4)
    row, col = np.mgrid[0 : dem.rows - 1 : 5j, 0 : dem.cols - 1 : 5j]
    lon_deg, lat_deg = rowcol_to_lonlat(dem, row, col)
    assert (lon_deg >= -180.0).all()
    assert (lon_deg < 180.0).all()
    assert np.array(terrain.lonlat_deg(row, col)) == pytest.approx(np.array([lon_deg, lat_deg]), abs=1e-9)
    for turns in (-1, 0, 1):
        assert np.array(lonlat_to_rowcol(dem, lon_deg + 360.0 * turns, lat_deg)) == pytest.approx(
            np.array([row, col]), abs=1e-5
        )
    here = map_metres_at(dem, dem.rows / 2, dem.cols / 2)
    assert here.scale == pytest.approx(2.70 if name == "mercator" else 1.0, abs=0.02)


@pytest.mark.long
@pytest.mark.parametrize("name", MODELS)
def test_a_fix_there_is_in_metres_of_the_ground(skyfix_data: Path, name: str, tmp_path: Path) -> None:
    dems = [word for file in files_of(skyfix_data, name) for word in ("--dem", str(file))]
    done = subprocess.run(
        [find_command("sim"), "demo", *dems, "--seed", "3", "--out", str(tmp_path), "--json"],
        capture_output=True,
        text=True,
        check=True,
    )
    told = json.loads(done.stdout)
    fix, truth = told["fix"], told["truth"]
    assert fix["status"] == "fix"
    place = fix["position"]
    assert -180.0 <= place["lon_deg"] < 180.0
    off_m = GEOD.inv(place["lon_deg"], place["lat_deg"], truth["lon_deg"], truth["lat_deg"])[2]
    assert told["error_m"] == pytest.approx(off_m, abs=0.01)
    assert off_m == pytest.approx(
        ground_distance_m(
            place["crs"],
            (place["easting_m"], place["northing_m"]),
            (truth["easting_m"], truth["northing_m"]),
        ),
        abs=0.01,
    )
    major_m = float(np.sqrt(np.linalg.eigvalsh(fix["covariance_m2"])[-1]))
    assert told["claimed"]["major_m"] == pytest.approx(major_m)
    assert told["error_sigmas"] < 4.0
