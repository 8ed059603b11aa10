"""How well the ground under the camera is known: a DEM rounds summits off, and nothing else by as much."""

import numpy as np
import pytest
from local_map import local_dem
from seen_from import observe

from localizer.dem.horizon import Terrain, prepare_terrain
from localizer.search.contours import frame_contour
from localizer.search.fit.problem import ALTITUDE, Problem
from localizer.search.fit.residuals import evaluate

CELL_M, SIDE, MIDDLE = 100.0, 61, 30


def terrain_with(middle_m: float) -> Terrain:
    """A wide bowl with a rim of hills all round, and a cell in its middle that is higher or lower than its neighbours."""
    south, east = np.mgrid[:SIDE, :SIDE] - MIDDLE
    away = np.hypot(south, east)
    height_m = 500.0 + np.where(away > 20.0, 12.0 * (away - 20.0) * (1.2 + np.sin(0.4 * east)), 0.0)
    height_m[MIDDLE, MIDDLE] += middle_m
    return prepare_terrain(local_dem(height_m, CELL_M))


def ground_sigma_m(middle_m: float, place: tuple[float, float] = (MIDDLE, MIDDLE)) -> float:
    terrain = terrain_with(middle_m)
    observation = observe(terrain, place)
    problem = Problem(terrain, observation, tuple(frame_contour(f) for f in observation.frames), 8)
    x = np.zeros(problem.size)
    x[ALTITUDE] = float(terrain.dem.ground_m(*place)) + 2.0
    frame = terrain.geodesics.at(np.array([place[0]]), np.array([place[1]]))[0]
    return evaluate(problem, x, place, frame).ground_sigma_m


def test_on_a_summit_the_ground_may_be_higher_by_half_of_what_it_rises():
    assert ground_sigma_m(80.0) == pytest.approx(40.0, rel=0.25)


def test_in_a_hollow_and_beside_the_summit_it_is_known_as_well_as_its_bend_says():
    assert ground_sigma_m(-80.0) < 20.0
    assert ground_sigma_m(80.0, (MIDDLE + 3.0, MIDDLE)) < 5.0


@pytest.mark.parametrize(("middle_m", "above_m"), [(80.0, 80.0), (-80.0, 0.0), (0.0, 0.0)])
def test_a_cell_stands_above_the_mean_of_its_neighbours_or_not_at_all(middle_m, above_m):
    assert terrain_with(middle_m).above_neighbours_m(MIDDLE, MIDDLE) == pytest.approx(above_m)


def test_at_the_end_of_the_dem_nothing_is_said_of_neighbours():
    assert terrain_with(80.0).above_neighbours_m(0.0, 5.0) == 0.0
