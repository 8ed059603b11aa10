"""The objective: the negative log-posterior of the unknowns, up to a constant.

It is the sum of half the squared whitened residuals, the log-normalisation of their covariance, the outliers' part, and half
the squared normalised deviations from the priors.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from localizer.search.fit.correlated_errors import Columns, ErrorModel, half_log_determinant, whitened_nll
from localizer.search.fit.outliers import informative_columns, visible_columns, visible_residual, weights
from localizer.search.fit.problem import ALTITUDE, EAST, NORTH, Problem
from localizer.search.fit.residuals import LARGEST_SLOPE, Evaluation

Floats = NDArray[np.float64]

GROUND_ERROR_FACTOR = 1.5
"""Error of the ground under the camera over that of a ridge, whose height follows from the profile of a whole mountain. Tuned
on the simulated cases of ``sim evaluate``. Sensitivity: halved, 1 of 5 statuses changes, places move by 0.4 sigma, sigmas
change by the factor 0.7; doubled, 1 of 5 statuses changes, places move by 0.3 sigma (docs/sensitivity.md)."""


def ordered_columns(
    problem: Problem, x: Floats, evaluation: Evaluation, model: ErrorModel, weight: Floats
) -> Columns:
    """The columns ordered by azimuth, and the priors, as the error model takes them.

    M-estimation by reweighting: the white variance of a column is divided by its ``weight`` (n,).
    """
    order = problem.order
    slope2 = np.minimum(evaluation.slope**2, LARGEST_SLOPE**2)
    distance = evaluation.error_distance_m[order]
    across = 0.5 * (distance + np.roll(distance, 1)) * problem.step_rad
    residual, jacobian = prior_residuals(problem, x, evaluation, model.size_m)
    return Columns(
        residual=evaluation.residual[order],
        jacobian=evaluation.jacobian[order],
        white=(problem.sigma_rad**2 * (1.0 + slope2) / np.maximum(weight, 1e-6))[order],
        per_m=evaluation.error_per_m[order],
        step_m=np.hypot(across, distance - np.roll(distance, 1)),
        cell_m=problem.terrain.cell_m,
        prior_hessian=jacobian.T @ jacobian + 1e-12 * np.eye(problem.size),
        prior_gradient=jacobian.T @ residual,
    )


def visible_nll(
    problem: Problem,
    x: Floats,
    evaluation: Evaluation,
    model: ErrorModel,
    sigma: Floats,
    informative_nll: float,
) -> float:
    """Negative log-likelihood of all visible columns; ``informative_nll``: that of the informative ones.

    Undetermined columns do not influence a fit. Without a term here, however, the objective would favour places with many
    undetermined columns.
    """
    visible = visible_columns(evaluation, sigma)
    if np.array_equal(informative_columns(evaluation, sigma), visible):
        return informative_nll
    nearest = replace(evaluation, residual=visible_residual(evaluation, sigma))
    weight = weights(visible, nearest.residual / sigma)
    return whitened_nll(ordered_columns(problem, x, nearest, model, weight), model)


def normalisation_term(problem: Problem, x: Floats, evaluation: Evaluation, model: ErrorModel) -> float:
    """Log-normalisation of the Gaussian: 0.5 ln det of the covariance of the residuals.

    At a place with a near horizon large residuals are expected. This term is the price for the large variance.
    """
    return half_log_determinant(
        ordered_columns(problem, x, evaluation, model, np.ones(len(evaluation.residual))), model
    )


def prior_residuals(problem: Problem, x: Floats, evaluation: Evaluation, s: float) -> tuple[Floats, Floats]:
    """Normalised deviations from the priors (k,) and their derivatives (k, parameters); ``s``: DEM error, metres."""
    known = np.isfinite(problem.prior_sigma_deg)
    residual = [x[known] / problem.prior_sigma_deg[known]]
    jacobian = [np.diag(1.0 / problem.prior_sigma_deg)[known]]
    o = problem.observation
    if np.isfinite(evaluation.ground_m):
        shared = 0.0 if problem.terrain.exact else GROUND_ERROR_FACTOR * s
        sigma = np.hypot(shared, evaluation.ground_sigma_m)
        residual.append(np.array([(x[ALTITUDE] - o.mast_height_m - evaluation.ground_m) / sigma]))
        jacobian_row = np.zeros((1, problem.size))
        jacobian_row[0, ALTITUDE], jacobian_row[0, EAST], jacobian_row[0, NORTH] = (
            1.0,
            *(-evaluation.ground_gradient),
        )
        jacobian.append(jacobian_row / sigma)
    if o.altitude_m is not None:
        residual.append(np.array([(x[ALTITUDE] - o.altitude_m) / o.altitude_sigma_m]))
        jacobian_row = np.zeros((1, problem.size))
        jacobian_row[0, ALTITUDE] = 1.0
        jacobian.append(jacobian_row / o.altitude_sigma_m)
    return np.concatenate(residual), np.vstack(jacobian)


def prior_nll(problem: Problem, x: Floats, evaluation: Evaluation, model: ErrorModel) -> float:
    """Half the sum of the squared normalised deviations from the priors."""
    residual, _ = prior_residuals(problem, x, evaluation, model.size_m)
    return 0.5 * float((residual**2).sum())
