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
    Normal,
    likely_models,
    normal_equations,
    whitened_cost,
)
from localizer.search.fit.noise import Noise, estimated_noise, possible_models
from localizer.search.fit.objective import (
    columns_along,
    expected_scale,
    prior_cost,
    prior_misfits,
    visible_cost,
)
from localizer.search.fit.outliers import (
    evidence_over_chance,
    evidence_used_up,
    stray_loss,
    surprise,
    telling_columns,
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
from localizer.search.fit.residuals import Evaluation, evaluate, place_of, residual_sigma, secants

Floats = NDArray[np.float64]

SETTLE_AT = (2, 4, 6, 8, 10)
"""Iterations at which the noise is estimated anew."""
SETTLE_AGAIN_AT = (2, 4)
"""The same for a fit that starts from another one's noise."""
LIKELY_FROM = 8
"""From this iteration on by its likelihood. Before, an error that reaches far would explain a place that is some way off."""
LEAST_DAMPING, MOST_DAMPING = 1e-6, 50.0
ENOUGH_GAIN = 2e-2
"""A step that lowers the cost by less ends the fit."""
SHIFT_PER_M = 1.0
"""How far the place moves per metre of a DEM's smooth error, beyond what the fit tells."""
LATTICE_SHARE = 0.015
"""By so much of a cell the best place moves when the same cells are made into another surface."""


@dataclass(frozen=True)
class Refined:
    """A refined candidate.

    ``row``, ``col`` in lattice coordinates; ``covariance_enu_m2`` (2, 2) of true east and north; ``fit_cost`` the negative
    logarithm of the posterior but for a constant, under the error model that weighs the columns;
    ``evidence`` by how much (in logarithms) the terrain explains the contours better than chance does;
    ``misfit_per_column`` the mean of the columns' negative log-likelihood, which compares fits with different DEM errors;
    ``residual_px`` per label of a frame with columns that count, over those that fit.
    """

    row: float
    col: float
    altitude_m: float
    azimuth_bias_deg: float
    azimuth_bias_sigma_deg: float
    tilt_bias_deg: float
    frame_errors_deg: Floats
    covariance_enu_m2: Floats
    fit_cost: float
    dem_error_m: float
    correlation_columns: float
    inlier_share: float
    prior_chi2: float
    residual_px: dict[str, float]
    misfit_per_column: float
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
    settle: bool,
    likely_from: int = LIKELY_FROM,
    strict: float = 1.0,
) -> Refined:
    """Fit from a cell to the sub-cell optimum near it.

    ``noise`` is what the residuals are taken for to begin with. With ``settle`` it is estimated from them as the fit proceeds,
    the DEM's error up to ``largest_dem_error_m``, from iteration ``likely_from`` on by its likelihood; else it is held.
    ``strict``: factor on the DEM's error that tells stray columns.
    """
    x = np.zeros(problem.size)
    x[ALTITUDE], x[AZIMUTH_BIAS] = altitude_m, azimuth_bias_deg
    origin = (row, col)
    frame = problem.terrain.frames.at(np.array([row]), np.array([col]))[0]
    damping = LEAST_DAMPING
    settle_at = SETTLE_AT if likely_from else SETTLE_AGAIN_AT
    thorough = iterations > LIKELY_FROM
    here = evaluate(problem, x, origin, frame)
    for iteration in range(iterations):
        if settle and iteration in settle_at:
            noise = estimated_noise(problem, x, here, noise, largest_dem_error_m, iteration >= likely_from)
        sigma = residual_sigma(problem, here, strict * noise.spread_m)
        weight = weights(telling_columns(here, sigma), here.residual / sigma)
        forgiving = iteration >= likely_from or not settle
        gain = 0.0
        for by_secants in (False, True):
            if by_secants:
                # Where the horizon leaps from ridge to ridge the tangent misleads.
                here.jacobian[:, :AZIMUTH_BIAS] = secants(problem, x, origin, frame, here.guess_m)
                damping = LEAST_DAMPING
            columns = columns_along(problem, x, here, noise.model, weight)
            normal = normal_equations(columns, noise.model, forgiving=forgiving)
            cost = normal.cost + prior_cost(problem, x, here, noise.model)
            while damping < MOST_DAMPING:
                damped = normal.curvature + damping * np.diag(np.diag(normal.curvature))
                step = -np.linalg.solve(damped, normal.slope)
                far = float(np.hypot(step[EAST], step[NORTH])) / (1.5 * problem.terrain.cell_m)
                trial = x + step / max(1.0, far)
                there = evaluate(problem, trial, origin, frame, here.guess_m)
                columns = columns_along(problem, trial, there, noise.model, weight)
                gain = (
                    cost
                    - whitened_cost(columns, noise.model, forgiving=forgiving)
                    - prior_cost(problem, trial, there, noise.model)
                )
                if gain > 0.0:
                    break
                damping *= 8.0
            if gain > ENOUGH_GAIN or not thorough or (settle and iteration < settle_at[-1]):
                break
        if gain > 0.0:
            x, here = trial, there
        damping = max(damping * 0.1, LEAST_DAMPING) if damping < MOST_DAMPING else LEAST_DAMPING
        if gain < ENOUGH_GAIN and not (settle and thorough and iteration < settle_at[-1]):
            break
    if settle:
        noise = estimated_noise(problem, x, here, noise, largest_dem_error_m, thorough)
    return _result(
        problem, x, here, noise, origin, frame, largest_dem_error_m if settle and thorough else None
    )


def _result(
    problem: Problem,
    x: Floats,
    here: Evaluation,
    noise: Noise,
    origin: tuple[float, float],
    frame: Floats,
    largest_dem_error_m: float | None,
) -> Refined:
    sigma = residual_sigma(problem, here, noise.spread_m)
    normalised, telling = here.residual / sigma, telling_columns(here, sigma)
    columns = columns_along(problem, x, here, noise.model, weights(telling, normalised))
    if largest_dem_error_m is None:
        normal = normal_equations(columns, noise.model)
        covariance = np.asarray(np.linalg.inv(normal.curvature), np.float64)
    else:
        covariance = _averaged_covariance(
            likely_models(columns, noise.model, possible_models(problem, largest_dem_error_m))
        )
    misfit, _ = prior_misfits(problem, x, here, noise.model.size_m)
    fit_cost = (
        visible_cost(problem, x, here, noise.model, sigma, whitened_cost(columns, noise.model))
        + prior_cost(problem, x, here, noise.model)
        + stray_loss(problem, here, sigma)
        + expected_scale(problem, x, here, noise.model)
    )
    surprises = surprise(here, sigma) + np.log(sigma)
    row, col = place_of(x, origin, frame)
    inside = telling & (np.abs(normalised) < 3.0)
    residual_px = {}
    for i, contour in enumerate(problem.contours):
        mine = problem.frame_of == i
        if not mine.any():
            continue
        fy = contour.frame.camera.fy_px
        kept = mine & inside
        chosen = kept if kept.any() else mine
        residual_px[contour.frame.label] = float(np.sqrt(np.mean((here.residual[chosen] * fy) ** 2)))
    return Refined(
        row=row,
        col=col,
        altitude_m=float(x[ALTITUDE]),
        azimuth_bias_deg=float(x[AZIMUTH_BIAS]),
        azimuth_bias_sigma_deg=float(np.sqrt(covariance[AZIMUTH_BIAS, AZIMUTH_BIAS])),
        tilt_bias_deg=float(x[TILT_BIAS]),
        frame_errors_deg=x[FIRST_FRAME:].reshape(-1, PER_FRAME),
        covariance_enu_m2=covariance[:2, :2] + np.eye(2) * _shift_sigma_m(problem, noise.model) ** 2,
        fit_cost=fit_cost,
        dem_error_m=noise.spread_m,
        correlation_columns=noise.correlation_columns,
        inlier_share=float(inside.sum() / max(telling.sum(), 1)),
        prior_chi2=float((misfit**2).sum()),
        residual_px=residual_px,
        misfit_per_column=float(surprises.mean()),
        evidence=evidence_over_chance(
            problem, here, sigma, residual_sigma(problem, here, 0.0), noise.correlation_columns
        )
        - evidence_used_up(problem, covariance),
        error_model=noise.model,
    )


def _shift_sigma_m(problem: Problem, model: ErrorModel) -> float:
    """By how much a DEM's errors shift the best place beyond what the linearised fit says: one sigma in each direction.

    A smooth error tilts all that is near, the ground under the camera too.
    """
    if problem.terrain.exact:
        return 0.0
    return float(np.hypot(LATTICE_SHARE * problem.terrain.cell_m, SHIFT_PER_M * model.smooth_m))


def _averaged_covariance(models: list[tuple[ErrorModel, Normal]]) -> Floats:
    """Of the parameters, over the models that the residuals leave possible: the fit moves with the model, too."""
    evidence = np.array([normal.log_evidence for _, normal in models])
    share = np.exp(evidence - evidence.max())
    share /= share.sum()
    covariance = np.array([np.linalg.inv(normal.curvature) for _, normal in models])
    shift = np.array([-c @ normal.slope for c, (_, normal) in zip(covariance, models, strict=True)])
    shift -= share @ shift
    return np.asarray(np.einsum("m,mij->ij", share, covariance) + (share[:, None] * shift).T @ shift)
