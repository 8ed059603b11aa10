"""Where a track knows its place, only the surroundings are searched; and the whole DEM, where they do not fit."""

import dataclasses

import pytest
from craters import EAST_SPOT, SIDE, WEST_SPOT, blinded, driven, track

from localizer.dem.geodesy import rowcol_to_lonlat
from localizer.observation import PriorCircle

pytestmark = pytest.mark.usefixtures("searched_once")


@pytest.fixture(scope="module")
def first_step(scene, searched_once):
    """Of a track that begins at the western spot of crater 2, which has no double."""
    return track(scene, (None, scene.look(2, WEST_SPOT)))[0]


def test_a_track_with_one_place_searches_only_around_it(scene, first_step):
    (second,) = track(scene, (driven(200.0), scene.look(2, EAST_SPOT)), tracker=first_step.tracker)
    assert first_step.fix.status == "fix"
    assert second.mode == "bootstrap"
    assert second.fix.status == "fix"  # the search alone would not know which crater it is
    assert scene.error_cells(second.fix, 2, EAST_SPOT) < 0.2
    assert second.fix.stage1.after_altitude < 0.1 * first_step.fix.stage1.cells


def test_where_the_odometry_misleads_the_whole_dem_is_searched_and_the_history_dropped(scene, first_step):
    # carried from crater 2 to crater 1, 2.7 km away, while the odometry tells of a short drive
    (second,) = track(scene, (driven(200.0), scene.look(1, EAST_SPOT)), tracker=first_step.tracker)
    assert first_step.fix.status == "fix"
    assert second.mode == "whole DEM after bootstrap failed"
    assert second.fix.status == "fix"
    assert scene.error_cells(second.fix, 1, EAST_SPOT) < 0.2


@pytest.mark.long
def test_a_bundle_without_a_skyline_gives_none_and_the_track_goes_on(scene):
    fog = blinded(scene.look(2, WEST_SPOT))
    first, second, third = track(
        scene,
        (None, scene.look(2, WEST_SPOT)),
        (driven(120.0), fog),
        (driven(80.0), scene.look(2, EAST_SPOT)),
    )
    assert second.fix.status == "none"
    assert second.fix.position is None
    assert second.fix.candidates == ()
    kept = second.tracker.now.hypotheses
    assert len(kept) == len(first.tracker.now.hypotheses)
    assert kept[0].place.widest_m > first.tracker.now.hypotheses[0].place.widest_m
    assert kept[0].place.lon_deg > first.tracker.now.hypotheses[0].place.lon_deg
    assert (third.mode, third.fix.status) == ("bootstrap", "fix")
    assert scene.error_cells(third.fix, 2, EAST_SPOT) < 0.2


def test_the_bundles_own_prior_limits_the_search_of_the_whole_dem(scene):
    lon_deg, lat_deg = rowcol_to_lonlat(scene.terrain.dem, WEST_SPOT[0], WEST_SPOT[1] + SIDE)
    prior = PriorCircle(float(lat_deg), float(lon_deg), 800.0)
    (step,) = track(scene, (None, dataclasses.replace(scene.look(0, WEST_SPOT), prior=prior)))
    assert step.fix.status == "fix"
    assert scene.error_cells(step.fix, 1, WEST_SPOT) < 0.2
