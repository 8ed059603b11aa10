"""Looking about: the likeliest places on a lattice around a fit, and how far those lie from it that are hardly less likely."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from localizer.search.fit.correlated_errors import normal_equations
from localizer.search.fit.noise import Noise
from localizer.search.fit.objective import columns_along, expected_scale, prior_cost, visible_cost
from localizer.search.fit.outliers import stray_loss, telling_columns, weights
from localizer.search.fit.problem import ALTITUDE, EAST, NORTH, Problem
from localizer.search.fit.refine import Refined
from localizer.search.fit.residuals import Evaluation, evaluate, ground_at, place_of, residual_sigma

Floats = NDArray[np.float64]

DOUBTED_SHARE, MOST_DOUBTED = 0.01, 40
"""A place that far off that has so much of the likelihood is looked at, and so many of them at most."""


def places_around(
    problem: Problem,
    start: Refined,
    noises: Sequence[Noise],
    reach_cells: float,
    step_cells: float,
    keep: int,
) -> list[tuple[float, float, float, Noise]]:
    """Row, column, altitude and noise of the ``keep`` likeliest places under each noise on a lattice around a fit, each once.

    Close to hills the horizon leaps from rise to rise as one moves, and each leap may stop a descent: so one looks about. At
    each place all but the place itself is fitted in one step. No two places under one noise are neighbours.
    """
    frame = _frame_at(problem, start)
    origin = (start.row, start.col)
    places: list[tuple[float, float, float, Noise]] = []
    for noise, costs in zip(noises, _lattice(problem, start, noises, reach_cells, step_cells), strict=True):
        kept: list[Floats] = []
        for _, place in sorted(costs, key=lambda entry: entry[0]):
            apart_m = [float(np.hypot(place[EAST] - k[EAST], place[NORTH] - k[NORTH])) for k in kept]
            if min(apart_m, default=np.inf) > 1.5 * step_cells * problem.terrain.cell_m:
                kept.append(place)
            if len(kept) == keep:
                break
        for k in kept:
            row, col = place_of(k, origin, frame)
            if all(np.hypot(row - r, col - c) > 0.5 * step_cells for r, c, _, _ in places):
                places.append((row, col, float(k[ALTITUDE]), noise))
    return places


def spread_around(
    problem: Problem,
    start: Refined,
    noise: Noise,
    reach_cells: float,
    step_cells: float,
    temperature: float,
    plausible: Callable[[float, float, float], bool],
) -> Floats:
    """Second moment (2, 2), square metres east and north, about a fit of the likelihood on a lattice around it.

    The logarithm of the likelihood is divided by ``temperature``. Where it has one narrow peak between the lattice's points
    there is next to nothing; where it is flat or has many peaks, how far these reach. A place more than a cell off counts only
    if it is ``plausible`` (row, column, altitude): the likelihood forgives stretches that do not fit at all.
    """
    frame = _frame_at(problem, start)
    (costs,) = _lattice(problem, start, [noise], reach_cells, step_cells)
    if not costs:
        return np.zeros((2, 2))
    cost = np.array([c for c, _ in costs])
    off_m = np.array([x[[EAST, NORTH]] for _, x in costs])
    trusted = np.hypot(*off_m.T) <= problem.terrain.cell_m
    for _ in range(MOST_DOUBTED):
        share = np.exp((cost.min() - cost) / temperature)
        share /= share.sum()
        doubtful = np.flatnonzero(~trusted & (share >= DOUBTED_SHARE))
        if len(doubtful) == 0:
            break
        i = int(doubtful[share[doubtful].argmax()])
        place = costs[i][1]
        row, col = place_of(place, (start.row, start.col), frame)
        if plausible(row, col, float(place[ALTITUDE])):
            trusted[i] = True
        else:
            cost[i] = np.inf
    share = np.exp((cost.min() - cost) / temperature)
    share /= share.sum()
    return np.asarray((share[:, None] * off_m).T @ off_m)


def _lattice(
    problem: Problem, start: Refined, noises: Sequence[Noise], reach_cells: float, step_cells: float
) -> list[list[tuple[float, Floats]]]:
    """Cost and parameters, metres counted from the fit, of each place on the lattice that is in the DEM, under each noise."""
    terrain = problem.terrain
    frame = _frame_at(problem, start)
    x = start.parameters()
    origin = (start.row, start.col)
    ticks = np.arange(-reach_cells, reach_cells + 1e-9, step_cells) * terrain.cell_m
    here = evaluate(problem, x, origin, frame)
    found: list[list[tuple[float, Floats]]] = [[] for _ in noises]
    for east in ticks:
        for north in ticks:
            moved = x.copy()
            moved[EAST], moved[NORTH] = east, north
            if not terrain.dem.covers(*place_of(moved, origin, frame)):
                continue
            ground, _ = ground_at(problem, moved, origin, frame)
            if np.isfinite(ground - here.ground_m):
                moved[ALTITUDE] += ground - here.ground_m
            there = evaluate(problem, moved, origin, frame, here.guess_m)
            for noise, costs in zip(noises, found, strict=True):
                costs.append(_fitted_there(problem, moved, there, noise))
    return found


def _frame_at(problem: Problem, place: Refined) -> Floats:
    return np.asarray(problem.terrain.frames.at(np.array([place.row]), np.array([place.col]))[0])


def _fitted_there(problem: Problem, x: Floats, here: Evaluation, noise: Noise) -> tuple[float, Floats]:
    """Cost, and the parameters with all but the place itself fitted in one step."""
    sigma = residual_sigma(problem, here, noise.spread_m)
    normalised, telling = here.residual / sigma, telling_columns(here, sigma)
    columns = columns_along(problem, x, here, noise.model, weights(telling, normalised))
    normal = normal_equations(columns, noise.model)
    step = np.linalg.solve(normal.curvature[ALTITUDE:, ALTITUDE:], normal.slope[ALTITUDE:])
    cost = (
        visible_cost(problem, x, here, noise.model, sigma, normal.cost)
        + prior_cost(problem, x, here, noise.model)
        - 0.5 * float(normal.slope[ALTITUDE:] @ step)
        + stray_loss(problem, here, sigma)
        + expected_scale(problem, x, here, noise.model)
    )
    fitted = x.copy()
    fitted[ALTITUDE:] -= step
    return cost, fitted
