"""What a place costs: the columns along the horizon and the priors, as the error model weighs them."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from localizer.search.fit.correlated_errors import Columns, ErrorModel, log_scale, whitened_cost
from localizer.search.fit.outliers import telling_columns, visible_columns, visible_residual, weights
from localizer.search.fit.problem import ALTITUDE, EAST, NORTH, Problem
from localizer.search.fit.residuals import STEEPEST, Evaluation

Floats = NDArray[np.float64]

GROUND_SHARE = 1.5
"""The ground under the camera is known less well than a ridge, which the profile of a whole mountain carries."""


def columns_along(
    problem: Problem, x: Floats, here: Evaluation, model: ErrorModel, weight: Floats
) -> Columns:
    """The columns along the horizon and the priors, for the error model; stray columns (of small ``weight``) count as noisy."""
    order = problem.order
    steep2 = np.minimum(here.slope**2, STEEPEST**2)
    distance = here.error_distance_m[order]
    across = 0.5 * (distance + np.roll(distance, 1)) * problem.step_rad
    misfit, rows = prior_misfits(problem, x, here, model.size_m)
    return Columns(
        residual=here.residual[order],
        jacobian=here.jacobian[order],
        white=(problem.sigma_rad**2 * (1.0 + steep2) / np.maximum(weight, 1e-6))[order],
        per_m=here.error_per_m[order],
        step_m=np.hypot(across, distance - np.roll(distance, 1)),
        cell_m=problem.terrain.cell_m,
        prior=rows.T @ rows + 1e-12 * np.eye(problem.size),
        pull=rows.T @ misfit,
    )


def visible_cost(
    problem: Problem, x: Floats, here: Evaluation, model: ErrorModel, sigma: Floats, telling_cost: float
) -> float:
    """What the columns cost that show terrain, even where it is left open which; ``telling_cost``: of those that tell it.

    Undecided columns do not move a fit. But were they free, the likeliest place would be the one that leaves most undecided.
    """
    visible = visible_columns(here, sigma)
    if np.array_equal(telling_columns(here, sigma), visible):
        return telling_cost
    seen = replace(here, residual=visible_residual(here, sigma))
    weight = weights(visible, seen.residual / sigma)
    return whitened_cost(columns_along(problem, x, seen, model, weight), model)


def expected_scale(problem: Problem, x: Floats, here: Evaluation, model: ErrorModel) -> float:
    """Half the logarithm of the determinant of the covariance that the residuals are expected to have.

    A place whose horizon is near explains almost anything; that it had to be expected to be so far off counts against it.
    """
    return log_scale(columns_along(problem, x, here, model, np.ones(len(here.residual))), model)


def prior_misfits(problem: Problem, x: Floats, here: Evaluation, s: float) -> tuple[Floats, Floats]:
    """Normalised misfits of the priors (k,) and their derivatives (k, parameters)."""
    known = np.isfinite(problem.prior_sigma_deg)
    misfit = [x[known] / problem.prior_sigma_deg[known]]
    rows = [np.diag(1.0 / problem.prior_sigma_deg)[known]]
    o = problem.observation
    if np.isfinite(here.ground_m):
        shared = 0.0 if problem.terrain.exact else GROUND_SHARE * s
        sigma = np.hypot(shared, here.ground_sigma_m)
        misfit.append(np.array([(x[ALTITUDE] - o.mast_height_m - here.ground_m) / sigma]))
        row = np.zeros((1, problem.size))
        row[0, ALTITUDE], row[0, EAST], row[0, NORTH] = 1.0, *(-here.ground_gradient)
        rows.append(row / sigma)
    if o.altitude_m is not None:
        misfit.append(np.array([(x[ALTITUDE] - o.altitude_m) / o.altitude_sigma_m]))
        row = np.zeros((1, problem.size))
        row[0, ALTITUDE] = 1.0
        rows.append(row / o.altitude_sigma_m)
    return np.concatenate(misfit), np.vstack(rows)


def prior_cost(problem: Problem, x: Floats, here: Evaluation, model: ErrorModel) -> float:
    """Half the sum of the priors' squared misfits."""
    misfit, _ = prior_misfits(problem, x, here, model.size_m)
    return 0.5 * float((misfit**2).sum())
