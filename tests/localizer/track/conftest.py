"""Drives over the three craters: each look is searched for once, whatever number of tests follow it."""

import pytest
from craters import WEST_SPOT, Scene, make_scene

from localizer.dem.horizon import Terrain
from localizer.observation import Observation
from localizer.search.answer import Located
from localizer.search.leave_one_out import CheckedAnswer
from localizer.search.locate import check_located, locate


@pytest.fixture(scope="session")
def scene(tmp_path_factory) -> Scene:
    return make_scene(tmp_path_factory.mktemp("craters"))


@pytest.fixture(scope="module")
def searched_once():
    """The whole DEM is searched once for each look: the answer to an observation is always the same."""
    found = {}

    def locate_once(terrain: Terrain, observation: Observation, **options):
        key = id(terrain), id(observation), *options.items()
        if key not in found:
            found[key] = (observation, locate(terrain, observation, **options))  # kept alive, for its id
        return found[key][1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("localizer.track.tracker.locate", locate_once)
        patch.setattr("localizer.track.tracker.check_located", all_agree)
        yield locate_once


def all_agree(terrain: Terrain, observation: Observation, located: Located) -> CheckedAnswer:
    """Of frames that do: searches without each of them would take twice as long as all others."""
    return CheckedAnswer(located, {})


@pytest.fixture(autouse=True)
def frames_are_checked_in_long_tests(request, monkeypatch):
    if request.node.get_closest_marker("long"):
        monkeypatch.setattr("localizer.track.tracker.check_located", check_located)


@pytest.fixture(scope="module")
def west_alone(scene, searched_once):
    """What the search says of the western spot of crater 0."""
    return searched_once(scene.terrain, scene.look(0, WEST_SPOT))
