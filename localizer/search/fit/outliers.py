"""Outliers, occlusion and evidence: which columns count, with which weight, and how well they support a place.

Columns are weighted by the Geman-McClure M-estimator: with u = (r / sigma)^2 and the scale c,

    loss = 0.5 u / (1 + u / c^2),    weight = 1 / (1 + u / c^2)^2.

The evidence of a place is the logarithm of the Bayes factor of this place against an unrelated one (``log_bayes_factor``), less
the Occam factor of the angles that the sensors leave free (``occam_penalty``).
"""

import numpy as np
from numpy.typing import NDArray

from localizer.search.fit.problem import SECTOR_RAD, TILT_BIAS, Problem
from localizer.search.fit.residuals import Evaluation
from localizer.search.stage2 import GEMAN_MCCLURE_SIGMAS

Floats = NDArray[np.float64]

UNRELATED_SKYLINE_RAD = np.radians(3.0)
"""Standard deviation of the residuals at an unrelated place: the null model of the Bayes factor. Tuned on the simulated cases
of ``sim evaluate``. Sensitivity: halved, 2 of 5 statuses change, places move by 0.1 sigma; doubled, places move by 0.4 sigma,
sigmas change by the factor 1.2 (docs/sensitivity.md)."""
RESOLVED_SIGMAS = 3.0
"""A column resolves two heights that differ by so many of its standard deviations. Tuned on the scenario ``dem_error``.
Sensitivity: halved, places move by 0.1 sigma; doubled, places move by 0.5 sigma (docs/sensitivity.md)."""
OUTLIER_STRETCH_RAD = np.radians(15.0)
"""Length of horizon that one cloud or tree occludes: outliers come in such stretches. Tuned on the simulated cases of
``sim evaluate``. Sensitivity: halved, no change; doubled, sigmas change by the factor 1.5 (docs/sensitivity.md)."""
MEDIAN_VARIANCE_RATIO = 0.5 * np.pi
"""Variance of the median over that of the mean, for Gaussian errors."""
OUTLIER_SHARE = 0.1
"""Prior probability that a sector shows something else than terrain. Tuned on the simulated cases of ``sim evaluate``.
Sensitivity: halved, 1 of 5 statuses changes; doubled, no change (docs/sensitivity.md)."""


def informative_columns(evaluation: Evaluation, sigma: Floats) -> NDArray[np.bool_]:
    """Mask (n,) of the informative columns: not occluded, not at the DEM edge, not undetermined."""
    return np.asarray(visible_columns(evaluation, sigma) & ~_undetermined(evaluation, sigma))


def visible_columns(evaluation: Evaluation, sigma: Floats) -> NDArray[np.bool_]:
    """Mask (n,) of the columns that show terrain of the DEM, undetermined ones included."""
    return np.asarray(~_occluded(evaluation, sigma) & ~evaluation.dem_edge)


def visible_residual(evaluation: Evaluation, sigma: Floats) -> Floats:
    """Residuals (n,) in radians.

    Those of undetermined columns refer to the horizon or to near terrain, whichever fits better.
    """
    by_near = evaluation.residual - evaluation.near_excess
    nearer = _undetermined(evaluation, sigma) & (np.abs(by_near) < np.abs(evaluation.residual))
    return np.where(nearer, by_near, evaluation.residual)


def column_nll(evaluation: Evaluation, sigma: Floats) -> Floats:
    """Negative log-likelihood of each column (n,), relative to an exact fit.

    A visible column has its Geman-McClure loss, an occluded one a constant, ln(UNRELATED_SKYLINE_RAD / sigma). A column at the
    DEM edge has the smaller of both, so that a place near the edge has no disadvantage.
    """
    residual_nll = geman_mcclure(visible_residual(evaluation, sigma) / sigma)
    occluded_nll = np.log(UNRELATED_SKYLINE_RAD / sigma)
    at_dem_edge = np.where(_occluded(evaluation, sigma), occluded_nll, np.minimum(residual_nll, occluded_nll))
    return np.asarray(
        np.where(
            visible_columns(evaluation, sigma),
            residual_nll,
            np.where(evaluation.dem_edge, at_dem_edge, occluded_nll),
        )
    )


def _occluded(evaluation: Evaluation, sigma: Floats) -> NDArray[np.bool_]:
    """Mask (n,): near terrain probably occludes the horizon, since something significantly higher than the horizon is seen."""
    higher_seen = evaluation.near & (evaluation.residual > 0.0)
    return np.asarray(
        higher_seen & (geman_mcclure(evaluation.residual / sigma) >= np.log(UNRELATED_SKYLINE_RAD / sigma))
    )


def _undetermined(evaluation: Evaluation, sigma: Floats) -> NDArray[np.bool_]:
    """Mask (n,): near terrain exceeds the horizon by less than a column resolves, so that either may be seen.

    Using only the columns that are not too high would select the lower half of the noise and bias the place.
    """
    return np.asarray(
        evaluation.near
        & (evaluation.near_excess < RESOLVED_SIGMAS * sigma)
        & (evaluation.residual > -RESOLVED_SIGMAS * sigma)
    )


def weights(informative: NDArray[np.bool_], normalised: Floats) -> Floats:
    """Geman-McClure weights (n,): 1 for a column that fits, near 0 for an outlier, 0 for one that is not informative."""
    return np.asarray(informative / (1.0 + (normalised / GEMAN_MCCLURE_SIGMAS) ** 2) ** 2)


def geman_mcclure(normalised: Floats) -> Floats:
    """Geman-McClure loss (n,) of normalised residuals."""
    squared = normalised**2
    return np.asarray(0.5 * squared / (1.0 + squared / GEMAN_MCCLURE_SIGMAS**2))


def outlier_penalty(problem: Problem, evaluation: Evaluation, sigma: Floats) -> float:
    """Negative log-likelihood of outliers and occluded columns that the weighted sum of squares lacks.

    They come in stretches of about OUTLIER_STRETCH_RAD, each of which counts as one event.
    """
    normalised = visible_residual(evaluation, sigma) / sigma
    weighted = 0.5 * normalised**2 * weights(visible_columns(evaluation, sigma), normalised)
    excess = column_nll(evaluation, sigma) - weighted
    return float(excess.sum() / (problem.sector_columns * OUTLIER_STRETCH_RAD / SECTOR_RAD))


def occam_penalty(problem: Problem, covariance: Floats) -> float:
    """Occam factor of a Bayesian model comparison, for angles that the sensors leave free: sum of ln(prior sigma / posterior
    sigma).

    A frame with a free attitude fits many skylines; its evidence is reduced accordingly. The heading bias that all frames
    share is left out: without a compass it is equally free at every place. ``covariance``: of the unknowns.
    """
    prior_deg = problem.prior_sigma_deg[TILT_BIAS:]
    posterior_deg = np.sqrt(np.diag(covariance)[TILT_BIAS:])
    free = np.isfinite(prior_deg) & (prior_deg > np.degrees(UNRELATED_SKYLINE_RAD))
    return float(np.log(np.maximum(prior_deg[free] / posterior_deg[free], 1.0)).sum())


def log_bayes_factor(
    problem: Problem, evaluation: Evaluation, sigma: Floats, white: Floats, correlation_columns: float
) -> float:
    """Logarithm of the Bayes factor of the contours at this place against an unrelated one.

    At an unrelated place the residuals are about UNRELATED_SKYLINE_RAD, and nearly constant over a sector. Each sector
    therefore is one sample of n_eff independent columns, whose median m and scale (both normalised) must fit:

        ln B = sum over sectors of  w ln( (1 - p) (UNRELATED_SKYLINE_RAD / s) exp(-0.5 max(|m|, scale)^2) + p ),

    with p = OUTLIER_SHARE, w the share of the sector that is informative, and s the standard deviation of its median. Of the
    columns' ``sigma`` (n,) the part ``white`` (n,) averages out over n_eff, the DEM error does not. n_eff is the number of
    columns divided by ``correlation_columns``. An outlier sector contributes ln p at least.
    """
    normalised, informative = evaluation.residual / sigma, informative_columns(evaluation, sigma)
    total = 0.0
    for block in problem.sectors:
        used = block[informative[block]]
        if len(used) == 0:
            continue
        effective_size = max(1.0, len(used) / max(1.0, correlation_columns))
        shared = np.sqrt(
            1.0 - (white[used] / sigma[used]) ** 2 * (1.0 - min(1.0, MEDIAN_VARIANCE_RATIO / effective_size))
        )
        median = float(np.median(normalised[used] / shared))
        size = float(np.median(np.abs(normalised[used]))) / 0.6745
        off = max(abs(median), size)
        ratio = UNRELATED_SKYLINE_RAD / np.exp(np.log(sigma[used] * shared).mean()) * np.exp(-0.5 * off**2)
        total += (
            len(used) / problem.sector_columns * float(np.log((1.0 - OUTLIER_SHARE) * ratio + OUTLIER_SHARE))
        )
    return total
