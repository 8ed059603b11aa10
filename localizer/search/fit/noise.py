"""Estimation of the noise from the residuals (empirical Bayes).

The variance of a column is that of the contour, which is given, and that of the DEM error, which is estimated here: at first
robustly from the median absolute residual (MAD = 0.6745 sigma), to identify outliers; later by maximum marginal likelihood,
together with its correlation length (``correlated_errors``).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from localizer.dem.horizon import Terrain
from localizer.search.fit.correlated_errors import ErrorModel, ModelRange, likely_error_models
from localizer.search.fit.objective import ordered_columns
from localizer.search.fit.outliers import informative_columns, weights
from localizer.search.fit.problem import Problem
from localizer.search.fit.residuals import INTERPOLATION_ERROR_SHARE, Evaluation, residual_sigma

Floats = NDArray[np.float64]

LEAST_DEM_ERROR_M = 0.1
"""Least robust estimate of the DEM error. Tuned on the simulated cases of ``sim evaluate``. Sensitivity: not measured yet
(``sim sensitivity``)."""
LEAST_SMOOTH_M = 0.05
"""Least smooth DEM error. Tuned on the simulated cases of ``sim evaluate``. Sensitivity: not measured yet (``sim
sensitivity``)."""
LEAST_ROUGH_SHARE = 0.15
"""Least rough DEM error, as a share of the interpolation error between the cells. Tuned on the scenario ``dem_error``.
Sensitivity: halved, places move by 0.3 sigma, sigmas change by the factor 1.5; doubled, 1 of 5 statuses changes, places move
by 0.4 sigma, sigmas change by the factor 0.7 (docs/sensitivity.md)."""
INITIAL_LENGTH_CELLS = 8.0
"""Correlation length until it is estimated: short, so that all columns count. Tuned on the scenario ``dem_error``.
Sensitivity: halved, places move by 0.4 sigma, sigmas change by the factor 1.1; doubled, places move by 0.3 sigma
(docs/sensitivity.md)."""
LEAST_AUTOCORRELATION = 0.05
"""The sum of the autocorrelations is cut off where they fall below this. Tuned on the simulated cases of ``sim evaluate``.
Sensitivity: halved or doubled, no change (docs/sensitivity.md)."""


@dataclass(frozen=True)
class Noise:
    """The noise of the residuals.

    ``robust_sigma_m``: DEM error by the median absolute residual; it identifies outliers. ``correlation_columns``: columns per
    effective sample, for the evidence. ``model``: covariance model that whitens the residuals.
    """

    robust_sigma_m: float
    correlation_columns: float
    model: ErrorModel


def initial_noise(terrain: Terrain, dem_error_m: float) -> Noise:
    """The noise before there are residuals to estimate it from."""
    return Noise(
        dem_error_m,
        1.0,
        ErrorModel(
            dem_error_m, min(LEAST_SMOOTH_M, terrain.nominal_error_m), INITIAL_LENGTH_CELLS * terrain.cell_m
        ),
    )


def estimated_noise(
    problem: Problem,
    x: Floats,
    evaluation: Evaluation,
    previous: Noise,
    largest_dem_error_m: float,
    by_likelihood: bool,
) -> Noise:
    """The noise estimated from the residuals at a place; ``previous``: the estimate that they were weighted with."""
    informative = informative_columns(
        evaluation, residual_sigma(problem, evaluation, previous.robust_sigma_m)
    )
    robust_sigma_m = _robust_dem_error_m(problem, evaluation, informative, largest_dem_error_m)
    normalised = evaluation.residual / residual_sigma(problem, evaluation, robust_sigma_m)
    limits = possible_models(problem, largest_dem_error_m)
    if not by_likelihood:
        # All of it counts as rough, so that a smooth error cannot absorb the residuals of a whole sector.
        length_m = INITIAL_LENGTH_CELLS * problem.terrain.cell_m
        model = ErrorModel(max(robust_sigma_m, limits.least_rough_m), limits.least_smooth_m, length_m)
    else:
        columns = ordered_columns(problem, x, evaluation, previous.model, weights(informative, normalised))
        start = ErrorModel(
            max(0.5 * previous.model.rough_m, limits.least_rough_m),
            max(previous.model.smooth_m, 0.5 * robust_sigma_m, limits.least_smooth_m),
            previous.model.length_m,
        )
        model = likely_error_models(columns, start, limits)[0][0]
    return Noise(robust_sigma_m, _autocorrelation_columns(problem, informative, normalised), model)


def possible_models(problem: Problem, largest_dem_error_m: float) -> ModelRange:
    """The range of error models to choose from."""
    terrain, usual_m = problem.terrain, problem.nominal_error_m
    between_m = (
        0.0
        if terrain.exact
        else LEAST_ROUGH_SHARE * INTERPOLATION_ERROR_SHARE * terrain.mean_second_difference_m
    )
    return ModelRange(
        cell_m=terrain.cell_m,
        least_rough_m=min(between_m + 0.01, usual_m),
        least_smooth_m=min(LEAST_SMOOTH_M, usual_m),
        largest_m=largest_dem_error_m,
    )


def _robust_dem_error_m(
    problem: Problem, evaluation: Evaluation, informative: NDArray[np.bool_], largest: float
) -> float:
    """DEM error for which the median absolute normalised residual is 0.6745, as of a Gaussian; by bisection."""
    if not informative.any():
        return largest
    size = np.abs(evaluation.residual[informative])
    low, high = min(LEAST_DEM_ERROR_M, problem.nominal_error_m), largest
    if np.median(size / residual_sigma(problem, evaluation, low)[informative]) <= 0.6745:
        return low
    for _ in range(30):
        middle = np.sqrt(low * high)
        if np.median(size / residual_sigma(problem, evaluation, middle)[informative]) > 0.6745:
            low = middle
        else:
            high = middle
    return float(high)


def _autocorrelation_columns(problem: Problem, informative: NDArray[np.bool_], normalised: Floats) -> float:
    """Columns per effective sample: 1 + 2 (sum of the autocorrelations along the contours); 1 for white noise."""
    value = normalised * np.sqrt(weights(informative, normalised))
    frames = [value[problem.frame_of == i] for i in range(len(problem.contours))]
    power = max(float((value**2).mean()), 1e-12)
    total = 1.0
    for lag in range(1, max(len(v) for v in frames) // 3):
        products = np.concatenate([v[lag:] * v[:-lag] for v in frames if len(v) > lag])
        rho = float(products.mean()) / power
        if rho < LEAST_AUTOCORRELATION:
            break
        total += 2.0 * rho
    return total
