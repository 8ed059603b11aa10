"""Sub-cell refinement: Gauss-Newton with Levenberg-Marquardt damping, Geman-McClure weights, estimated noise (errata, gap 8).

Each iteration solves (H + lambda diag H) dx = -g for the unknowns of ``problem``, with H and g of the whitened, reweighted
residuals, and accepts the step if the negative log-likelihood falls. The noise is re-estimated at certain iterations. The
covariance is that of the Laplace approximation, averaged over the error models that remain plausible (Bayesian model
averaging).
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
"""Iterations at which the noise is estimated."""
NOISE_UPDATES_WARM_AT = (2, 4)
"""The same for a fit that starts with the noise of another one (warm start)."""
LIKELIHOOD_FROM = 8
"""From this iteration on the noise is estimated by marginal likelihood. Earlier, a smooth DEM error could explain the
residuals of a place far from the optimum. Tuned on the scenario ``dem_error``. Sensitivity: not measured yet (``sim
sensitivity``)."""
LEAST_DAMPING = 1e-6
MOST_DAMPING = 50.0
"""Range of the damping lambda."""
LEAST_GAIN_NATS = 2e-2
"""A step that lowers the negative log-posterior by less ends the fit. Tuned on time and on the scenario ``dem_error``.
Sensitivity: not measured yet (``sim sensitivity``)."""
PLACE_SHIFT_PER_M = 1.0
"""Standard deviation of the place per metre of smooth DEM error, beyond the linearised covariance. Tuned on the scenario
``dem_error``. Sensitivity: halved or doubled, no change (docs/sensitivity.md)."""
RESAMPLING_SHIFT_CELLS = 0.015
"""Standard deviation of the place, in cells, when the same cells are interpolated by another surface. Tuned on the simulated
cases of ``sim evaluate``, whose terrain is triangulated. Sensitivity: halved or doubled, no change (docs/sensitivity.md)."""


@dataclass(frozen=True)
class Refined:
    """A refined place.

    ``row``, ``col`` in lattice coordinates; ``covariance_enu_m2`` (2, 2) of true east and north. ``neg_log_posterior``: up to a
    constant, under the fit's own error model. ``evidence``: log Bayes factor against an unrelated place.
    ``mean_column_nll``: mean negative log-likelihood of a column, comparable between fits with different DEM errors.
    ``residual_px``: RMS residual of the inliers, by the label of each frame that has columns.
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
        """Evidence together with the readings: log Bayes factor of contours and sensors against an unrelated place."""
        return self.evidence - 0.5 * self.prior_chi2

    def parameters(self) -> Floats:
        """The unknowns in the order of ``Problem``, with the place itself as origin."""
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
    """Fit from a starting place to the local optimum near it.

    ``noise``: the initial noise. With ``estimate_noise`` it is re-estimated during the fit, with a DEM error of at most
    ``largest_dem_error_m``, from iteration ``likelihood_from`` on by marginal likelihood; otherwise it is fixed.
    ``sigma_factor``: factor on the DEM error where outliers are identified; below 1 more columns are outliers.
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
                # The horizon may jump from one ridge to another, where the analytic derivative is not representative.
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
    """Standard deviation of the place by DEM errors, per direction, beyond the linearised covariance.

    A smooth error tilts the near terrain and the ground under the camera together.
    """
    if problem.terrain.exact:
        return 0.0
    return float(
        np.hypot(RESAMPLING_SHIFT_CELLS * problem.terrain.cell_m, PLACE_SHIFT_PER_M * model.smooth_m)
    )


def _averaged_covariance(models: list[tuple[ErrorModel, NormalEquations]]) -> Floats:
    """Covariance of the parameters averaged over error models by their evidence, with the spread of their optima (law of total
    variance).
    """
    evidence = np.array([normal.log_evidence for _, normal in models])
    share = np.exp(evidence - evidence.max())
    share /= share.sum()
    covariance = np.array([np.linalg.inv(normal.hessian) for _, normal in models])
    shift = np.array([-c @ normal.gradient for c, (_, normal) in zip(covariance, models, strict=True)])
    shift -= share @ shift
    return np.asarray(np.einsum("m,mij->ij", share, covariance) + (share[:, None] * shift).T @ shift)
