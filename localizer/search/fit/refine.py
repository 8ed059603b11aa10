"""Sub-cell refinement: position together with everything that all columns share (errata, gap 8).

The observations are the contour's elevations; a robust least-squares fit (Gauss-Newton, damped, Geman-McClure weights) finds
the most probable values of what is unknown (`problem`) and their covariance. What the residuals are taken for (`noise`) is
estimated as it proceeds.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from localizer.search.fit.correlated_errors import (
    ErrorModel,
    NormalEquations,
    likely_error_models,
    normal_equations,
    whitened_nll,
)
from localizer.search.fit.noise import Noise, estimated_noise, possible_models
from localizer.search.fit.objective import (
    normalisation_term,
    ordered_columns,
    prior_nll,
    prior_residuals,
    visible_nll,
)
from localizer.search.fit.outliers import (
    column_nll,
    informative_columns,
    log_bayes_factor,
    occam_penalty,
    outlier_penalty,
    weights,
)
from localizer.search.fit.problem import (
    ALTITUDE,
    AZIMUTH_BIAS,
    EAST,
    FIRST_FRAME,
    NORTH,
    PER_FRAME,
    TILT_BIAS,
    Problem,
)
from localizer.search.fit.residuals import Evaluation, central_differences, evaluate, place_of, residual_sigma

Floats = NDArray[np.float64]

NOISE_UPDATES_AT = (2, 4, 6, 8, 10)
"""Iterations at which the noise is estimated anew."""
NOISE_UPDATES_WARM_AT = (2, 4)
"""The same for a fit that starts from another one's noise."""
LIKELIHOOD_FROM = 8
"""From this iteration on by its likelihood. Before, an error that reaches far would explain a place that is some way off."""
LEAST_DAMPING = 1e-6
MOST_DAMPING = 50.0
LEAST_GAIN_NATS = 2e-2
"""A step that lowers the cost by less ends the fit."""
PLACE_SHIFT_PER_M = 1.0
"""How far the place moves per metre of a DEM's smooth error, beyond what the fit tells."""
RESAMPLING_SHIFT_CELLS = 0.015
"""By so much of a cell the best place moves when the same cells are made into another surface."""


@dataclass(frozen=True)
class Refined:
    """A refined candidate.

    ``row``, ``col`` in lattice coordinates; ``covariance_enu_m2`` (2, 2) of true east and north; ``fit_cost`` the negative
    logarithm of the posterior but for a constant, under the error model that weighs the columns;
    ``evidence`` by how much (in logarithms) the terrain explains the contours better than chance does;
    ``misfit_per_column`` the mean of the columns' negative log-likelihood, which compares fits with different DEM errors;
    ``residual_px`` per label of a coefficients with columns that count, over those that fit.
    """

    row: float
    col: float
    altitude_m: float
    azimuth_bias_deg: float
    azimuth_bias_sigma_deg: float
    tilt_bias_deg: float
    frame_errors_deg: Floats
    covariance_enu_m2: Floats
    neg_log_posterior: float
    dem_error_m: float
    correlation_columns: float
    inlier_share: float
    prior_chi2: float
    residual_px: dict[str, float]
    mean_column_nll: float
    evidence: float
    error_model: ErrorModel

    @property
    def log_odds(self) -> float:
        """By how much (in logarithms) contours and readings together are likelier from here than from an unrelated place."""
        return self.evidence - 0.5 * self.prior_chi2

    def parameters(self) -> Floats:
        """The unknowns as ``Problem`` orders them, metres counted from the place itself."""
        return np.concatenate(
            [
                [0.0, 0.0, self.altitude_m, self.azimuth_bias_deg, self.tilt_bias_deg],
                self.frame_errors_deg.ravel(),
            ]
        )


def refine(
    problem: Problem,
    row: float,
    col: float,
    altitude_m: float,
    azimuth_bias_deg: float,
    *,
    iterations: int,
    noise: Noise,
    largest_dem_error_m: float,
    estimate_noise: bool,
    likelihood_from: int = LIKELIHOOD_FROM,
    sigma_factor: float = 1.0,
) -> Refined:
    """Fit from a cell to the sub-cell optimum near it.

    ``noise`` is what the residuals are taken for to begin with. With ``settle`` it is estimated from them as the fit proceeds,
    the DEM's error up to ``largest_dem_error_m``, from iteration ``likely_from`` on by its likelihood; else it is held.
    ``sigma_factor``: factor on the DEM's error that tells stray columns.
    """
    x = np.zeros(problem.size)
    x[ALTITUDE], x[AZIMUTH_BIAS] = altitude_m, azimuth_bias_deg
    origin = (row, col)
    coefficients = problem.terrain.geodesics.at(np.array([row]), np.array([col]))[0]
    damping = LEAST_DAMPING
    update_at = NOISE_UPDATES_AT if likelihood_from else NOISE_UPDATES_WARM_AT
    to_convergence = iterations > LIKELIHOOD_FROM
    evaluation = evaluate(problem, x, origin, coefficients)
    for iteration in range(iterations):
        if estimate_noise and iteration in update_at:
            noise = estimated_noise(
                problem, x, evaluation, noise, largest_dem_error_m, iteration >= likelihood_from
            )
        sigma = residual_sigma(problem, evaluation, sigma_factor * noise.robust_sigma_m)
        weight = weights(informative_columns(evaluation, sigma), evaluation.residual / sigma)
        robust = iteration >= likelihood_from or not estimate_noise
        gain = 0.0
        for by_differences in (False, True):
            if by_differences:
                # Where the horizon leaps from ridge to ridge the tangent misleads.
                evaluation.jacobian[:, :AZIMUTH_BIAS] = central_differences(
                    problem, x, origin, coefficients, evaluation.guess_m
                )
                damping = LEAST_DAMPING
            columns = ordered_columns(problem, x, evaluation, noise.model, weight)
            normal = normal_equations(columns, noise.model, robust=robust)
            nll = normal.nll + prior_nll(problem, x, evaluation, noise.model)
            while damping < MOST_DAMPING:
                damped = normal.hessian + damping * np.diag(np.diag(normal.hessian))
                step = -np.linalg.solve(damped, normal.gradient)
                far = float(np.hypot(step[EAST], step[NORTH])) / (1.5 * problem.terrain.cell_m)
                trial_x = x + step / max(1.0, far)
                trial_evaluation = evaluate(problem, trial_x, origin, coefficients, evaluation.guess_m)
                columns = ordered_columns(problem, trial_x, trial_evaluation, noise.model, weight)
                gain = (
                    nll
                    - whitened_nll(columns, noise.model, robust=robust)
                    - prior_nll(problem, trial_x, trial_evaluation, noise.model)
                )
                if gain > 0.0:
                    break
                damping *= 8.0
            if gain > LEAST_GAIN_NATS or not to_convergence or (estimate_noise and iteration < update_at[-1]):
                break
        if gain > 0.0:
            x, evaluation = trial_x, trial_evaluation
        damping = max(damping * 0.1, LEAST_DAMPING) if damping < MOST_DAMPING else LEAST_DAMPING
        if gain < LEAST_GAIN_NATS and not (estimate_noise and to_convergence and iteration < update_at[-1]):
            break
    if estimate_noise:
        noise = estimated_noise(problem, x, evaluation, noise, largest_dem_error_m, to_convergence)
    return _result(
        problem,
        x,
        evaluation,
        noise,
        origin,
        coefficients,
        largest_dem_error_m if estimate_noise and to_convergence else None,
    )


def _result(
    problem: Problem,
    x: Floats,
    evaluation: Evaluation,
    noise: Noise,
    origin: tuple[float, float],
    coefficients: Floats,
    largest_dem_error_m: float | None,
) -> Refined:
    sigma = residual_sigma(problem, evaluation, noise.robust_sigma_m)
    normalised, informative = evaluation.residual / sigma, informative_columns(evaluation, sigma)
    columns = ordered_columns(problem, x, evaluation, noise.model, weights(informative, normalised))
    if largest_dem_error_m is None:
        normal = normal_equations(columns, noise.model)
        covariance = np.asarray(np.linalg.inv(normal.hessian), np.float64)
    else:
        covariance = _averaged_covariance(
            likely_error_models(columns, noise.model, possible_models(problem, largest_dem_error_m))
        )
    prior_residual, _ = prior_residuals(problem, x, evaluation, noise.model.size_m)
    neg_log_posterior = (
        visible_nll(problem, x, evaluation, noise.model, sigma, whitened_nll(columns, noise.model))
        + prior_nll(problem, x, evaluation, noise.model)
        + outlier_penalty(problem, evaluation, sigma)
        + normalisation_term(problem, x, evaluation, noise.model)
    )
    per_column_nll = column_nll(evaluation, sigma) + np.log(sigma)
    row, col = place_of(x, origin, coefficients)
    inliers = informative & (np.abs(normalised) < 3.0)
    residual_px = {}
    for i, contour in enumerate(problem.contours):
        mine = problem.frame_of == i
        if not mine.any():
            continue
        fy = contour.frame.camera.fy_px
        kept = mine & inliers
        chosen = kept if kept.any() else mine
        residual_px[contour.frame.label] = float(np.sqrt(np.mean((evaluation.residual[chosen] * fy) ** 2)))
    return Refined(
        row=row,
        col=col,
        altitude_m=float(x[ALTITUDE]),
        azimuth_bias_deg=float(x[AZIMUTH_BIAS]),
        azimuth_bias_sigma_deg=float(np.sqrt(covariance[AZIMUTH_BIAS, AZIMUTH_BIAS])),
        tilt_bias_deg=float(x[TILT_BIAS]),
        frame_errors_deg=x[FIRST_FRAME:].reshape(-1, PER_FRAME),
        covariance_enu_m2=covariance[:2, :2] + np.eye(2) * _shift_sigma_m(problem, noise.model) ** 2,
        neg_log_posterior=neg_log_posterior,
        dem_error_m=noise.robust_sigma_m,
        correlation_columns=noise.correlation_columns,
        inlier_share=float(inliers.sum() / max(informative.sum(), 1)),
        prior_chi2=float((prior_residual**2).sum()),
        residual_px=residual_px,
        mean_column_nll=float(per_column_nll.mean()),
        evidence=log_bayes_factor(
            problem, evaluation, sigma, residual_sigma(problem, evaluation, 0.0), noise.correlation_columns
        )
        - occam_penalty(problem, covariance),
        error_model=noise.model,
    )


def _shift_sigma_m(problem: Problem, model: ErrorModel) -> float:
    """By how much a DEM's errors shift the best place beyond what the linearised fit says: one sigma in each direction.

    A smooth error tilts all that is near, the ground under the camera too.
    """
    if problem.terrain.exact:
        return 0.0
    return float(
        np.hypot(RESAMPLING_SHIFT_CELLS * problem.terrain.cell_m, PLACE_SHIFT_PER_M * model.smooth_m)
    )


def _averaged_covariance(models: list[tuple[ErrorModel, NormalEquations]]) -> Floats:
    """Of the parameters, over the models that the residuals leave possible: the fit moves with the model, too."""
    evidence = np.array([normal.log_evidence for _, normal in models])
    share = np.exp(evidence - evidence.max())
    share /= share.sum()
    covariance = np.array([np.linalg.inv(normal.hessian) for _, normal in models])
    shift = np.array([-c @ normal.gradient for c, (_, normal) in zip(covariance, models, strict=True)])
    shift -= share @ shift
    return np.asarray(np.einsum("m,mij->ij", share, covariance) + (share[:, None] * shift).T @ shift)
