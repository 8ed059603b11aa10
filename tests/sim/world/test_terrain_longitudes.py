"""The simulator's own terrain where longitudes run beyond 180, and its metres where a map's are none."""

import numpy as np
import pytest
import rasterio
from affine import Affine
from click.testing import CliRunner
from pyproj import Geod

from sim.commands.cli import sim
from sim.world.scenario import Place
from sim.world.terrain import read_terrain

STEP = 1 / 3600
GEOD = Geod(ellps="WGS84")


def written(path, west, north=52.0, cols=60, epsg=4326, step=STEP):
    with rasterio.open(
        path,
        "w",
        driver="GTiff",
        height=40,
        width=cols,
        count=1,
        dtype="float32",
        crs=f"EPSG:{epsg}",
        transform=Affine(step, 0.0, west, 0.0, -step, north),
    ) as file:
        file.write(np.full((40, cols), 500.0, np.float32), 1)
    return path


@pytest.mark.parametrize("west", [241.78, -478.22, -118.22, 179.99, -180.01])
def test_a_place_is_found_by_either_longitude_and_comes_out_wrapped(tmp_path, west):
    terrain = read_terrain([written(tmp_path / "dem.tif", west)])
    row, col = np.mgrid[0:39:5j, 0:59:5j]
    lon_deg, lat_deg = terrain.lonlat_deg(row, col)
    assert (lon_deg >= -180.0).all()
    assert (lon_deg < 180.0).all()
    for turns in (-1, 0, 1):
        back = terrain.row_col(lon_deg + 360.0 * turns, lat_deg)
        assert back[0] == pytest.approx(row, abs=1e-6)
        assert back[1] == pytest.approx(col, abs=1e-6)


@pytest.mark.parametrize("swapped", [False, True])
def test_tiles_on_both_sides_of_the_date_line_adjoin(tmp_path, swapped):
    tiles = [
        written(tmp_path / "W.tif", 180.0 - 30 * STEP, cols=30),
        written(tmp_path / "E.tif", -180.0, cols=20),
    ]
    terrain = read_terrain(tiles[::-1] if swapped else tiles)
    assert terrain.height_m.shape == (40, 50)
    lon_deg, _ = terrain.lonlat_deg(10.0, np.array([29.0, 30.0]))
    assert lon_deg == pytest.approx([180.0 - 0.5 * STEP, -180.0 + 0.5 * STEP])
    assert terrain.metric_crs.to_epsg() in (32601, 32660)


def test_web_mercator_beyond_its_seam(tmp_path):
    terrain = read_terrain(
        [written(tmp_path / "dem.tif", 20_037_508.34 - 900.0, 1.05e7, epsg=3857, step=30.0)]
    )
    lon_deg, lat_deg = terrain.lonlat_deg(20.0, np.array([10.0, 50.0]))
    assert lon_deg[0] > 179.9
    assert lon_deg[1] < -179.9
    assert terrain.row_col(lon_deg, lat_deg)[1] == pytest.approx([10.0, 50.0], abs=1e-6)


def test_the_size_of_a_cell_is_of_the_ground(tmp_path):
    terrain = read_terrain([written(tmp_path / "dem.tif", 1_680_000.0, 1.055e7, epsg=3857, step=75.0)])
    lon_deg, lat_deg = terrain.lonlat_deg(np.array([19.0, 20.0, 19.0]), np.array([29.0, 29.0, 30.0]))
    south_m = GEOD.inv(lon_deg[0], lat_deg[0], lon_deg[1], lat_deg[1])[2]
    east_m = GEOD.inv(lon_deg[0], lat_deg[0], lon_deg[2], lat_deg[2])[2]
    assert terrain.cell_size_m() == pytest.approx((south_m, east_m), rel=1e-3)
    assert 25.0 < south_m < 30.0


@pytest.mark.parametrize(
    ("west", "north", "epsg"),
    [(5.3, 60.4, 32632), (15.6, 78.2, 32633), (8.9, 78.2, 32631), (20.0, 85.0, 5041)],
)
def test_the_zone_is_the_one_that_the_localizer_takes(tmp_path, west, north, epsg):
    assert read_terrain([written(tmp_path / "dem.tif", west, north)]).metric_crs.to_epsg() == epsg


def test_a_vehicle_may_be_sent_to_a_place_in_either_convention(monkeypatch):
    assert Place(lat_deg=34.3, lon_deg=241.8).lon_deg == 241.8
    monkeypatch.delenv("SKYFIX_CONFIG", raising=False)
    done = CliRunner().invoke(sim, ["drive", "34.3", "241.8"])
    assert "SKYFIX_CONFIG is not set" in str(done.exception or done.output)  # the place itself was taken
