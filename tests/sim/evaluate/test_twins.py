"""The scenario of twins: a DEM with the same surroundings twice, of which the vehicle sees one alone."""

from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from sim.errors import SimulationError
from sim.evaluate.case import case_generators
from sim.evaluate.scenario import EvaluationScenario, load_evaluation_scenario
from sim.evaluate.searched_dem import terrain_of_twins
from sim.evaluate.twins import draw_twins
from sim.world.surface import Surface
from sim.world.terrain import read_terrain

ROOT = Path(__file__).parents[3]
SANTA_CRUZ = ROOT / "sim" / "terrain" / "santa_cruz_srtm_1s.tif"
SIDE = 400


@pytest.fixture(scope="module")
def known() -> Surface:
    return Surface(read_terrain([SANTA_CRUZ]))


def scenario(*relief_m: float) -> EvaluationScenario:
    return EvaluationScenario.model_validate({"twins": {"cells": SIDE, "relief_m": relief_m}})


def test_the_scenario_that_ships_draws_twins_of_several_sizes_of_relief():
    shipped = load_evaluation_scenario(ROOT / "configs" / "scenarios" / "evaluate" / "twins.toml")
    assert shipped.twins is not None
    assert shipped.twins.relief_m == (0.0, 1.0, 3.0, 10.0)


def test_both_copies_are_alike_and_the_vehicle_sees_its_own_alone(known):
    drawn = draw_twins(known, scenario(0.0), scenario(0.0).twins, case_generators(1, 0))
    height_m = drawn.surface.height_m
    assert height_m.shape == (SIDE, 3 * SIDE)
    np.testing.assert_array_equal(height_m[:, :SIDE], height_m[:, 2 * SIDE :])
    np.testing.assert_array_equal(height_m[:, SIDE : 2 * SIDE], height_m[:, SIDE - 1 :: -1])
    here = drawn.observer
    other = here.col + (2 * SIDE if here.col < SIDE else -2 * SIDE)
    there = drawn.surface.observer(here.row, other, here.altitude_m)
    azimuth = np.arange(0.0, 360.0, 1.0)
    seen, twin = (drawn.surface.horizon(eye, azimuth)[0] for eye in (here, there))
    np.testing.assert_allclose(seen, twin, atol=1e-6)


def test_the_copy_differs_by_the_relief_that_is_added(known):
    drawn = draw_twins(known, scenario(3.0), scenario(3.0).twins, case_generators(2, 0))
    height_m = drawn.surface.height_m
    assert float((height_m[:, 2 * SIDE :] - height_m[:, :SIDE]).std()) == pytest.approx(3.0, rel=0.01)


def test_the_vehicle_stands_on_either_copy(known):
    sides = {
        draw_twins(known, scenario(0.0), scenario(0.0).twins, case_generators(7, case)).observer.col < SIDE
        for case in range(12)
    }
    assert sides == {True, False}


def test_the_searched_dem_is_that_of_the_truth(known):
    drawn = draw_twins(known, scenario(1.0), scenario(1.0).twins, case_generators(3, 0))
    terrain = terrain_of_twins(SANTA_CRUZ, drawn)
    np.testing.assert_array_equal(terrain.dem.z_m, drawn.surface.height_m)
    lon_deg, lat_deg = drawn.surface.terrain.lonlat_deg(0.0, 0.0)
    known_lon_deg, known_lat_deg = known.terrain.lonlat_deg(float(drawn.first_row), float(drawn.first_col))
    assert (float(lon_deg), float(lat_deg)) == pytest.approx((float(known_lon_deg), float(known_lat_deg)))
    x, y = terrain.dem.transform @ (0.5, 0.5)
    assert (x, y) == pytest.approx((float(known_lon_deg), float(known_lat_deg)))


@pytest.mark.parametrize("other", [{"dem_error": {"rms_m": 5.0}}, {"searched": "other half"}])
def test_twins_go_with_no_other_change_of_the_dem(other):
    with pytest.raises(ValidationError, match=r"\[twins\] goes neither"):
        EvaluationScenario.model_validate({"twins": {}} | other)


def test_a_dem_that_is_too_small_is_named(known, tmp_path):
    small = Surface(read_terrain([SANTA_CRUZ]))
    small.height_m = np.ascontiguousarray(small.height_m[:50, :50])
    with pytest.raises(SimulationError, match="too few for twins"):
        draw_twins(small, scenario(0.0), scenario(0.0).twins, case_generators(1, 0))
