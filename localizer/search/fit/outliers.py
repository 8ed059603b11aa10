"""Which columns speak for or against a place, and how much: stray and hidden ones little, or not at all."""

import numpy as np
from numpy.typing import NDArray

from localizer.search.fit.problem import SECTOR_RAD, TILT_BIAS, Problem
from localizer.search.fit.residuals import Evaluation
from localizer.search.stage2 import GEMAN_MCCLURE_SIGMAS

Floats = NDArray[np.float64]

UNRELATED_SKYLINE_RAD = np.radians(3.0)
"""By how much skylines of unrelated places differ."""
RESOLVED_SIGMAS = 3.0
"""What is seen in a column tells two heights apart that differ by as many of its standard deviations."""
OUTLIER_STRETCH_RAD = np.radians(15.0)
"""How much of the horizon a cloud or a tree hides."""
MEDIAN_VARIANCE_RATIO = 0.5 * np.pi
"""Of a median, in terms of the mean's, for Gaussian errors."""
OUTLIER_SHARE = 0.1
"""Stretches that show something else than the terrain's skyline, to be expected anywhere."""


def informative_columns(evaluation: Evaluation, sigma: Floats) -> NDArray[np.bool_]:
    """Columns (n,) that show what the DEM knows: neither hidden nor undecided."""
    return np.asarray(visible_columns(evaluation, sigma) & ~_undetermined(evaluation, sigma))


def visible_columns(evaluation: Evaluation, sigma: Floats) -> NDArray[np.bool_]:
    """Columns (n,) that show terrain that the DEM has, even where it is left open which."""
    return np.asarray(~_occluded(evaluation, sigma) & ~evaluation.dem_edge)


def visible_residual(evaluation: Evaluation, sigma: Floats) -> Floats:
    """Residuals (n,) in radians of what is seen; of undecided columns from the horizon or what stands near, as fits better."""
    by_near = evaluation.residual - evaluation.near_excess
    nearer = _undetermined(evaluation, sigma) & (np.abs(by_near) < np.abs(evaluation.residual))
    return np.where(nearer, by_near, evaluation.residual)


def column_nll(evaluation: Evaluation, sigma: Floats) -> Floats:
    """What columns (n,) cost (in logarithms) beyond one that fits exactly: by their residuals, or for being hidden.

    Where the DEM ends, what is seen may be its last terrain or something behind it, whichever costs less: no place pays for
    lying near the end of the DEM.
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
    """Where what stands near probably hides the horizon: what is seen is higher, by more than chance."""
    higher_seen = evaluation.near & (evaluation.residual > 0.0)
    return np.asarray(
        higher_seen & (geman_mcclure(evaluation.residual / sigma) >= np.log(UNRELATED_SKYLINE_RAD / sigma))
    )


def _undetermined(evaluation: Evaluation, sigma: Floats) -> NDArray[np.bool_]:
    """Where what stands near rises so little above the horizon that the noise leaves open which of them is seen.

    To take whatever is not much too high for the horizon would be to take the low half of the noise, and shift the place.
    """
    return np.asarray(
        evaluation.near
        & (evaluation.near_excess < RESOLVED_SIGMAS * sigma)
        & (evaluation.residual > -RESOLVED_SIGMAS * sigma)
    )


def weights(informative: NDArray[np.bool_], normalised: Floats) -> Floats:
    """Between 1 for a column that fits and nothing for a stray one (Geman-McClure)."""
    return np.asarray(informative / (1.0 + (normalised / GEMAN_MCCLURE_SIGMAS) ** 2) ** 2)


def geman_mcclure(normalised: Floats) -> Floats:
    """What columns (n,) cost by their residuals in sigmas: half the square of a small one, of any never more than a limit."""
    squared = normalised**2
    return np.asarray(0.5 * squared / (1.0 + squared / GEMAN_MCCLURE_SIGMAS**2))


def outlier_penalty(problem: Problem, evaluation: Evaluation, sigma: Floats) -> float:
    """What stray and hidden columns cost beyond what their weights leave of them in the sum of squares.

    They come in stretches of about STRAY_RAD, each of which is one accident.
    """
    normalised = visible_residual(evaluation, sigma) / sigma
    weighted = 0.5 * normalised**2 * weights(visible_columns(evaluation, sigma), normalised)
    excess = column_nll(evaluation, sigma) - weighted
    return float(excess.sum() / (problem.sector_columns * OUTLIER_STRETCH_RAD / SECTOR_RAD))


def occam_penalty(problem: Problem, covariance: Floats) -> float:
    """How much of the evidence went into angles that the sensors leave open, given the unknowns' ``covariance``.

    A frame that may be turned as one likes fits many a skyline. What a place explains then, it has to explain beyond that (the
    Occam factor of a Bayesian comparison). The heading that all frames share is left out: without a compass it is as open
    everywhere.
    """
    prior_deg = problem.prior_sigma_deg[TILT_BIAS:]
    posterior_deg = np.sqrt(np.diag(covariance)[TILT_BIAS:])
    free = np.isfinite(prior_deg) & (prior_deg > np.degrees(UNRELATED_SKYLINE_RAD))
    return float(np.log(np.maximum(prior_deg[free] / posterior_deg[free], 1.0)).sum())


def log_bayes_factor(
    problem: Problem, evaluation: Evaluation, sigma: Floats, white: Floats, correlation_columns: float
) -> float:
    """Logarithm of how much likelier the contours are from this place than from an unrelated one.

    From an unrelated place a skyline is off by CHANCE_RAD, and by about the same over a BLOCK_RAD of the horizon: each block is
    one witness, which has to agree with its middle and column by column. Of the columns' ``sigma`` (n,) what is ``white`` (n,)
    averages out in the middle as far as neighbouring columns are not correlated, the DEM's error does not. A block may be a
    stray one, no matter where the camera stands; then it speaks neither for the place nor against it.
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
