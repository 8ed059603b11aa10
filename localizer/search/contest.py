"""The contest of the places that stage 2 found likeliest: who takes part, on what terms, and what the winner is worth.

Coarse fits choose the contenders; these are compared under one error model, that of the best of them, each at the best place
around it; the winner is fitted with all columns.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from localizer.horizon.from_terrain import Terrain
from localizer.observation import Observation
from localizer.search.contours import FrameContour
from localizer.search.decide import Decision, decide, explains
from localizer.search.error_model import ErrorModel
from localizer.search.noise import FIRST_LENGTH_CELLS, Noise, usual_noise
from localizer.search.places_around import places_around
from localizer.search.problem import Problem
from localizer.search.refine import LIKELY_FROM, Refined, refine
from localizer.search.stage2 import Scored, apart

LARGEST_DEM_ERROR = 4.0
"""A DEM's error is at most so many times what is usual for one of its kind."""
STARTS = 12
START_RADIUS_CELLS = 1.5
COARSE_COLUMNS = 120
"""Columns of all frames together in the first refinement of each start, and ..."""
CONTEST_COLUMNS = 480
"""... in the comparison of the contenders."""
CONTENDERS = 5
CONTEST_MARGIN = 0.5
"""A start whose columns are less likely than the best one's by this much each (in logarithms) is no contender."""
LOOK_ABOUT_CELLS = (2.4, 0.4)
"""How far around a fit other places are tried for a better one, and how far apart these are."""
LOOK_ABOUT_STARTS = 3
FINALISTS = 2
BLUNTING_PER_M = 10.0
"""By how much the log-likelihood of peaks close to each other is divided for each metre of the DEM's error: the error model is
only about right, and what a horizon does where one ridge hides another depends on details that it does not have."""
LOOK_ABOUT_ERRORS = (0.2, 1.5)
"""What is taken for a DEM's error in that, in terms of what is usual."""
SAME_PLACE_CELLS = 2.0


def contest(
    terrain: Terrain, observation: Observation, contours: tuple[FrameContour, ...], scored: Scored
) -> tuple[Decision, Refined | None]:
    """Refine the best cells, coarsely all, then the contenders under one error model, then the winner with all columns."""
    largest = LARGEST_DEM_ERROR * terrain.usual_error_m
    columns = sum(len(c.rays) for c in contours)
    coarse = Problem(terrain, observation, contours, stride=max(1, columns // COARSE_COLUMNS))
    refined = []
    for i in apart(scored, STARTS, START_RADIUS_CELLS):
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
    promising = _distinct(refined, SAME_PLACE_CELLS)[:CONTENDERS]
    refined = [_again(coarse, start, largest, settle=True, iterations=8) for start in promising]
    refined.sort(key=lambda r: r.misfit_per_column)
    contenders = [
        c
        for c in _distinct(refined, SAME_PLACE_CELLS)
        if c.misfit_per_column < refined[0].misfit_per_column + CONTEST_MARGIN
    ]
    full = Problem(terrain, observation, contours)
    stride = max(1, columns // CONTEST_COLUMNS)
    middle = Problem(terrain, observation, contours, stride)
    best = _best_nearby(full, middle, coarse, _again(full, contenders[0], largest, settle=True), largest)
    held = Noise(best.dem_error_m, max(1.0, best.correlation_columns / stride), best.error_model)
    compared = [_again(middle, best, largest, held=held)] + [
        _nearby(middle, coarse, _again(middle, c, largest, held=held), held, largest) for c in contenders[1:]
    ]
    compared = _distinct(sorted(compared, key=lambda r: r.cost), SAME_PLACE_CELLS)
    priors = 2 + 2 + 3 * len(contours)
    decision = decide(compared, best.evidence, terrain.cell_m)
    winner = decision.candidates[0]
    if np.hypot(winner.row - best.row, winner.col - best.col) > SAME_PLACE_CELLS:
        best = _best_nearby(full, middle, coarse, _again(full, winner, largest, settle=True), largest)
    if not explains(best, largest, priors):
        return Decision("none", [], np.zeros(0)), None
    return decision, best


def _best_nearby(full: Problem, middle: Problem, coarse: Problem, found: Refined, largest: float) -> Refined:
    """The best place around a fit, with all columns, its noise estimated there.

    A fit beside the best place may have taken its misfit for the DEM's error, and a larger error leaves it no reason to move.
    So the search about it takes several sizes for granted, each of the places found has its own noise estimated, and the
    likeliest under its own counts.
    """
    usual = full.terrain.usual_error_m
    length_m = FIRST_LENGTH_CELLS * full.terrain.cell_m
    ratio = len(middle.sigma_rad) / len(full.sigma_rad)
    correlation = max(1.0, found.correlation_columns * ratio)
    noises = [Noise(found.dem_error_m, correlation, found.error_model)] + [
        Noise(share * usual, correlation, ErrorModel(0.1 * share * usual, share * usual, length_m))
        for share in LOOK_ABOUT_ERRORS
    ]
    fits = _looked_about(middle, coarse, found, noises, largest, settle=True)
    starts = _distinct(sorted(fits, key=lambda r: r.fit_cost), LOOK_ABOUT_CELLS[1])[:FINALISTS]
    finals = [found, *(_again(full, start, largest, settle=True, likely_from=0) for start in starts)]
    return _doubted(min(finals, key=lambda r: r.fit_cost), fits, full.terrain)


def _doubted(best: Refined, others: list[Refined], terrain: Terrain) -> Refined:
    """The best fit, its covariance widened by the other peaks close by that may be the right one."""
    if not others:
        return best
    cost = np.array([best.fit_cost, *(r.fit_cost for r in others)])
    cost[0] = cost[1:].min()  # of all columns, the others of some
    share = np.exp((cost.min() - cost) / (1.0 + BLUNTING_PER_M * best.error_model.smooth_m))
    share /= share.sum()
    off_m = np.array(
        [
            [
                (r.col - best.col) * terrain.dem.spacing_ew_m,
                (best.row - r.row) * terrain.dem.spacing_ns_m,
            ]
            for r in (best, *others)
        ]
    )
    return replace(best, covariance_enu_m2=best.covariance_enu_m2 + (share[:, None] * off_m).T @ off_m)


def _nearby(middle: Problem, coarse: Problem, found: Refined, noise: Noise, largest: float) -> Refined:
    """The best fit with held noise that starts from one of the likeliest places around another."""
    around = _looked_about(middle, coarse, found, [noise], largest, settle=False)
    return min(around or [found], key=lambda r: r.fit_cost)


def _looked_about(
    middle: Problem, coarse: Problem, found: Refined, noises: Sequence[Noise], largest: float, *, settle: bool
) -> list[Refined]:
    """Fits from the likeliest places around another under each noise, which is held unless they ``settle`` their own."""
    return [
        refine(
            middle,
            row,
            col,
            altitude_m,
            found.azimuth_bias_deg,
            iterations=8,
            noise=noise,
            largest_dem_error_m=largest,
            settle=settle,
            likely_from=0,
        )
        for row, col, altitude_m, noise in places_around(
            coarse, found, noises, *LOOK_ABOUT_CELLS, LOOK_ABOUT_STARTS
        )
    ]


def _again(
    problem: Problem,
    start: Refined,
    largest: float,
    *,
    settle: bool = False,
    held: Noise | None = None,
    iterations: int = 24,
    likely_from: int = LIKELY_FROM,
) -> Refined:
    """Refine once more from where a coarser refinement ended; ``held``: the noise not to estimate anew."""
    return refine(
        problem,
        start.row,
        start.col,
        start.altitude_m,
        start.azimuth_bias_deg,
        iterations=iterations,
        noise=held or Noise(start.dem_error_m, start.correlation_columns, start.error_model),
        largest_dem_error_m=largest,
        settle=settle,
        likely_from=likely_from,
    )


def _distinct(candidates: list[Refined], radius_cells: float) -> list[Refined]:
    """The first of each group of candidates that lie within ``radius_cells`` of each other."""
    kept: list[Refined] = []
    for c in candidates:
        if all(np.hypot(c.row - k.row, c.col - k.col) > radius_cells for k in kept):
            kept.append(c)
    return kept


def _first_altitude(terrain: Terrain, observation: Observation, row: float, col: float) -> float:
    ground = float(terrain.dem.ground_m(row, col)) + observation.mast_height_m
    if observation.altitude_m is None:
        return ground
    weight = 1.0 / np.array([terrain.usual_error_m, observation.altitude_sigma_m]) ** 2
    return float(weight @ [ground, observation.altitude_m] / weight.sum())
