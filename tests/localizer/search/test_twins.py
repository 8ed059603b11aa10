"""Places with the same surroundings are equally probable, regardless of their position and order."""

import dataclasses
import os
from pathlib import Path

import numpy as np
import pytest
from local_map import local_dem
from seen_from import observe

from localizer.dem.horizon import Terrain, horizon, prepare_terrain
from localizer.dem.lattice import load_dem
from localizer.observation import Observation
from localizer.search.answer import Located
from localizer.search.coarse_to_fine import Cutoff, RankedCells, likeliest_cells
from localizer.search.contours import frame_contour, measured_skyline
from localizer.search.locate import locate
from localizer.search.selection import select_place
from localizer.search.stage1 import bands, heading_offsets_deg, search_stage1
from localizer.search.stage2 import ScoredCells

SANTA_CRUZ = Path(__file__).parents[3] / "sim" / "terrain" / "santa_cruz_srtm_1s.tif"
CELL_M = 30.0
SIDE = 220
ROW, COL = 300, 300
PLACE = (103.05, 138.89)
"""Row and column in the crop."""


@pytest.fixture(scope="module")
def crop_m() -> np.ndarray:
    return load_dem([SANTA_CRUZ]).z_m[ROW : ROW + SIDE, COL : COL + SIDE]


def terrain_of(height_m: np.ndarray) -> Terrain:
    """Around the origin of a map of the place, so that north is up all over it."""
    return prepare_terrain(local_dem(height_m, CELL_M))


def side_by_side(crop_m: np.ndarray, copies: int) -> Terrain:
    mirror = crop_m[:, ::-1]
    return terrain_of(np.hstack([crop_m, *[mirror, crop_m] * (copies - 1)]))


def sees_its_copy_alone(terrain: Terrain, copy: int) -> bool:
    """Whether all of the horizon of the place on one of the copies lies on that copy, away from its sides."""
    azimuth = np.arange(0.0, 360.0, 0.5)
    eye_m = float(terrain.dem.ground_m(*PLACE)) + 2.0
    _, distance_m = horizon(terrain, PLACE[0], PLACE[1] + 2 * SIDE * copy, eye_m, azimuth)
    north, east = np.cos(np.radians(azimuth)), np.sin(np.radians(azimuth))
    at = np.array(PLACE)[:, None] + distance_m[0] / CELL_M * np.array([-north, east])
    return bool(at.min() > 6.0 and at.max() < SIDE - 7.0)


def shares(located: Located, copies: int) -> list[float]:
    """Probability of the place on each copy."""
    found = [0.0] * copies
    for candidate, probability in zip(
        located.decision.candidates, located.decision.probabilities, strict=True
    ):
        for copy in range(copies):
            if np.hypot(candidate.row - PLACE[0], candidate.col - PLACE[1] - 2 * SIDE * copy) < 1.0:
                found[copy] += float(probability)
    return found


@pytest.mark.parametrize("copies", [2, pytest.param(3, marks=pytest.mark.long)])
def test_copies_of_a_place_are_equally_likely(crop_m, copies):
    terrain = side_by_side(crop_m, copies)
    assert all(sees_its_copy_alone(terrain, copy) for copy in range(copies))
    located = locate(terrain, observe(terrain, PLACE))
    assert located.decision.status == "ambiguous"
    assert located.decision.reason.code == "several_places"
    assert shares(located, copies) == pytest.approx([1.0 / copies] * copies, abs=0.05)
    assert sum(located.decision.probabilities) + located.decision.elsewhere == pytest.approx(1.0)


def stages(terrain: Terrain, observation: Observation) -> tuple[tuple, RankedCells]:
    """The contours and what stage 2 makes of the cells that stage 1 leaves."""
    contours = tuple(frame_contour(frame) for frame in observation.frames)
    skyline = measured_skyline(observation, contours)
    offsets = heading_offsets_deg(observation.azimuth_bias_sigma_deg)
    left = search_stage1(
        terrain,
        bands(skyline, offsets),
        observation.mast_height_m,
        observation.altitude_m,
        observation.altitude_sigma_m,
        terrain.nominal_error_m,
    )
    return contours, likeliest_cells(terrain, observation, skyline, left.last, offsets)


@pytest.mark.long
def test_the_order_of_the_starts_changes_nothing(crop_m):
    terrain = side_by_side(crop_m, 2)
    observation = observe(terrain, PLACE)
    contours, ranked = stages(terrain, observation)
    decision, best = select_place(terrain, observation, contours, ranked)
    for seed in range(2):
        order = np.random.default_rng(seed).permutation(len(ranked.scored.cells))
        scored = ScoredCells(
            ranked.scored.cells[order],
            ranked.scored.disparity[order],
            ranked.scored.azimuth_bias_deg[order],
        )
        repeated, place = select_place(
            terrain, observation, contours, dataclasses.replace(ranked, scored=scored)
        )
        assert (repeated.status, repeated.elsewhere) == (decision.status, decision.elsewhere)
        assert (place.row, place.col) == (best.row, best.col)
        np.testing.assert_array_equal(repeated.probabilities, decision.probabilities)


def turned(observation: Observation) -> Observation:
    """As the same rig would see it whose north is our west."""
    frames = tuple(dataclasses.replace(f, azimuth_deg=f.azimuth_deg - 90.0) for f in observation.frames)
    return dataclasses.replace(observation, frames=frames)


def mirrored(observation: Observation) -> Observation:
    """As it is seen in a mirror: east is west."""
    frames = tuple(
        dataclasses.replace(
            f,
            azimuth_deg=-f.azimuth_deg,
            roll_deg=-f.roll_deg,
            u_px=(f.camera.width_px - 1.0 - f.u_px)[::-1],
            v_px=f.v_px[::-1],
            sigma_px=f.sigma_px[::-1],
        )
        for f in observation.frames
    )
    return dataclasses.replace(observation, frames=frames)


@pytest.mark.long
@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("copies", [1, 2])
def test_where_a_place_lies_in_the_dem_changes_neither_it_nor_its_probability(crop_m, copies, seed):
    terrain = side_by_side(crop_m, copies)
    observation = observe(terrain, PLACE, seed=seed)
    located = locate(terrain, observation)
    height_m = terrain.dem.z_m
    cols = height_m.shape[1]
    shifted = np.pad(height_m, ((7, 0), (13, 0)), mode="edge")
    changes = {
        "shifted": (shifted, observation, lambda row, col: (row + 7, col + 13)),
        "turned": (np.rot90(height_m), turned(observation), lambda row, col: (cols - 1 - col, row)),
        "mirrored": (height_m[:, ::-1], mirrored(observation), lambda row, col: (row, cols - 1 - col)),
    }
    for name, (changed_m, seen, moved) in changes.items():
        repeated = locate(terrain_of(changed_m), seen)
        assert repeated.decision.status == located.decision.status, name
        first = [moved(c.row, c.col) for c in located.decision.candidates]
        for candidate, probability in zip(
            repeated.decision.candidates, repeated.decision.probabilities, strict=True
        ):
            off = [np.hypot(candidate.row - row, candidate.col - col) for row, col in first]
            assert min(off) < 0.1, name
            assert probability == pytest.approx(located.decision.probabilities[int(np.argmin(off))], abs=0.05)


def test_a_limit_close_to_the_place_found_may_have_left_another_one_out():
    cells, disparity = np.array([[10, 10], [10, 11], [50, 50]]), np.array([1.0, 1.2, 1.4])
    assert Cutoff(cells, disparity, np.inf, 0.2).miss_probability(10.0, 10.0) == 0.0
    assert Cutoff(cells, disparity, 2.0, 0.2).miss_probability(10.0, 10.0) == pytest.approx(
        2.87e-7, rel=0.01
    )  # 5 sigma
    assert Cutoff(cells, disparity, 1.4, 0.2).miss_probability(50.0, 50.0) == pytest.approx(0.5)


def test_many_cells_and_a_narrow_skyline_leave_the_true_place_among_the_best(crop_m, monkeypatch):
    monkeypatch.setattr("localizer.search.coarse_to_fine.MANY_CELLS", 500)
    terrain = side_by_side(crop_m, 1)
    whole = observe(terrain, PLACE, azimuths=(17.0,))
    frame = whole.frames[0]
    narrow = slice(300, 420)  # 14 deg
    observation = dataclasses.replace(
        whole,
        frames=(
            dataclasses.replace(
                frame, u_px=frame.u_px[narrow], v_px=frame.v_px[narrow], sigma_px=frame.sigma_px[narrow]
            ),
        ),
    )
    _, ranked = stages(terrain, observation)
    assert len(ranked.cutoffs) == 3
    assert np.isfinite(ranked.scored.disparity).all()
    off = np.hypot(*(ranked.scored.cells - np.array(PLACE)).T)
    assert off.min() < 1.0


@pytest.mark.long
@pytest.mark.timeout(900)
def test_a_mosaic_of_a_hundred_million_cells_shows_all_four_copies_of_a_place():
    folder = os.environ.get("SKYFIX_DATA")
    if folder is None:
        pytest.skip("SKYFIX_DATA is not set: it names the folder with the terrain that does not ship")
    tile_m = load_dem([Path(folder) / "terrain" / "sanfrancisco_srtm_1s.tif"]).z_m
    column_m = np.vstack([tile_m, tile_m[::-1], tile_m])
    terrain = terrain_of(np.hstack([column_m, column_m[:, ::-1], column_m]))
    assert terrain.dem.rows * terrain.dem.cols > 100e6
    located = locate(terrain, observe(terrain, (2353.93, 2398.38)))
    assert located.decision.status == "ambiguous"
    assert list(located.decision.probabilities) == pytest.approx([0.25] * 4, abs=0.05)
