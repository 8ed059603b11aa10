"""The contest of the places that stage 2 found likeliest: who takes part, on what terms, and what the winner is worth.

Coarse fits choose the contenders; these are compared under one error model, that of the best of them, each at the best place
around it; the winner is fitted with all columns.
"""

import numpy as np
from numpy.typing import NDArray

from localizer.horizon.from_terrain import Terrain
from localizer.observation import Observation
from localizer.search.contours import FrameContour
from localizer.search.decide import Decision, decide, explains
from localizer.search.nearby import (
    HOPELESS_EVIDENCE,
    Problems,
    again,
    best_nearby,
    distinct,
    likeliest_nearby,
)
from localizer.search.noise import Noise, usual_noise
from localizer.search.problem import Problem
from localizer.search.refine import Refined, refine
from localizer.search.stage2 import Scored, apart

LARGEST_DEM_ERROR = 4.0
"""A DEM's error is at most so many times what is usual for one of its kind."""
STARTS = 12
START_RADIUS_CELLS = 1.5
COARSE_COLUMNS = 120
"""Columns of all frames together in the first refinement of each start, and ..."""
CONTEST_COLUMNS = 480
"""... in the comparison of the contenders, and ..."""
FINE_COLUMNS = 1000
"""... where the peaks around the best of them are told apart."""
CONTENDERS = 5
CONTEST_MARGIN = 0.5
"""A start whose columns are less likely than the best one's by this much each (in logarithms) is no contender."""
SAME_PLACE_CELLS = 2.0


def contest(
    terrain: Terrain, observation: Observation, contours: tuple[FrameContour, ...], scored: Scored
) -> tuple[Decision, Refined | None]:
    """Refine the best cells, coarsely all, then the contenders under one error model, then the winner with all columns."""
    largest = LARGEST_DEM_ERROR * terrain.usual_error_m
    columns = sum(len(c.rays) for c in contours)
    coarse = Problem(terrain, observation, contours, stride=max(1, columns // COARSE_COLUMNS))
    refined = []
    for i in starts(scored):
        row, col = scored.cells[i].astype(float)
        refined.append(
            refine(
                coarse,
                row,
                col,
                _first_altitude(terrain, observation, row, col),
                float(scored.azimuth_bias_deg[i]),
                iterations=4,
                noise=usual_noise(terrain, 2.0 * terrain.usual_error_m),
                largest_dem_error_m=largest,
                settle=True,
            )
        )
    refined.sort(key=lambda r: r.misfit_per_column)
    promising = distinct(refined, SAME_PLACE_CELLS)[:CONTENDERS]
    refined = [again(coarse, start, largest, settle=True, iterations=8) for start in promising]
    refined.sort(key=lambda r: r.misfit_per_column)
    contenders = [
        c
        for c in distinct(refined, SAME_PLACE_CELLS)
        if c.misfit_per_column < refined[0].misfit_per_column + CONTEST_MARGIN
    ]
    stride = max(1, columns // CONTEST_COLUMNS)
    problems = Problems(
        coarse=coarse,
        middle=Problem(terrain, observation, contours, stride),
        fine=Problem(terrain, observation, contours, max(1, columns // FINE_COLUMNS)),
        full=Problem(terrain, observation, contours),
    )
    best = best_nearby(problems, contenders[0], largest)
    held = Noise(best.dem_error_m, max(1.0, best.correlation_columns / stride), best.error_model)
    compared = [again(problems.middle, c, largest, noise=held) for c in [best, *contenders[1:]]]
    if best.evidence >= HOPELESS_EVIDENCE:
        compared[1:] = [likeliest_nearby(problems, c, held, largest) for c in compared[1:]]
    compared = distinct(sorted(compared, key=lambda r: r.cost), SAME_PLACE_CELLS)
    priors = 2 + 2 + 3 * len(contours)
    decision = decide(compared, best.evidence, terrain.cell_m)
    winner = decision.candidates[0]
    if np.hypot(winner.row - best.row, winner.col - best.col) > SAME_PLACE_CELLS:
        best = best_nearby(problems, winner, largest)
    if not explains(best, largest, priors):
        return Decision("none", [], np.zeros(0)), None
    return decision, best


def starts(scored: Scored) -> NDArray[np.int64]:
    """Which of the cells take part."""
    return apart(scored, STARTS, START_RADIUS_CELLS)


def _first_altitude(terrain: Terrain, observation: Observation, row: float, col: float) -> float:
    ground = float(terrain.dem.ground_m(row, col)) + observation.mast_height_m
    if observation.altitude_m is None:
        return ground
    weight = 1.0 / np.array([terrain.usual_error_m, observation.altitude_sigma_m]) ** 2
    return float(weight @ [ground, observation.altitude_m] / weight.sum())
