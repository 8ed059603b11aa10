"""Stage 1 on a plain with one wall, where all heights, distances and the curvature are numbers that can be written down."""

import dataclasses

import numpy as np
import pytest
from local_map import local_dem

from localizer.dem.horizon import Terrain, prepare_terrain
from localizer.search.contours import BINS, STEP_DEG, MeasuredSkyline
from localizer.search.stage1 import Band, Stage1, bands, heading_offsets_deg, search_stage1

CELL_M = 500.0
ROWS, COLS = 9, 81
CAMERA = (4, 10)
WALL_COL = 70
WALL_M = 600.0
MAST_M = 2.0
DISTANCE_M = (WALL_COL - CAMERA[1]) * CELL_M  # 30 km
DROP_PER_M2 = (1.0 - 0.13) / (2.0 * 6_371_008.8)
TANGENT = (WALL_M - MAST_M) / DISTANCE_M - DROP_PER_M2 * DISTANCE_M
"""Of the wall's top, seen from the camera: (600 - 2) / 30000 - 0.002048 = 0.017885."""


def terrain_of(height_m: np.ndarray, relief_m: float = 0.0) -> Terrain:
    """Heights around the map's origin; the height differences over half a cell are the same everywhere."""
    terrain = prepare_terrain(local_dem(height_m, CELL_M))
    return dataclasses.replace(terrain, half_cell_relief_m=np.full(height_m.shape, relief_m, np.float32))


def plain(relief_m: float = 0.0) -> Terrain:
    """Flat, with a wall across its eastern part."""
    height_m = np.zeros((ROWS, COLS))
    height_m[:, WALL_COL] = WALL_M
    return terrain_of(height_m, relief_m)


def only_camera() -> np.ndarray:
    allowed = np.zeros((ROWS, COLS), bool)
    allowed[CAMERA] = True
    return allowed


def search(terrain: Terrain, *directions: Band, dem_error_m: float = 0.0, **changes) -> Stage1:
    readings = {"altitude_m": None, "altitude_sigma_m": np.inf, "allowed": only_camera(), **changes}
    return search_stage1(terrain, list(directions), MAST_M, dem_error_m=dem_error_m, **readings)


def stays(terrain: Terrain, *directions: Band, **changes) -> bool:
    return len(search(terrain, *directions, **changes).last) == 1


def east(low: float | list[float], high: float | list[float], label: str = "E") -> Band:
    return Band(label, 90.0, np.atleast_1d(np.array(low, float)), np.atleast_1d(np.array(high, float)))


def test_the_curvature_of_the_earth_lowers_a_wall_30_km_away_by_61_m():
    narrow = 1e-5  # 0.3 m at the wall
    assert pytest.approx(0.017885, abs=1e-6) == TANGENT
    assert stays(plain(), east(TANGENT - narrow, TANGENT + narrow))
    straight = (WALL_M - MAST_M) / DISTANCE_M
    assert pytest.approx(61.45, abs=0.01) == (straight - TANGENT) * DISTANCE_M
    assert not stays(plain(), east(straight - narrow, straight + narrow))


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_the_band_is_wider_by_the_relief_at_the_wall_and_the_camera(side):
    """10 m over half a cell at either end: 14.14 m at 30 km."""
    terrain = plain(relief_m=10.0)
    for off_m, inside in ((14.0, True), (14.3, False)):
        tangent = TANGENT + side * off_m / DISTANCE_M
        assert stays(terrain, east(tangent, tangent)) == inside, off_m


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_the_band_is_wider_by_three_sigma_of_the_dem(side):
    for off_m, inside in ((11.9, True), (12.1, False)):
        tangent = TANGENT + side * off_m / DISTANCE_M
        assert stays(plain(), east(tangent, tangent), dem_error_m=4.0) == inside, off_m


def test_a_known_altitude_replaces_the_relief_under_the_camera():
    """The camera stands at 8 m, on ground of 0 to 10 m: the wall is 8 m less above it, give or take 3 sigma of 1 m."""
    terrain = plain(relief_m=10.0)
    eye_m = 8.0
    tangent = (WALL_M - eye_m) / DISTANCE_M - DROP_PER_M2 * DISTANCE_M
    reach_m = np.hypot(10.0, 3.0)
    known = {"altitude_m": eye_m, "altitude_sigma_m": 1.0}
    for side in (-1.0, 1.0):
        for off_m, inside in ((reach_m - 0.1, True), (reach_m + 0.1, False)):
            at = tangent + side * off_m / DISTANCE_M
            assert stays(terrain, east(at, at), **known) == inside, (side, off_m)


@pytest.mark.parametrize(
    ("altitude_m", "sigma_m", "dem_error_m", "relief_m", "inside"),
    [
        (2.0 + 14.9, 5.0, 0.0, 0.0, True),  # three sigma
        (2.0 + 15.1, 5.0, 0.0, 0.0, False),
        (2.0 - 14.9, 5.0, 0.0, 0.0, True),
        (2.0 - 15.1, 5.0, 0.0, 0.0, False),
        (2.0 + 14.9, 3.0, 4.0, 0.0, True),  # of altimeter and DEM together
        (2.0 + 15.1, 3.0, 4.0, 0.0, False),
        (2.0 + 24.9, 5.0, 0.0, 10.0, True),  # and the relief
        (2.0 + 25.1, 5.0, 0.0, 10.0, False),
    ],
)
def test_the_altitude_leaves_the_cells_within_three_sigma(altitude_m, sigma_m, dem_error_m, relief_m, inside):
    found = search(plain(relief_m), altitude_m=altitude_m, altitude_sigma_m=sigma_m, dem_error_m=dem_error_m)
    assert [tuple(cell) for cell in found.survivors["altitude"]] == ([CAMERA] if inside else [])


def test_voids_are_no_cells():
    height_m = np.zeros((ROWS, COLS))
    height_m[0, :5] = np.nan
    found = search(terrain_of(height_m), allowed=None)
    assert found.cells == ROWS * COLS - 5
    assert len(found.last) == ROWS * COLS - 5


# ---- headings


def test_all_directions_must_agree_under_the_same_heading():
    """Under the first hypothesis only the one direction fits, under the second only the other."""
    fits, misses = (TANGENT - 1e-4, TANGENT + 1e-4), (TANGENT + 0.01, TANGENT + 0.02)
    one = east([fits[0], misses[0]], [fits[1], misses[1]], "one")
    other = east([misses[0], fits[0]], [misses[1], fits[1]], "other")
    assert stays(plain(), one)
    assert stays(plain(), other)
    assert stays(plain(), one, dataclasses.replace(one, label="again"))
    found = search(plain(), one, other)
    assert [len(cells) for cells in found.survivors.values()] == [1, 1, 0]


def test_a_heading_counts_although_another_one_excludes_the_cell():
    low = [TANGENT + 0.01] * 63 + [TANGENT - 1e-4]
    high = [TANGENT + 0.02] * 63 + [TANGENT + 1e-4]
    assert stays(plain(), east(low, high, "one"), east(low, high, "two"))


def test_a_point_above_the_band_of_every_heading_excludes_the_camera():
    assert not stays(plain(), east([0.0, 0.001], [0.002, 0.003]))
    assert stays(plain(), east([0.0, 0.001], [0.002, TANGENT + 1e-4]))


@pytest.mark.parametrize("azimuth_deg", [0.0, 90.0, 180.0, 270.0])
def test_a_direction_is_clockwise_from_north(azimuth_deg):
    """Four walls of different heights, 3 cells away."""
    height_m = np.zeros((11, 11))
    walls_m = {0.0: 100.0, 90.0: 200.0, 180.0: 300.0, 270.0: 400.0}
    height_m[2, 4:7], height_m[4:7, 8], height_m[8, 4:7], height_m[4:7, 2] = walls_m.values()
    allowed = np.zeros((11, 11), bool)
    allowed[5, 5] = True
    for wall_of, wall_m in walls_m.items():
        tangent = (wall_m - MAST_M) / (3 * CELL_M) - DROP_PER_M2 * 3 * CELL_M
        band = Band("", azimuth_deg, np.array([tangent - 1e-4]), np.array([tangent + 1e-4]))
        assert stays(terrain_of(height_m), band, allowed=allowed) == (wall_of == azimuth_deg)


def test_an_oblique_line_of_sight_meets_the_wall_farther_off():
    """At 60 deg, towards the east, the wall 4 cells east is 4 / sin 60 cells away."""
    height_m = np.zeros((41, 41))
    height_m[:, 24] = 300.0
    allowed = np.zeros((41, 41), bool)
    allowed[20, 20] = True
    away_m = 4 * CELL_M / np.sin(np.radians(60.0))
    tangent = (300.0 - MAST_M) / away_m - DROP_PER_M2 * away_m
    for off, inside in ((0.0, True), (2e-3, False), (-2e-3, False)):
        band = Band("", 60.0, np.array([tangent + off - 1e-3]), np.array([tangent + off + 1e-3]))
        assert stays(terrain_of(height_m), band, allowed=allowed) == inside


def test_between_two_cells_the_ground_is_interpolated():
    """At atan(1/2) east of north the line of sight passes midway between two cells of 100 m and 300 m."""
    height_m = np.zeros((41, 41))
    height_m[19, 20], height_m[19, 21] = 100.0, 300.0
    allowed = np.zeros((41, 41), bool)
    allowed[20, 20] = True
    away_m = CELL_M * np.hypot(1.0, 0.5)
    tangent = (200.0 - MAST_M) / away_m - DROP_PER_M2 * away_m
    azimuth_deg = np.degrees(np.arctan(0.5))
    for off, inside in ((0.0, True), (2e-3, False), (-2e-3, False)):
        band = Band("", azimuth_deg, np.array([tangent + off - 1e-3]), np.array([tangent + off + 1e-3]))
        assert stays(terrain_of(height_m), band, allowed=allowed) == inside


def test_the_points_on_the_way_to_the_horizon_are_counted():
    """From column 10 to 70: 60 points; behind the wall nothing can be higher, so that the search ends there."""
    assert search(plain(), east(0.0, 1.0)).points_explored == WALL_COL - CAMERA[1]


# ---- heading hypotheses and bands


@pytest.mark.parametrize(
    ("sigma_deg", "step_deg", "last_deg", "count"),
    [
        (0.0, None, 0.0, 1),
        (0.5, 0.25, 1.5, 13),  # three sigma
        (1.0, 0.25, 3.0, 25),
        (3.0, 0.5, 9.0, 37),  # 18 deg in 63 steps of a whole multiple of 0.25
        (10.0, 1.0, 30.0, 61),
        (180.0, 5.75, 178.25, 63),  # all round
    ],
)
def test_hypotheses_reach_three_sigma_in_whole_steps(sigma_deg, step_deg, last_deg, count):
    offsets = heading_offsets_deg(sigma_deg)
    assert len(offsets) == count
    assert (offsets[0], offsets[-1]) == (-last_deg, last_deg)
    if step_deg:
        assert np.diff(offsets) == pytest.approx(step_deg)


def skyline_of(elevation_deg: np.ndarray, sigma_deg: float = 0.1, **centres_deg: float) -> MeasuredSkyline:
    return MeasuredSkyline(elevation_deg, np.full(BINS, sigma_deg), np.zeros(BINS), centres_deg)


def degrees(tangents: np.ndarray) -> np.ndarray:
    return np.degrees(np.arctan(tangents))


def test_a_band_is_three_sigma_around_the_bins_that_a_hypothesis_covers():
    elevation_deg = np.arange(BINS) * STEP_DEG / 10.0  # rises by 0.1 deg in each degree of azimuth
    (band,) = bands(skyline_of(elevation_deg, E=90.1), np.array([-1.0, 0.0, 1.0]))
    assert (band.label, band.azimuth_deg) == ("E", 90.0)
    # half a step of the hypotheses to each side: 0.5 deg, two bins
    assert degrees(band.low) == pytest.approx([8.9 - 0.05 - 0.3, 9.0 - 0.05 - 0.3, 9.1 - 0.05 - 0.3])
    assert degrees(band.high) == pytest.approx([8.9 + 0.05 + 0.3, 9.0 + 0.05 + 0.3, 9.1 + 0.05 + 0.3])


def test_one_hypothesis_covers_a_bin_to_each_side_and_bins_go_round():
    elevation_deg = np.zeros(BINS)
    elevation_deg[-1], elevation_deg[1], elevation_deg[2] = 3.0, 5.0, 40.0
    (band,) = bands(skyline_of(elevation_deg, N=359.95), np.array([0.0]))
    assert degrees(band.high) == pytest.approx([5.3])
    assert degrees(band.low) == pytest.approx([-0.3])


def test_where_no_skyline_was_seen_a_hypothesis_is_not_tested():
    elevation_deg = np.full(BINS, np.nan)
    elevation_deg[360:] = 2.0  # from 90 deg on
    skyline = skyline_of(elevation_deg, E=90.0, W=45.0)
    (band,) = bands(skyline, np.array([-5.0, 0.0, 5.0]))
    assert band.label == "E"
    assert (band.low[0], band.high[0]) == (-np.inf, np.inf)
    assert degrees(band.high[1:]) == pytest.approx([2.3, 2.3])


def test_the_direction_of_the_lowest_skyline_comes_first():
    elevation_deg = np.full(BINS, 4.0)
    elevation_deg[700:900], elevation_deg[300:400] = 1.0, 2.0
    skyline = skyline_of(elevation_deg, N=0.0, E=90.0, S=200.0)
    assert [band.label for band in bands(skyline, np.array([0.0]))] == ["S", "E", "N"]
