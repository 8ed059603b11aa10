"""Looking about: the likeliest places on a lattice around a fit, and how far those lie from it that are hardly less likely."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from localizer.search.fit.correlated_errors import normal_equations
from localizer.search.fit.noise import Noise
from localizer.search.fit.objective import normalisation_term, ordered_columns, prior_nll, visible_nll
from localizer.search.fit.outliers import informative_columns, outlier_penalty, weights
from localizer.search.fit.problem import ALTITUDE, EAST, NORTH, Problem
from localizer.search.fit.refine import Refined
from localizer.search.fit.residuals import Evaluation, evaluate, ground_at, place_of, residual_sigma

Floats = NDArray[np.float64]

CHECKED_SHARE = 0.01
MOST_CHECKED = 40
"""A place that far off that has so much of the likelihood is looked at, and so many of them at most."""


def grid_optima(
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
    coefficients = _frame_at(problem, start)
    origin = (start.row, start.col)
    found_places: list[tuple[float, float, float, Noise]] = []
    for noise, values in zip(
        noises, _evaluated_grid(problem, start, noises, reach_cells, step_cells), strict=True
    ):
        kept: list[Floats] = []
        for _, place in sorted(values, key=lambda entry: entry[0]):
            apart_m = [float(np.hypot(place[EAST] - k[EAST], place[NORTH] - k[NORTH])) for k in kept]
            if min(apart_m, default=np.inf) > 1.5 * step_cells * problem.terrain.cell_m:
                kept.append(place)
            if len(kept) == keep:
                break
        for k in kept:
            row, col = place_of(k, origin, coefficients)
            if all(np.hypot(row - r, col - c) > 0.5 * step_cells for r, c, _, _ in found_places):
                found_places.append((row, col, float(k[ALTITUDE]), noise))
    return found_places


def grid_second_moment(
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
    coefficients = _frame_at(problem, start)
    (values,) = _evaluated_grid(problem, start, [noise], reach_cells, step_cells)
    if not values:
        return np.zeros((2, 2))
    value = np.array([c for c, _ in values])
    off_m = np.array([x[[EAST, NORTH]] for _, x in values])
    accepted = np.hypot(*off_m.T) <= problem.terrain.cell_m
    for _ in range(MOST_CHECKED):
        share = np.exp((value.min() - value) / temperature)
        share /= share.sum()
        unchecked = np.flatnonzero(~accepted & (share >= CHECKED_SHARE))
        if len(unchecked) == 0:
            break
        i = int(unchecked[share[unchecked].argmax()])
        place = values[i][1]
        row, col = place_of(place, (start.row, start.col), coefficients)
        if plausible(row, col, float(place[ALTITUDE])):
            accepted[i] = True
        else:
            value[i] = np.inf
    share = np.exp((value.min() - value) / temperature)
    share /= share.sum()
    return np.asarray((share[:, None] * off_m).T @ off_m)


def _evaluated_grid(
    problem: Problem, start: Refined, noises: Sequence[Noise], reach_cells: float, step_cells: float
) -> list[list[tuple[float, Floats]]]:
    """Cost and parameters, metres counted from the fit, of each place on the lattice that is in the DEM, under each noise."""
    terrain = problem.terrain
    coefficients = _frame_at(problem, start)
    x = start.parameters()
    origin = (start.row, start.col)
    ticks = np.arange(-reach_cells, reach_cells + 1e-9, step_cells) * terrain.cell_m
    evaluation = evaluate(problem, x, origin, coefficients)
    found: list[list[tuple[float, Floats]]] = [[] for _ in noises]
    for east in ticks:
        for north in ticks:
            shifted_x = x.copy()
            shifted_x[EAST], shifted_x[NORTH] = east, north
            if not terrain.dem.covers(*place_of(shifted_x, origin, coefficients)):
                continue
            ground, _ = ground_at(problem, shifted_x, origin, coefficients)
            if np.isfinite(ground - evaluation.ground_m):
                shifted_x[ALTITUDE] += ground - evaluation.ground_m
            shifted = evaluate(problem, shifted_x, origin, coefficients, evaluation.guess_m)
            for noise, values in zip(noises, found, strict=True):
                values.append(_conditional_optimum(problem, shifted_x, shifted, noise))
    return found


def _frame_at(problem: Problem, place: Refined) -> Floats:
    return np.asarray(problem.terrain.geodesics.at(np.array([place.row]), np.array([place.col]))[0])


def _conditional_optimum(
    problem: Problem, x: Floats, evaluation: Evaluation, noise: Noise
) -> tuple[float, Floats]:
    """Cost, and the parameters with all but the place itself fitted in one step."""
    sigma = residual_sigma(problem, evaluation, noise.robust_sigma_m)
    normalised, informative = evaluation.residual / sigma, informative_columns(evaluation, sigma)
    columns = ordered_columns(problem, x, evaluation, noise.model, weights(informative, normalised))
    normal = normal_equations(columns, noise.model)
    step = np.linalg.solve(normal.hessian[ALTITUDE:, ALTITUDE:], normal.gradient[ALTITUDE:])
    value = (
        visible_nll(problem, x, evaluation, noise.model, sigma, normal.nll)
        + prior_nll(problem, x, evaluation, noise.model)
        - 0.5 * float(normal.gradient[ALTITUDE:] @ step)
        + outlier_penalty(problem, evaluation, sigma)
        + normalisation_term(problem, x, evaluation, noise.model)
    )
    fitted = x.copy()
    fitted[ALTITUDE:] -= step
    return value, fitted
