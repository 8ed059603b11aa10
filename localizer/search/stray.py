"""Which columns speak for or against a place, and how much: stray and hidden ones little, or not at all."""

import numpy as np
from numpy.typing import NDArray

from localizer.search.problem import BLOCK_RAD, Problem
from localizer.search.residuals import Evaluation
from localizer.search.stage2 import SATURATION

Floats = NDArray[np.float64]

CHANCE_RAD = np.radians(3.0)
"""By how much skylines of unrelated places differ."""
STRAY_RAD = np.radians(15.0)
"""How much of the horizon a cloud or a tree hides."""
STRAY_SHARE = 0.1
"""Stretches that show something else than the terrain's skyline, to be expected anywhere."""


def telling_columns(here: Evaluation, sigma: Floats) -> NDArray[np.bool_]:
    """Columns (n,) that show what the DEM knows: all but those where what stands near probably hides it."""
    hides = here.near & (here.residual > 0.0)
    return np.asarray(~hides | (geman_mcclure(here.residual / sigma) < np.log(CHANCE_RAD / sigma)))


def weights(telling: NDArray[np.bool_], normalised: Floats) -> Floats:
    """Between 1 for a column that fits and nothing for a stray one (Geman-McClure)."""
    return np.asarray(telling / (1.0 + (normalised / SATURATION) ** 2) ** 2)


def geman_mcclure(normalised: Floats) -> Floats:
    """What columns (n,) cost by their residuals in sigmas: half the square of a small one, of any never more than a limit."""
    squared = normalised**2
    return np.asarray(0.5 * squared / (1.0 + squared / SATURATION**2))


def stray_loss(problem: Problem, telling: NDArray[np.bool_], normalised: Floats, sigma: Floats) -> float:
    """What stray and hidden columns cost beyond what their weights leave of them in the sum of squares.

    They come in stretches of about STRAY_RAD, each of which is one accident.
    """
    weighted = 0.5 * normalised**2 * weights(telling, normalised)
    lost = np.where(telling, geman_mcclure(normalised) - weighted, np.log(CHANCE_RAD / sigma))
    return float(lost.sum() / (problem.block_columns * STRAY_RAD / BLOCK_RAD))


def evidence_over_chance(
    problem: Problem, here: Evaluation, telling: NDArray[np.bool_], sigma: Floats
) -> float:
    """Logarithm of how much likelier the contours are from this place than from an unrelated one.

    From an unrelated place a skyline is off by CHANCE_RAD, and by about the same over a BLOCK_RAD of the horizon: each block is
    one witness. It may be a stray one, no matter where the camera stands; then it speaks neither for the place nor against it.
    """
    normalised = here.residual / sigma
    total = 0.0
    for block in problem.blocks:
        known = block[telling[block]]
        if len(known) == 0:
            continue
        size = float(np.median(np.abs(normalised[known])))
        likelier = CHANCE_RAD / np.exp(np.log(sigma[known]).mean()) * np.exp(-0.5 * (size / 0.6745) ** 2)
        total += (
            len(known) / problem.block_columns * float(np.log((1.0 - STRAY_SHARE) * likelier + STRAY_SHARE))
        )
    return total
