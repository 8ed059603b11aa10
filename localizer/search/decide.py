"""From refined candidates to an answer: one place, several, or none.

The candidates share one model of the errors, so that their posteriors compare (Laplace: the height of each peak times its
volume). Whether the best of them is good enough to be believed at all is a question of its own: the terrain must explain
most columns within what the sensors, the image and a plausible DEM error allow.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from localizer.fix import Status
from localizer.search.refine import Refined

CERTAIN = 0.99
"""Posterior probability from which one place stands out."""
LEAST_INLIERS = 0.6
"""Share of the columns that a believable place explains within three sigma."""
LEAST_EVIDENCE = 15.0
"""Logarithm of how much better than chance a place must explain the skyline: a whole DEM is a million chances."""
CERTAIN_EVIDENCE = 25.0
"""And this much for the best place to be called the only one."""
MOST_PRIOR_SIGMAS = 7.0
"""No reading is further off than this."""
WIDEST_FIX_CELLS = 5.0
"""A place known no better than this, in standard deviations, is not one place."""
NEGLIGIBLE = 1e-4


@dataclass(frozen=True)
class Decision:
    """``candidates`` by falling probability (the negligible ones left out) with their ``probabilities``."""

    status: Status
    candidates: list[Refined]
    probabilities: NDArray[np.float64]


def explains(candidate: Refined, largest_dem_error_m: float, priors: int) -> bool:
    """Whether the terrain seen from this place explains what was observed."""
    return (
        candidate.evidence >= LEAST_EVIDENCE
        and candidate.inlier_share >= LEAST_INLIERS
        and candidate.dem_error_m < 0.98 * largest_dem_error_m
        and candidate.prior_chi2 < MOST_PRIOR_SIGMAS**2 + priors
    )


def decide(candidates: Sequence[Refined], evidence: float, cell_m: float) -> Decision:
    """Probabilities of candidates that were refined under one error model, and what they add up to.

    ``evidence`` is that of the best of them, seen with all columns.
    """
    if not candidates:
        return Decision("none", [], np.zeros(0))
    peak = np.array([c.log_volume - c.cost for c in candidates])
    weight = np.exp(peak - peak.max())
    probability = weight / weight.sum()
    order = np.argsort(-probability, kind="stable")
    kept = [i for i in order if probability[i] >= NEGLIGIBLE]
    single = (
        probability[kept[0]] >= CERTAIN
        and evidence >= CERTAIN_EVIDENCE
        and _one_place(candidates[kept[0]], cell_m)
    )
    return Decision("fix" if single else "ambiguous", [candidates[i] for i in kept], probability[kept])


def answered_with(decision: Decision, best: Refined, cell_m: float) -> Decision:
    """The same with the likeliest candidate as it was refined in the end; no ``fix`` where that is known too vaguely."""
    status: Status = decision.status if _one_place(best, cell_m) or decision.status != "fix" else "ambiguous"
    return replace(decision, status=status, candidates=[best, *decision.candidates[1:]])


def _one_place(candidate: Refined, cell_m: float) -> bool:
    widest_m = float(np.sqrt(np.linalg.eigvalsh(candidate.covariance_enu_m2)[-1]))
    return widest_m <= WIDEST_FIX_CELLS * cell_m
