"""Which columns speak for or against a place, and how much: stray and hidden ones little, or not at all."""

import numpy as np
from numpy.typing import NDArray

from localizer.search.fit.problem import BLOCK_RAD, TILT_BIAS, Problem
from localizer.search.fit.residuals import Evaluation
from localizer.search.stage2 import SATURATION

Floats = NDArray[np.float64]

CHANCE_RAD = np.radians(3.0)
"""By how much skylines of unrelated places differ."""
APART_SIGMAS = 3.0
"""What is seen in a column tells two heights apart that differ by as many of its standard deviations."""
STRAY_RAD = np.radians(15.0)
"""How much of the horizon a cloud or a tree hides."""
MEDIAN_VARIANCE = 0.5 * np.pi
"""Of a median, in terms of the mean's, for Gaussian errors."""
STRAY_SHARE = 0.1
"""Stretches that show something else than the terrain's skyline, to be expected anywhere."""


def telling_columns(here: Evaluation, sigma: Floats) -> NDArray[np.bool_]:
    """Columns (n,) that show what the DEM knows: neither hidden nor undecided."""
    return np.asarray(visible_columns(here, sigma) & ~_undecided(here, sigma))


def visible_columns(here: Evaluation, sigma: Floats) -> NDArray[np.bool_]:
    """Columns (n,) that show terrain that the DEM has, even where it is left open which."""
    return np.asarray(~_hidden(here, sigma) & ~here.rim)


def visible_residual(here: Evaluation, sigma: Floats) -> Floats:
    """Residuals (n,) in radians of what is seen; of undecided columns from the horizon or what stands near, as fits better."""
    by_near = here.residual - here.above
    nearer = _undecided(here, sigma) & (np.abs(by_near) < np.abs(here.residual))
    return np.where(nearer, by_near, here.residual)


def surprise(here: Evaluation, sigma: Floats) -> Floats:
    """What columns (n,) cost (in logarithms) beyond one that fits exactly: by their residuals, or for being hidden.

    Where the DEM ends, what is seen may be its last terrain or something behind it, whichever costs less: no place pays for
    lying near the end of the DEM.
    """
    by_residual = geman_mcclure(visible_residual(here, sigma) / sigma)
    hidden = np.log(CHANCE_RAD / sigma)
    at_rim = np.where(_hidden(here, sigma), hidden, np.minimum(by_residual, hidden))
    return np.asarray(np.where(visible_columns(here, sigma), by_residual, np.where(here.rim, at_rim, hidden)))


def _hidden(here: Evaluation, sigma: Floats) -> NDArray[np.bool_]:
    """Where what stands near probably hides the horizon: what is seen is higher, by more than chance."""
    hides = here.near & (here.residual > 0.0)
    return np.asarray(hides & (geman_mcclure(here.residual / sigma) >= np.log(CHANCE_RAD / sigma)))


def _undecided(here: Evaluation, sigma: Floats) -> NDArray[np.bool_]:
    """Where what stands near rises so little above the horizon that the noise leaves open which of them is seen.

    To take whatever is not much too high for the horizon would be to take the low half of the noise, and shift the place.
    """
    return np.asarray(
        here.near & (here.above < APART_SIGMAS * sigma) & (here.residual > -APART_SIGMAS * sigma)
    )


def weights(telling: NDArray[np.bool_], normalised: Floats) -> Floats:
    """Between 1 for a column that fits and nothing for a stray one (Geman-McClure)."""
    return np.asarray(telling / (1.0 + (normalised / SATURATION) ** 2) ** 2)


def geman_mcclure(normalised: Floats) -> Floats:
    """What columns (n,) cost by their residuals in sigmas: half the square of a small one, of any never more than a limit."""
    squared = normalised**2
    return np.asarray(0.5 * squared / (1.0 + squared / SATURATION**2))


def stray_loss(problem: Problem, here: Evaluation, sigma: Floats) -> float:
    """What stray and hidden columns cost beyond what their weights leave of them in the sum of squares.

    They come in stretches of about STRAY_RAD, each of which is one accident.
    """
    normalised = visible_residual(here, sigma) / sigma
    weighted = 0.5 * normalised**2 * weights(visible_columns(here, sigma), normalised)
    lost = surprise(here, sigma) - weighted
    return float(lost.sum() / (problem.block_columns * STRAY_RAD / BLOCK_RAD))


def evidence_used_up(problem: Problem, covariance: Floats) -> float:
    """How much of the evidence went into angles that the sensors leave open, given the unknowns' ``covariance``.

    A frame that may be turned as one likes fits many a skyline. What a place explains then, it has to explain beyond that (the
    Occam factor of a Bayesian comparison). The heading that all frames share is left out: without a compass it is as open
    everywhere.
    """
    prior_deg = problem.prior_sigma_deg[TILT_BIAS:]
    fitted_deg = np.sqrt(np.diag(covariance)[TILT_BIAS:])
    open_ = np.isfinite(prior_deg) & (prior_deg > np.degrees(CHANCE_RAD))
    return float(np.log(np.maximum(prior_deg[open_] / fitted_deg[open_], 1.0)).sum())


def evidence_over_chance(
    problem: Problem, here: Evaluation, sigma: Floats, white: Floats, correlation_columns: float
) -> float:
    """Logarithm of how much likelier the contours are from this place than from an unrelated one.

    From an unrelated place a skyline is off by CHANCE_RAD, and by about the same over a BLOCK_RAD of the horizon: each block is
    one witness, which has to agree with its middle and column by column. Of the columns' ``sigma`` (n,) what is ``white`` (n,)
    averages out in the middle as far as neighbouring columns are not correlated, the DEM's error does not. A block may be a
    stray one, no matter where the camera stands; then it speaks neither for the place nor against it.
    """
    normalised, telling = here.residual / sigma, telling_columns(here, sigma)
    total = 0.0
    for block in problem.blocks:
        known = block[telling[block]]
        if len(known) == 0:
            continue
        witnesses = max(1.0, len(known) / max(1.0, correlation_columns))
        shared = np.sqrt(
            1.0 - (white[known] / sigma[known]) ** 2 * (1.0 - min(1.0, MEDIAN_VARIANCE / witnesses))
        )
        middle = float(np.median(normalised[known] / shared))
        size = float(np.median(np.abs(normalised[known]))) / 0.6745
        off = max(abs(middle), size)
        likelier = CHANCE_RAD / np.exp(np.log(sigma[known] * shared).mean()) * np.exp(-0.5 * off**2)
        total += (
            len(known) / problem.block_columns * float(np.log((1.0 - STRAY_SHARE) * likelier + STRAY_SHARE))
        )
    return total
