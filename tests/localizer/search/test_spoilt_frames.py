"""Contours that are wrong in part, or a whole frame that contradicts the others, do not mislead the search."""

import dataclasses
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from seen_from import PLACE, observe

from localizer.dem.horizon import Terrain, prepare_terrain
from localizer.dem.lattice import load_dem
from localizer.observation import Observation
from localizer.search.leave_one_out import CheckedAnswer, frame_agreement
from localizer.search.locate import check_located, locate
from localizer.track.document import step_text, track_line
from localizer.track.tracker import Tracker, follow

SANTA_CRUZ = Path(__file__).parents[3] / "sim" / "terrain" / "santa_cruz_srtm_1s.tif"


@pytest.fixture(scope="module")
def terrain() -> Terrain:
    return prepare_terrain(load_dem([SANTA_CRUZ]))


def error_cells(located, place=PLACE) -> float:
    return float(np.hypot(located.best.row - place[0], located.best.col - place[1]))


def test_a_stretch_of_wrong_contour_does_not_outweigh_the_rest(terrain):
    observation = observe(terrain)
    frame = observation.frames[1]
    wrong = frame.v_px.copy()
    wrong[100:260] -= 40.0
    spoilt = dataclasses.replace(
        observation,
        frames=(observation.frames[0], dataclasses.replace(frame, v_px=wrong), *observation.frames[2:]),
    )
    located = locate(terrain, spoilt)
    assert located.decision.status == "fix"
    assert error_cells(located) < 0.3


def test_an_occluded_central_column_does_not_lose_the_place(terrain):
    observation = observe(terrain)
    frame = observation.frames[2]
    wrong = frame.v_px.copy()
    wrong[250:390] = 30.0
    spoilt = dataclasses.replace(
        observation,
        frames=(*observation.frames[:2], dataclasses.replace(frame, v_px=wrong), observation.frames[3]),
    )
    located = locate(terrain, spoilt)
    assert located.decision.status == "fix"
    assert error_cells(located) < 0.3


def checked_answer(terrain: Terrain, observation: Observation) -> CheckedAnswer:
    return check_located(terrain, observation, locate(terrain, observation))


def with_tilt_misread(terrain: Terrain) -> Observation:
    observation = observe(terrain)
    first, wrong, *others = observation.frames
    return dataclasses.replace(
        observation, frames=(first, dataclasses.replace(wrong, tilt_deg=wrong.tilt_deg + 2.0), *others)
    )


def with_a_view_of_elsewhere(terrain: Terrain) -> Observation:
    observation, elsewhere = observe(terrain), observe(terrain, (200.0, 600.0))
    points = {name: getattr(elsewhere.frames[2], name)[:600] for name in ("u_px", "v_px", "sigma_px")}
    other = dataclasses.replace(observation.frames[1], **points)
    return dataclasses.replace(observation, frames=(observation.frames[0], other, *observation.frames[2:]))


@pytest.mark.parametrize(
    "spoil", [with_tilt_misread, pytest.param(with_a_view_of_elsewhere, marks=pytest.mark.long)]
)
def test_a_frame_that_contradicts_the_others_is_left_out_and_named(terrain, spoil):
    answer = checked_answer(terrain, spoil(terrain))
    assert answer.left_out == "frame 1"
    assert answer.agreement["frame 1"] < 0.4
    assert min(answer.agreement[f"frame {number}"] for number in (0, 2, 3)) > 0.8
    assert answer.located.decision.status == "fix"
    assert error_cells(answer.located) < 0.1


@pytest.mark.long
def test_a_track_does_without_that_frame_too(terrain):
    step = follow(Tracker(), None, terrain, with_tilt_misread(terrain), "a bundle")
    assert step.left_out == track_line(step, terrain.dem).left_out == "frame 1"
    assert step.fix.status == "fix"
    assert "without frame frame 1" in step_text(step)


@pytest.mark.long
def test_leaving_out_a_frame_makes_no_fix_of_a_place_outside_the_dem(terrain):
    dem = terrain.dem
    elsewhere = dataclasses.replace(
        dem, z_m=np.where(np.arange(dem.cols)[None, :] < 300, dem.z_m, np.float32(np.nan)).astype(np.float32)
    )
    answer = checked_answer(prepare_terrain(elsewhere), observe(terrain, (250.0, 500.0)))
    assert answer.left_out is None
    assert answer.located.decision.status == "none"


def test_a_frame_whose_horizon_lies_where_the_dem_ends_neither_agrees_nor_contradicts(terrain):
    row, col = PLACE
    seen = observe(terrain, azimuth_bias_deg=0.0).frames[2]
    eye_m = float(terrain.dem.ground_m(*PLACE)) + 2.0
    found = SimpleNamespace(
        row=row, col=col, altitude_m=eye_m, azimuth_bias_deg=0.0, tilt_bias_deg=0.0, dem_error_m=1.0
    )
    raised = dataclasses.replace(seen, v_px=seen.v_px - 30.0)
    all_edge = dataclasses.replace(terrain, dem_edge=np.ones_like(terrain.dem_edge))
    assert frame_agreement(terrain, seen, found) > 0.9
    assert frame_agreement(terrain, raised, found) < 0.1
    assert frame_agreement(all_edge, raised, found) is None
