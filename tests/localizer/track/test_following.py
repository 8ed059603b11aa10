"""A track settles on one place where a single look cannot, and never hands out an old place as a new one.

The looks at the western and the eastern spot of crater 0 each leave two craters.
"""

import dataclasses

import numpy as np
import pytest
from craters import EAST_SPOT, WEST_SPOT, blinded, driven, track

from localizer.track import Tracker, follow
from localizer.track.tracker import TrackerError

pytestmark = pytest.mark.usefixtures("searched_once")


@pytest.fixture(scope="module")
def first_step(scene, searched_once):
    """Of a track that begins at the western spot of crater 0."""
    return track(scene, (None, scene.look(0, WEST_SPOT)))[0]


def test_a_program_steps_a_tracker(scene, first_step):
    movement = driven(30.0)
    blind = blinded(scene.look(0, WEST_SPOT))
    step = first_step.tracker.step(blind, scene.terrain.dem, movement=movement, name="in fog")
    expected = follow(first_step.tracker, movement, scene.terrain, blind, "in fog")
    assert step.fix.status == "none"
    assert step.tracker == expected.tracker
    assert len(step.hypotheses) == len(expected.posteriors) > 1
    assert not any(hypothesis.seen for hypothesis in step.hypotheses)
    assert step.elsewhere == expected.elsewhere


def test_a_known_drive_of_200_m_resolves_what_neither_bundle_alone_can(
    scene, first_step, west_alone, searched_once
):
    east = scene.look(0, EAST_SPOT)
    assert west_alone.decision.status == "ambiguous"
    assert searched_once(scene.terrain, east).decision.status == "ambiguous"
    (second,) = track(scene, (driven(200.0), east), tracker=first_step.tracker)
    assert first_step.fix.status == "ambiguous"
    assert second.fix.status == "fix"
    assert scene.error_cells(second.fix, 0, EAST_SPOT) < 0.2
    assert second.fix.probability >= 0.99
    assert second.fix.candidates[0].probability == second.fix.probability


@pytest.mark.long
def test_an_unknown_drive_resolves_nothing(scene):
    steps = track(scene, (None, scene.look(0, WEST_SPOT)), (None, scene.look(0, EAST_SPOT)))
    assert [step.fix.status for step in steps] == ["ambiguous", "ambiguous"]
    assert [step.mode for step in steps] == ["whole DEM", "whole DEM"]


@pytest.mark.long
def test_odometry_that_fits_no_pair_of_places_resolves_nothing(scene):
    legs = driven(0.0, 200.0), scene.look(0, EAST_SPOT)
    *_, last = track(scene, (None, scene.look(0, WEST_SPOT)), legs)
    assert last.fix.status == "ambiguous"
    assert len(last.fix.candidates) == 2


def test_a_second_bundle_from_the_same_spot_resolves_nothing(scene, west_alone, monkeypatch):
    # whatever speaks for the one crater, an error of the DEM perhaps, speaks for it each time
    leaning = dataclasses.replace(
        west_alone, decision=dataclasses.replace(west_alone.decision, probabilities=np.array([0.8, 0.2]))
    )
    monkeypatch.setattr("localizer.track.tracker.locate", lambda terrain, observation, **_: leaning)
    looks = [(driven(0.0, sigma_m=0.1), scene.look(0, WEST_SPOT))] * 8
    for step in track(scene, *looks):
        assert step.fix.status == "ambiguous"
        assert step.fix.probability == pytest.approx(0.8, abs=0.01)


def test_the_first_bundle_gives_the_result_of_the_search_alone(first_step, west_alone):
    step, best = first_step, west_alone.best
    assert (step.fix.position.row, step.fix.position.col) == (best.row, best.col)
    assert step.mode == "whole DEM"


@pytest.mark.long
def test_a_bundle_without_a_skyline_keeps_several_hypotheses(scene):
    fog = blinded(scene.look(0, WEST_SPOT))
    *_, last = track(
        scene,
        (None, scene.look(0, WEST_SPOT)),
        (driven(120.0), fog),
        (driven(80.0), scene.look(0, EAST_SPOT)),
    )
    assert last.fix.status == "fix"
    assert scene.error_cells(last.fix, 0, EAST_SPOT) < 0.2


@pytest.mark.long
def test_a_track_goes_on_from_its_stored_state_as_if_it_had_not_stopped(scene):
    west, east = scene.look(0, WEST_SPOT), scene.look(0, EAST_SPOT)
    first, through = track(scene, (None, west), (driven(200.0), east))
    stored = Tracker.from_json(first.tracker.to_json())
    assert stored == first.tracker
    (resumed,) = track(scene, (driven(200.0), east), tracker=stored)
    assert resumed.fix.position == through.fix.position
    assert resumed.tracker == through.tracker


@pytest.mark.parametrize(
    "text", ["", "{}x", '{"schema": "skyfix.tracker/2"}', '{"now": {"hypotheses": [1]}}']
)
def test_a_state_that_is_none_is_refused_in_one_line(text):
    with pytest.raises(TrackerError, match="state of a track") as refusal:
        Tracker.from_json(text)
    assert "\n" not in str(refusal.value)
