"""Grid search around a fit: the other local optima nearby, and the second moment of the posterior over the grid.

At each grid point the position is fixed and all other unknowns are fitted in one Gauss-Newton step (profile likelihood).
"""

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
"""A distant grid point is checked for plausibility if it has this share of the posterior. Tuned on the scenario ``dem_error``.
Sensitivity: not measured yet (``sim sensitivity``)."""
MOST_CHECKED = 40
"""Grid points checked at most."""


def grid_optima(
    problem: Problem,
    start: Refined,
    noises: Sequence[Noise],
    reach_cells: float,
    step_cells: float,
    keep: int,
) -> list[tuple[float, float, float, Noise]]:
    """Row, column, altitude and noise of the ``keep`` most likely grid points under each noise, without duplicates.

    Near hills the horizon jumps between ridges when the position changes. Each jump makes a local optimum at which a descent
    may stop; the grid finds the others. No two points under one noise are neighbours.
    """
    coefficients = _coefficients_at(problem, start)
    origin = (start.row, start.col)
    optima: list[tuple[float, float, float, Noise]] = []
    for noise, evaluated in zip(
        noises, _evaluated_grid(problem, start, noises, reach_cells, step_cells), strict=True
    ):
        kept: list[Floats] = []
        for _, place in sorted(evaluated, key=lambda entry: entry[0]):
            apart_m = [float(np.hypot(place[EAST] - k[EAST], place[NORTH] - k[NORTH])) for k in kept]
            if min(apart_m, default=np.inf) > 1.5 * step_cells * problem.terrain.cell_m:
                kept.append(place)
            if len(kept) == keep:
                break
        for k in kept:
            row, col = place_of(k, origin, coefficients)
            if all(np.hypot(row - r, col - c) > 0.5 * step_cells for r, c, _, _ in optima):
                optima.append((row, col, float(k[ALTITUDE]), noise))
    return optima


def grid_second_moment(
    problem: Problem,
    start: Refined,
    noise: Noise,
    reach_cells: float,
    step_cells: float,
    temperature: float,
    plausible: Callable[[float, float, float], bool],
) -> Floats:
    """Second moment (2, 2) of the tempered posterior on the grid about the fit, square metres of true east and north.

    The log-posterior is divided by ``temperature``. The moment is near zero for a single narrow optimum between the grid
    points, and large for a flat likelihood or one with many optima. A point more than a cell away counts only if it is
    ``plausible`` (row, column, altitude), because the robust likelihood tolerates whole stretches that do not fit.
    """
    coefficients = _coefficients_at(problem, start)
    (evaluated,) = _evaluated_grid(problem, start, [noise], reach_cells, step_cells)
    if not evaluated:
        return np.zeros((2, 2))
    nll = np.array([c for c, _ in evaluated])
    off_m = np.array([x[[EAST, NORTH]] for _, x in evaluated])
    accepted = np.hypot(*off_m.T) <= problem.terrain.cell_m
    for _ in range(MOST_CHECKED):
        share = np.exp((nll.min() - nll) / temperature)
        share /= share.sum()
        unchecked = np.flatnonzero(~accepted & (share >= CHECKED_SHARE))
        if len(unchecked) == 0:
            break
        i = int(unchecked[share[unchecked].argmax()])
        place = evaluated[i][1]
        row, col = place_of(place, (start.row, start.col), coefficients)
        if plausible(row, col, float(place[ALTITUDE])):
            accepted[i] = True
        else:
            nll[i] = np.inf
    share = np.exp((nll.min() - nll) / temperature)
    share /= share.sum()
    return np.asarray((share[:, None] * off_m).T @ off_m)


def _evaluated_grid(
    problem: Problem, start: Refined, noises: Sequence[Noise], reach_cells: float, step_cells: float
) -> list[list[tuple[float, Floats]]]:
    """Negative log-posterior and unknowns, the fit as origin, of each grid point within the DEM, under each noise."""
    terrain = problem.terrain
    coefficients = _coefficients_at(problem, start)
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
            for noise, evaluated in zip(noises, found, strict=True):
                evaluated.append(_conditional_optimum(problem, shifted_x, shifted, noise))
    return found


def _coefficients_at(problem: Problem, place: Refined) -> Floats:
    return np.asarray(problem.terrain.geodesics.at(np.array([place.row]), np.array([place.col]))[0])


def _conditional_optimum(
    problem: Problem, x: Floats, evaluation: Evaluation, noise: Noise
) -> tuple[float, Floats]:
    """Negative log-posterior, and the unknowns with all but the position fitted in one step."""
    sigma = residual_sigma(problem, evaluation, noise.robust_sigma_m)
    normalised, informative = evaluation.residual / sigma, informative_columns(evaluation, sigma)
    columns = ordered_columns(problem, x, evaluation, noise.model, weights(informative, normalised))
    normal = normal_equations(columns, noise.model)
    step = np.linalg.solve(normal.hessian[ALTITUDE:, ALTITUDE:], normal.gradient[ALTITUDE:])
    nll = (
        visible_nll(problem, x, evaluation, noise.model, sigma, normal.nll)
        + prior_nll(problem, x, evaluation, noise.model)
        - 0.5 * float(normal.gradient[ALTITUDE:] @ step)
        + outlier_penalty(problem, evaluation, sigma)
        + normalisation_term(problem, x, evaluation, noise.model)
    )
    fitted = x.copy()
    fitted[ALTITUDE:] -= step
    return nll, fitted
