"""What the residuals are made of, estimated from themselves.

A column's uncertainty is its own sigma in the image and the DEM's error seen from afar, which neighbouring columns share
(`error_model`). How large that error is, is estimated from the residuals: robustly at first, from their median, to tell stray
columns from others; then by its likelihood, together with how far it reaches along the ground.
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
LEAST_SMOOTH_M = 0.05
LEAST_ROUGH_SHARE = 0.15
"""No DEM is better than this, in terms of what the ground does between its cells."""
INITIAL_LENGTH_CELLS = 8.0
"""How far a DEM's error is taken to reach along the ground until its likelihood tells: hardly, so that all columns count."""
LEAST_AUTOCORRELATION = 0.05
"""Where the correlation has fallen to this it is lost in its own noise."""


@dataclass(frozen=True)
class Noise:
    """What the residuals are made of.

    ``spread_m`` is the DEM's error for which the median residual is what it should be, ``correlation_columns`` how many
    neighbouring columns are worth one independent one: they tell stray columns and chance. ``model`` weighs the columns.
    """

    robust_sigma_m: float
    correlation_columns: float
    model: ErrorModel


def initial_noise(terrain: Terrain, dem_error_m: float) -> Noise:
    """What the residuals are taken for before there are any."""
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
    """The noise by the residuals at a place, given what it was taken for ``before``."""
    informative = informative_columns(
        evaluation, residual_sigma(problem, evaluation, previous.robust_sigma_m)
    )
    robust_sigma_m = _robust_dem_error_m(problem, evaluation, informative, largest_dem_error_m)
    normalised = evaluation.residual / residual_sigma(problem, evaluation, robust_sigma_m)
    limits = possible_models(problem, largest_dem_error_m)
    if not by_likelihood:
        # All of it taken for rough, so that no stretch of the horizon is explained away.
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
    """The error models among which the residuals decide."""
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
    """The DEM's error for which the median residual is what a Gaussian's is (0.6745 sigma)."""
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
    """How many columns are worth one: one plus twice the sum of the correlations along the contours, 1 for white noise."""
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
