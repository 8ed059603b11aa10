"""The simulator's own reading of DEM files."""

import gzip
import os
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import rasterio
from hypothesis import given
from hypothesis import strategies as st

from sim.errors import SimulationError
from sim.world.terrain import crs_name, read_terrain
from sim.world.truth import World

WriteDem = Callable[..., Path]


def test_cell_centres_are_at_whole_numbers(santa_cruz: Path) -> None:
    terrain = read_terrain([santa_cruz])
    lon, lat = terrain.lonlat_deg(0.0, 0.0)
    assert terrain.height_m.shape == (800, 800)
    # Row 2350 and column 2600 of the tile N37 W123, whose first point is 38 N 123 W.
    assert lon == pytest.approx(-123.0 + 2600 / 3600)
    assert lat == pytest.approx(38.0 - 2350 / 3600)
    assert crs_name(terrain.metric_crs) == "EPSG:32610"
    assert terrain.cell_size_m() == pytest.approx((30.82, 24.65), abs=0.03)


@given(row=st.floats(0.0, 799.0), col=st.floats(0.0, 799.0))
def test_lattice_and_geographic_positions_are_inverse(world: World, row: float, col: float) -> None:
    terrain = world.surface.terrain
    back_row, back_col = terrain.row_col(*terrain.lonlat_deg(row, col))
    assert (float(back_row), float(back_col)) == pytest.approx((row, col), abs=1e-6)


def test_adjoining_files_are_one_terrain(write_dem: WriteDem) -> None:
    heights = np.arange(60.0).reshape(6, 10)
    north = write_dem(heights[:4], corner=(0.0, 180.0), name="north.tif")
    south_west = write_dem(heights[3:, :5], corner=(0.0, 90.0), name="south_west.tif")  # overlaps by a row
    terrain = read_terrain([south_west, north])
    expected = heights.copy()
    expected[4:, 5:] = np.nan
    np.testing.assert_array_equal(terrain.height_m, expected)
    assert terrain.easting_northing_m(0.0, 0.0) == pytest.approx((15.0, 165.0))


def test_feet_become_metres_and_voids_nan(write_dem: WriteDem) -> None:
    heights = np.array([[100.0, -9999.0], [200.0, 300.0]])
    terrain = read_terrain([write_dem(heights, unit="ft", void=-9999.0)])
    np.testing.assert_allclose(terrain.height_m, [[30.48, np.nan], [60.96, 91.44]], rtol=1e-6)


def test_what_is_wrong_with_a_file_is_said_in_one_line(write_dem: WriteDem, tmp_path: Path) -> None:
    hills = np.ones((4, 4))
    text = tmp_path / "notes.txt"
    text.write_text("no raster")
    pipe = tmp_path / "pipe.tif"
    os.mkfifo(pipe)
    cases = {
        "names no CRS": [write_dem(hills, crs=None, name="bare.tif")],
        "nothing but voids": [write_dem(np.full((4, 4), -1.0), void=-1.0, name="void.tif")],
        "unknown vertical unit 'fathom'": [write_dem(hills, unit="fathom", name="fathom.tif")],
        "not on the lattice": [
            write_dem(hills, name="one.tif"),
            write_dem(hills, corner=(7.0, 0.0), name="askew.tif"),
        ],
        "name a raster": [text],
        "is not a file but a directory or a pipe": [pipe],
        "is nowhere on the Earth": [
            write_dem(hills, crs='LOCAL_CS["site",UNIT["metre",1]]', name="site.tif")
        ],
        "no DEM given": [],
    }
    for message, paths in cases.items():
        with pytest.raises(SimulationError, match=message) as failure:
            read_terrain(paths)
        assert "\n" not in str(failure.value)


def test_what_a_band_s_numbers_mean(write_dem: WriteDem, tmp_path: Path) -> None:
    heights = np.array([[3000.0, 4000.0], [5000.0, -9999.0]])
    path = write_dem(heights, name="scaled.tif")
    with rasterio.open(path, "r+") as dataset:
        dataset.scales = (0.1,)
    np.testing.assert_allclose(read_terrain([path]).height_m, [[300.0, 400.0], [500.0, np.nan]])
    with rasterio.open(path, "r+") as dataset:
        dataset.scales = (0.0,)
    with pytest.raises(SimulationError, match="scale 0"):
        read_terrain([path])
    decimetres = read_terrain([write_dem(heights, unit="dm", name="dm.tif")])
    np.testing.assert_allclose(decimetres.height_m, [[300.0, 400.0], [500.0, np.nan]])


def test_packed_files_are_read_and_networks_are_not(write_dem: WriteDem, tmp_path: Path) -> None:
    path = write_dem(np.arange(20.0).reshape(4, 5), name="hills.tif")
    packed = tmp_path / "hills.tif.gz"
    packed.write_bytes(gzip.compress(path.read_bytes()))
    archive = tmp_path / "hills.zip"
    with zipfile.ZipFile(archive, "w") as file:
        file.write(path, "hills.tif")
    for name in (packed, Path(f"/vsigzip/{packed}"), Path(f"/vsizip/{archive}/hills.tif")):
        assert read_terrain([name]).height_m.shape == (4, 5)
    for name in (
        "https://example.org/dem.tif",
        "/vsicurl/https://example.org/dem.tif",
        "s3://bucket/dem.tif",
    ):
        with pytest.raises(SimulationError, match="nothing is downloaded"):
            read_terrain([Path(name)])


def test_another_body_is_refused(write_dem: WriteDem) -> None:
    path = write_dem(np.arange(20.0).reshape(4, 5), name="moon.tif")
    with rasterio.open(path, "r+") as dataset:
        dataset.crs = rasterio.crs.CRS.from_string("+proj=stere +lat_0=90 +R=1737400 +units=m")
    with pytest.raises(SimulationError, match="nowhere on the Earth"):
        read_terrain([path])
