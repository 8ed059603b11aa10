"""From refined candidates to an answer: one place, several, or none.

The candidates share one model of the errors, so that their posteriors compare (Laplace: the height of each peak times its
volume). Whether the best of them is good enough to be believed at all is a question of its own: the terrain must explain
most columns within what the sensors, the image and a plausible DEM error allow.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from localizer.fix import Reason, Status
from localizer.search.fit.refine import Refined
from localizer.search.reasons import (
    contradicted,
    large_dem_error,
    large_uncertainty,
    no_match,
    several_places,
    weak_evidence,
)

FIX_PROBABILITY = 0.99
"""Posterior probability from which one place stands out."""
LEAST_INLIERS = 0.6
"""Share of the columns that a believable place explains within three sigma."""
LEAST_EVIDENCE = 15.0
"""Logarithm of how much better than chance a place must explain the skyline: a whole DEM is a million chances."""
TEMPERING_EXPONENT = 0.5
"""Places are told apart by so much of their log-odds: the model of the errors is only about right."""
LEAST_MODE_SIGMA_CELLS = 0.1
"""No peak is narrower: between the cells the surface is a guess."""
FIX_EVIDENCE = 25.0
"""And this much for the best place to be called the only one."""
MOST_PRIOR_SIGMAS = 7.0
"""No reading is further off than this."""
LARGEST_FIX_SIGMA_CELLS = 5.0
"""A place known no better than this, in standard deviations, is not one place."""
NEGLIGIBLE = 1e-4


@dataclass(frozen=True)
class Decision:
    """``candidates`` by falling probability (the negligible ones left out) with their ``probabilities``.

    ``elsewhere``: the probability of all places that are not among them, those that were not compared included.
    """

    status: Status
    candidates: list[Refined]
    probabilities: NDArray[np.float64]
    elsewhere: float
    reason: Reason | None
    """None for a fix."""


def is_plausible(candidate: Refined, largest_dem_error_m: float, priors: int) -> bool:
    """Whether the terrain seen from this place explains what was observed."""
    return rejection_reason(candidate, largest_dem_error_m, priors, np.inf) is None


def rejection_reason(
    candidate: Refined, largest_dem_error_m: float, priors: int, skyline_deg: float
) -> Reason | None:
    """What speaks against a place by itself; ``skyline_deg``: how much of the horizon was seen."""
    if candidate.evidence < LEAST_EVIDENCE:
        return no_match(skyline_deg)
    if candidate.dem_error_m >= 0.98 * largest_dem_error_m:
        return large_dem_error(candidate.dem_error_m)
    if candidate.inlier_share < LEAST_INLIERS or candidate.prior_chi2 >= MOST_PRIOR_SIGMAS**2 + priors:
        return contradicted(candidate, LEAST_INLIERS)
    return None


def log_mass(compared: Refined, cell_m: float) -> float:
    """Logarithm of a place's probability but for a constant: how high its peak is, and how wide."""
    wide_m2 = compared.covariance_enu_m2 + np.eye(2) * (LEAST_MODE_SIGMA_CELLS * cell_m) ** 2
    return TEMPERING_EXPONENT * compared.log_odds + 0.5 * float(np.linalg.slogdet(wide_m2)[1])


def decide(masses: Sequence[float], places: Sequence[Refined], cell_m: float, elsewhere: float) -> Decision:
    """Probabilities of places, the likeliest first, and what they add up to.

    ``masses``: their logarithms (``log_mass``). ``elsewhere``: the weight of what was not compared; that of the likeliest place
    is 1.
    """
    weight = np.exp(np.array(masses) - max(masses))
    probability = weight / (weight.sum() + elsewhere)
    kept = [i for i in range(len(places)) if i == 0 or probability[i] >= NEGLIGIBLE]
    if probability[0] < FIX_PROBABILITY:
        reason: Reason | None = several_places(len(kept))
    elif places[0].evidence < FIX_EVIDENCE:
        reason = weak_evidence(places[0].evidence, FIX_EVIDENCE)
    else:
        reason = _too_uncertain(places[0], cell_m)
    return Decision(
        status="ambiguous" if reason else "fix",
        candidates=[places[i] for i in kept],
        probabilities=probability[kept],
        elsewhere=float(max(0.0, 1.0 - probability[kept].sum())),
        reason=reason,
    )


def no_place(reason: Reason) -> Decision:
    """No place is believed."""
    return Decision("none", [], np.zeros(0), 1.0, reason)


def with_refined_best(decision: Decision, best: Refined, cell_m: float) -> Decision:
    """The same with the likeliest candidate as it was refined in the end; no ``fix`` where that is known too vaguely."""
    reason = decision.reason or _too_uncertain(best, cell_m)
    status: Status = "ambiguous" if decision.status == "fix" and reason else decision.status
    return replace(decision, status=status, candidates=[best, *decision.candidates[1:]], reason=reason)


def _too_uncertain(candidate: Refined, cell_m: float) -> Reason | None:
    widest_m = float(np.sqrt(np.linalg.eigvalsh(candidate.covariance_enu_m2)[-1]))
    return large_uncertainty(widest_m) if widest_m > LARGEST_FIX_SIGMA_CELLS * cell_m else None
