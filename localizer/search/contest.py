"""The contest of the places that stage 2 found likeliest: who takes part, on what terms, and what the winner is worth.

Coarse fits choose the contenders; these are compared under one error model, that of the best of them, each at the best place
around it; the winner is fitted with all columns.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from localizer.horizon.from_terrain import Terrain
from localizer.observation import Observation
from localizer.search.contours import FrameContour
from localizer.search.decide import Decision, answered_with, decide, explains
from localizer.search.nearby import (
    HOPELESS_EVIDENCE,
    SAME_PLACE_CELLS,
    again,
    best_nearby,
    distinct,
    likeliest_nearby,
    problems_of,
)
from localizer.search.noise import Noise, usual_noise
from localizer.search.refine import Refined, refine
from localizer.search.stage2 import Scored, apart

STARTS = 12
START_RADIUS_CELLS = 1.5
CONTENDERS = 5
CONTEST_MARGIN = 0.5
"""A start whose columns are less likely than the best one's by this much each (in logarithms) is no contender."""


def contest(
    terrain: Terrain, observation: Observation, contours: tuple[FrameContour, ...], scored: Scored
) -> tuple[Decision, Refined | None]:
    """Refine the best cells, coarsely all, then the contenders under one error model, then the winner with all columns."""
    largest = terrain.largest_error_m
    problems = problems_of(terrain, observation, contours)
    refined = []
    for i in starts(scored):
        row, col = scored.cells[i].astype(float)
        refined.append(
            refine(
                problems.coarse,
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
    refined = [again(problems.coarse, start, largest, settle=True, iterations=8) for start in promising]
    refined.sort(key=lambda r: r.misfit_per_column)
    contenders = [
        c
        for c in distinct(refined, SAME_PLACE_CELLS)
        if c.misfit_per_column < refined[0].misfit_per_column + CONTEST_MARGIN
    ]
    best = best_nearby(problems, contenders[0], largest)
    held = Noise(
        best.dem_error_m, max(1.0, best.correlation_columns / problems.middle.stride), best.error_model
    )
    compared = [again(problems.middle, c, largest, noise=held) for c in [best, *contenders[1:]]]
    if best.evidence >= HOPELESS_EVIDENCE:
        compared[1:] = [likeliest_nearby(problems, c, held, largest) for c in compared[1:]]
    compared = distinct(sorted(compared, key=lambda r: r.cost), SAME_PLACE_CELLS)
    decision = decide(compared, best.evidence, terrain.cell_m)
    winner = decision.candidates[0]
    if np.hypot(winner.row - best.row, winner.col - best.col) > SAME_PLACE_CELLS:
        best = best_nearby(problems, winner, largest)
    if not (explains(best, largest, _priors(contours)) and terrain.dem.covers(best.row, best.col)):
        return Decision("none", [], np.zeros(0)), None
    return answered_with(decision, best, terrain.cell_m), best


def sharpened(
    terrain: Terrain, observation: Observation, contours: tuple[FrameContour, ...], best: Refined
) -> Refined:
    """The best place around one that was found with doubts about the DEM, by its word alone; the old one where that fits badly.

    What is close by shows the last metres of the way, and misleads whoever is farther off.
    """
    problems = problems_of(terrain, observation, contours)
    largest = problems.full.largest_error_m
    there = best_nearby(problems, best, largest)
    stays = np.hypot(there.row - best.row, there.col - best.col) <= SAME_PLACE_CELLS
    return replace(there, dem_error_m=0.0) if stays and explains(there, largest, _priors(contours)) else best


def _priors(contours: tuple[FrameContour, ...]) -> int:
    """How many readings there are: altitude, the ground's, both biases, and three for each frame."""
    return 2 + 2 + 3 * len(contours)


def starts(scored: Scored) -> NDArray[np.int64]:
    """Which of the cells take part."""
    return apart(scored, STARTS, START_RADIUS_CELLS)


def _first_altitude(terrain: Terrain, observation: Observation, row: float, col: float) -> float:
    ground = float(terrain.dem.ground_m(row, col)) + observation.mast_height_m
    if observation.altitude_m is None:
        return ground
    weight = 1.0 / np.array([terrain.usual_error_m, observation.altitude_sigma_m]) ** 2
    return float(weight @ [ground, observation.altitude_m] / weight.sum())
