"""The horizon of a DEM: closed forms, a brute-force reference, and rays that start or end in odd places.

Expected angles come from the drop over a curved Earth written out here, (1 - 0.13) x^2 / (2 R), geodesics from pyproj, and
surfaces from scipy.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from pyproj import CRS, Geod
from scipy.interpolate import RegularGridInterpolator

from localizer.dem.horizon import (
    DEM_EDGE_CELLS,
    Terrain,
    horizon,
    horizon_around,
    prepare_terrain,
)
from localizer.dem.lattice import Dem, dem_from_array, load_dem

SANTA_CRUZ = Path(__file__).parents[3] / "sim" / "terrain" / "santa_cruz_srtm_1s.tif"
LOCAL = CRS.from_proj4("+proj=tmerc +lat_0=46 +lon_0=8 +k=1 +x_0=0 +y_0=0 +ellps=WGS84")
SIDE = 201
MIDDLE = (SIDE - 1) // 2
CELL_M = 20.0
DROP_PER_M2 = (1.0 - 0.13) / (2.0 * 6371008.8)
"""The IUGG's mean radius of the Earth and the usual coefficient of refraction: 61.45 m at 30 km."""


def dem_of(height_m: np.ndarray) -> Dem:
    half = SIDE * CELL_M / 2.0
    return dem_from_array(height_m.astype(np.float32), Affine(CELL_M, 0.0, -half, 0.0, -CELL_M, half), LOCAL)


def east_north() -> tuple[np.ndarray, np.ndarray]:
    steps = (np.arange(SIDE) - MIDDLE) * CELL_M
    return np.meshgrid(steps, -steps)


@pytest.fixture(scope="module")
def santa_cruz() -> Terrain:
    return prepare_terrain(load_dem([SANTA_CRUZ]))


def test_from_within_a_cone_shaped_bowl_every_horizon_is_the_rim():
    east, north = east_north()
    radius = np.hypot(east, north)
    terrain = prepare_terrain(
        dem_of(np.where(radius < 1500.0, 0.0, np.minimum(radius - 1500.0, 300.0) * 0.5))
    )
    azimuth = np.arange(0.0, 360.0, 7.5)
    elevation, distance = horizon(terrain, MIDDLE, MIDDLE, 2.0, azimuth)
    closed = np.degrees(np.arctan((150.0 - 2.0) / 1800.0 - DROP_PER_M2 * 1800.0))
    assert elevation[0] == pytest.approx(
        np.full(len(azimuth), closed), abs=0.06
    )  # a crest rounded by half a cell
    assert distance[0] == pytest.approx(np.full(len(azimuth), 1800.0), abs=CELL_M * 1.5)


def test_a_wall_stands_at_the_angle_of_its_crest_whatever_the_azimuth():
    _, north = east_north()
    crest = 600.0
    terrain = prepare_terrain(dem_of(np.where(np.isclose(north, crest), 100.0, 0.0)))
    azimuth = np.array([0.0, 20.0, -40.0])
    elevation, distance = horizon(terrain, MIDDLE, MIDDLE, 10.0, azimuth)
    along = crest / np.cos(np.radians(azimuth))
    closed = np.degrees(np.arctan(90.0 / along - DROP_PER_M2 * along))
    assert elevation[0] == pytest.approx(closed, abs=1e-4)
    assert distance[0] == pytest.approx(along, abs=0.1)


def test_over_a_level_sea_the_horizon_dips_by_the_square_root_of_the_height():
    flat = np.zeros((SIDE, SIDE), np.float32)
    wide = Affine(200.0, 0.0, -SIDE * 100.0, 0.0, -200.0, SIDE * 100.0)
    terrain = prepare_terrain(dem_from_array(flat, wide, LOCAL))
    elevation, distance = horizon(terrain, MIDDLE, MIDDLE, 10.0, np.array([0.0, 33.0, 90.0, 210.0]))
    # A line of sight touches the sea at x = sqrt(h / DROP_PER_M2) and dips by 2 sqrt(h DROP_PER_M2): 12102 m, 0.0947 deg.
    assert elevation[0] == pytest.approx(np.full(4, -0.0947), abs=1e-4)
    assert distance[0] == pytest.approx(np.full(4, 12102.0), rel=0.05)


def test_a_wall_30_km_away_is_61_metres_lower_than_on_a_flat_earth():
    wide = Affine(200.0, 0.0, -SIDE * 100.0, 0.0, -200.0, SIDE * 100.0)
    height = np.zeros((SIDE, SIDE), np.float32)
    height[25] = 600.0
    dem = dem_from_array(height, wide, LOCAL)
    bent, straight = (
        horizon(prepare_terrain(dem, refraction), 175.0, MIDDLE, 100.0, 0.0) for refraction in (0.13, 0.0)
    )
    assert bent[1][0, 0] == pytest.approx(30_000.0, abs=0.5)
    # 30000^2 / (2 x 6371008.8) = 70.633 m, of which refraction takes back 13 %: 61.450 m.
    assert 30_000.0 * np.tan(np.radians(bent[0][0, 0])) == pytest.approx(500.0 - 61.450, abs=0.02)
    assert 30_000.0 * np.tan(np.radians(straight[0][0, 0])) == pytest.approx(500.0 - 70.633, abs=0.02)


def test_the_horizon_of_real_terrain_is_that_of_a_brute_force_march(santa_cruz: Terrain):
    """Steps along pyproj's geodesic over scipy's bilinear surface of the file, as rasterio reads it."""
    with rasterio.open(SANTA_CRUZ) as file:
        z_m, to_lonlat = file.read(1).astype(float), file.transform
    surface = RegularGridInterpolator((np.arange(800.0), np.arange(800.0)), z_m, bounds_error=False)
    geod, rng = Geod(ellps="WGS84"), np.random.default_rng(4)
    coarse_m = np.concatenate([np.arange(0.1, 400.0, 0.1), np.arange(400.0, 30_000.0, 1.0)])
    knots_m = np.arange(0.0, 30_100.0, 100.0)
    for _ in range(25):
        row, col = rng.uniform(100.0, 700.0, 2)
        azimuth = rng.uniform(0.0, 360.0)
        lon_deg, lat_deg = to_lonlat @ (col + 0.5, row + 0.5)
        start = [np.full(len(knots_m), value) for value in (lon_deg, lat_deg, azimuth)]
        ends = geod.fwd(*start, knots_m)
        cols, rows = ~to_lonlat @ np.array(ends[:2])
        eye = float(surface((row, col))) + 2.0

        def tangents(s, rows=rows, cols=cols, eye=eye):
            at = np.column_stack([np.interp(s, knots_m, rows - 0.5), np.interp(s, knots_m, cols - 0.5)])
            return (surface(at) - eye) / s - DROP_PER_M2 * s

        best_m = coarse_m[np.nanargmax(tangents(coarse_m))]
        fine_m = best_m + np.linspace(-1.0, 1.0, 401) * min(1.0, 0.5 * best_m)
        expected = np.degrees(np.arctan(np.nanmax(tangents(fine_m))))
        elevation, _ = horizon(santa_cruz, row, col, eye, azimuth)
        assert elevation[0, 0] == pytest.approx(expected, abs=0.001 + 0.02 / best_m)


def test_100_000_rays_are_the_same_whether_blocks_are_skipped_or_not(santa_cruz: Terrain):
    one_by_one = replace(
        santa_cruz,
        row_blocks=np.full_like(santa_cruz.row_blocks, np.inf),
        col_blocks=np.full_like(santa_cruz.col_blocks, np.inf),
    )  # no line of sight is above a block of infinite height
    rng = np.random.default_rng(5)
    row, col = rng.uniform(0.0, 799.0, (2, 1000))
    eye_m = santa_cruz.dem.ground_m(row, col) + rng.choice([2.0, 30.0], 1000)
    azimuth_deg = rng.uniform(0.0, 360.0, (1000, 100))
    angle, distance = horizon(santa_cruz, row, col, eye_m, azimuth_deg)
    every_angle, every_distance = horizon(one_by_one, row, col, eye_m, azimuth_deg)
    np.testing.assert_array_equal(angle, every_angle)
    np.testing.assert_array_equal(distance, every_distance)
    assert np.isfinite(distance).mean() > 0.99


def test_turning_the_grid_does_not_turn_the_horizon(santa_cruz: Terrain):
    """The same place on a grid with its rows and columns exchanged and mirrored sees the same mirrored horizon."""
    east, north = east_north()
    height = 80.0 * np.sin(east / 310.0) * np.cos(north / 230.0) + 0.03 * east
    straight, turned = prepare_terrain(dem_of(height)), prepare_terrain(dem_of(height.T[::-1, ::-1]))
    azimuth = np.arange(0.0, 360.0, 11.0)
    first, _ = horizon(straight, 80.3, 120.6, 150.0, azimuth)
    # (row, col) -> (last - col, last - row) mirrors east and north into north and east.
    second, _ = horizon(turned, SIDE - 1 - 120.6, SIDE - 1 - 80.3, 150.0, 90.0 - azimuth)
    assert first[0] == pytest.approx(second[0], abs=5e-3)


def test_a_void_neither_occludes_nor_forms_a_horizon():
    _, north = east_north()
    height = np.where(np.isclose(north, 600.0), 100.0, 0.0)
    height[np.isclose(north, 600.0)] = np.nan
    terrain = prepare_terrain(dem_of(height))
    elevation, _ = horizon(terrain, MIDDLE, MIDDLE, 10.0, 0.0)
    assert elevation[0, 0] < 0.0


def test_there_is_no_surface_between_cells_of_which_one_is_void():
    """A wall one cell thick, voids on both sides: its cells have elevations, the surface beside them is unknown."""
    _, north = east_north()
    height = np.where(np.isclose(north, 600.0), 100.0, 0.0)
    height[np.isclose(np.abs(north - 600.0), CELL_M)] = np.nan
    terrain = prepare_terrain(dem_of(height))
    elevation, _ = horizon(terrain, MIDDLE, MIDDLE, 10.0, np.array([0.0, 14.0, 30.0]))
    assert (elevation[0] < 0.0).all()


def test_an_observer_outside_the_grid_looks_in_and_sees_nothing_the_other_way():
    _, north = east_north()
    terrain = prepare_terrain(dem_of(np.where(np.isclose(north, 600.0), 100.0, 0.0)))
    elevation, distance = horizon(terrain, SIDE + 20.0, MIDDLE, 10.0, np.array([0.0, 180.0, 90.0]))
    south_of_crest = (SIDE + 20.0 - MIDDLE) * CELL_M + 600.0
    assert distance[0, 0] == pytest.approx(south_of_crest, abs=0.5)
    assert elevation[0, 1:] == pytest.approx([-90.0, -90.0])
    assert np.isnan(distance[0, 1:]).all()


def test_a_higher_eye_sees_a_lower_horizon(santa_cruz: Terrain):
    ground = float(santa_cruz.dem.ground_m(400.0, 400.0))
    azimuth = np.arange(0.0, 360.0, 5.0)
    low, _ = horizon(santa_cruz, 400.0, 400.0, ground + 2.0, azimuth)
    high, _ = horizon(santa_cruz, 400.0, 400.0, ground + 50.0, azimuth)
    assert (high <= low + 1e-9).all()


def test_the_rim_is_what_lies_close_to_where_the_dem_ends_or_to_a_void():
    height = np.zeros((SIDE, SIDE))
    height[60, 80] = np.nan
    terrain = prepare_terrain(dem_of(height))
    index = np.arange(SIDE)
    outer = (index < DEM_EDGE_CELLS) | (index >= SIDE - DEM_EDGE_CELLS)
    by_void = (np.abs(index - 60) <= DEM_EDGE_CELLS)[:, None] & (np.abs(index - 80) <= DEM_EDGE_CELLS)[
        None, :
    ]
    assert np.array_equal(terrain.dem_edge, outer[:, None] | outer[None, :] | by_void)
    lies_there = terrain.is_dem_edge(np.array([-5.0, 60.4, MIDDLE]), np.array([70.0, 77.0, MIDDLE]))
    assert lies_there.tolist() == [True, True, False]


@pytest.fixture(scope="module")
def with_voids(santa_cruz: Terrain) -> Terrain:
    rng = np.random.default_rng(3)
    z_m = santa_cruz.dem.z_m.copy()
    for _ in range(60):
        row, col = rng.integers(0, 790, 2)
        z_m[row : row + rng.integers(1, 12), col : col + rng.integers(1, 12)] = np.nan
    return prepare_terrain(replace(santa_cruz.dem, z_m=z_m))


@pytest.mark.parametrize("beyond_m", [0.0, 60.0])
@pytest.mark.parametrize("where", ["inside", "north", "south", "west", "east"])
def test_a_guess_changes_no_ray_wherever_it_points(with_voids: Terrain, where: str, beyond_m: float):
    rng = np.random.default_rng(7)
    rows, cols = with_voids.height_m.shape
    azimuth = np.radians(np.arange(0.0, 360.0, 0.25))
    for _ in range(8):
        row, col = rng.uniform(0.0, rows - 1.0), rng.uniform(0.0, cols - 1.0)
        beside = rng.uniform(-3.0, 8.0)  # of the DEM's end, or outside of it
        row = {"north": beside, "south": rows - 1.0 - beside}.get(where, row)
        col = {"west": beside, "east": cols - 1.0 - beside}.get(where, col)
        at = np.clip(row, 0, rows - 1), np.clip(col, 0, cols - 1)
        eye_m = 2.0 + float(np.nan_to_num(with_voids.dem.ground_m(*at), nan=300.0))
        tangent, distance_m = horizon_around(with_voids, row, col, eye_m, azimuth, None, beyond_m)
        for guess_m in (
            distance_m,
            np.roll(distance_m, 1),
            np.full(len(azimuth), 40.0),
            rng.uniform(0.0, 15e3, len(azimuth)),
        ):
            guessed = horizon_around(with_voids, row, col, eye_m, azimuth, guess_m, beyond_m)
            np.testing.assert_array_equal(guessed[0], tangent)
            np.testing.assert_array_equal(guessed[1], distance_m)


def test_a_ray_sees_the_part_of_a_cell_in_which_it_leaves_the_dem():
    _, north = east_north()
    terrain = prepare_terrain(dem_of(np.where(north > MIDDLE * CELL_M - 1.0, 400.0, 0.0)))  # the last row
    # Along the diagonal of the last cell the ray leaves by the eastern side; only that row rises.
    row, col = 3.0, SIDE - 1.25
    azimuth = np.degrees(np.arctan2(0.25, 2.5))
    elevation, distance = horizon(terrain, row, col, 2.0, azimuth)
    way_m = np.hypot(0.25, 2.5) * CELL_M
    closed = np.degrees(np.arctan((0.5 * 400.0 - 2.0) / way_m - DROP_PER_M2 * way_m))
    assert distance[0, 0] == pytest.approx(way_m, abs=0.3)
    assert elevation[0, 0] == pytest.approx(closed, abs=0.4)
