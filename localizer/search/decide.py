"""The decision: probabilities of the places by Laplace approximation, and the status that follows.

The posterior mass of a mode is its height times its volume. With log-odds L, the covariance C of the position, and the
likelihood tempered by the exponent t,

    log mass = t L + 0.5 ln det C,    P_i = mass_i / (sum of all masses + elsewhere).

Whether the best place is believed at all is a separate question: the terrain must explain most columns within the errors
that are plausible for sensors, image and DEM.
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
"""Posterior probability from which the best place is a fix. Chosen, not tuned: it bounds
the share of wrong fixes. Sensitivity: halved or doubled, no change (docs/sensitivity.md)."""
LEAST_INLIERS = 0.6
"""Least share of inlier columns (within 3 sigma) at a place that is believed. Tuned on simulated cases inside
and outside the DEM. Sensitivity: halved or doubled, no change (docs/sensitivity.md)."""
LEAST_EVIDENCE = 15.0
"""Least evidence (log Bayes factor) of a place that is believed. A DEM of a million cells has as many unrelated places,
ln(1e6) = 13.8. Tuned on simulated cases inside and outside the DEM. Sensitivity: halved, no change; doubled, 2 of 5 statuses
change (docs/sensitivity.md)."""
TEMPERING_EXPONENT = 0.5
"""Exponent on the likelihood when places are compared (power posterior): the error model is only approximately right. Tuned
on the scenario ``twins``, so that stated probabilities are right as often as they say. Sensitivity: halved, 1 of 5 statuses
changes; doubled, no change (docs/sensitivity.md)."""
LEAST_MODE_SIGMA_CELLS = 0.1
"""Least standard deviation of a mode when places are compared: between the cells the surface is an interpolation. Tuned on the
scenario ``twins``. Sensitivity: halved or doubled, no change (docs/sensitivity.md)."""
FIX_EVIDENCE = 25.0
"""Least evidence of a fix. Tuned on simulated cases inside and outside the DEM.
Sensitivity: halved, no change; doubled, 1 of 5 statuses changes (docs/sensitivity.md)."""
MOST_PRIOR_SIGMAS = 7.0
"""Largest normalised error of a reading at a place that is believed. Tuned on simulated cases inside and outside
the DEM. Sensitivity: halved or doubled, no change (docs/sensitivity.md)."""
LARGEST_FIX_SIGMA_CELLS = 5.0
"""Largest standard deviation of a fix. Tuned on simulated cases of ``sim evaluate``.
Sensitivity: halved or doubled, no change (docs/sensitivity.md)."""
NEGLIGIBLE = 1e-4
"""Less probable places are not listed; their probability goes into ``elsewhere``."""


@dataclass(frozen=True)
class Decision:
    """``candidates`` by decreasing probability, without negligible ones, and their ``probabilities``.

    ``elsewhere``: the probability of all places that are not among them, those that were not compared included.
    """

    status: Status
    candidates: list[Refined]
    probabilities: NDArray[np.float64]
    elsewhere: float
    reason: Reason | None
    """None for a fix."""


def is_plausible(candidate: Refined, largest_dem_error_m: float, priors: int) -> bool:
    """Whether the terrain seen from this place explains the observation."""
    return rejection_reason(candidate, largest_dem_error_m, priors, np.inf) is None


def rejection_reason(
    candidate: Refined, largest_dem_error_m: float, priors: int, skyline_deg: float
) -> Reason | None:
    """Why a place is not believed, regardless of others; None if it is.

    ``skyline_deg``: how much of the horizon was observed.
    """
    if candidate.evidence < LEAST_EVIDENCE:
        return no_match(skyline_deg)
    if candidate.dem_error_m >= 0.98 * largest_dem_error_m:
        return large_dem_error(candidate.dem_error_m)
    if candidate.inlier_share < LEAST_INLIERS or candidate.prior_chi2 >= MOST_PRIOR_SIGMAS**2 + priors:
        return contradicted(candidate, LEAST_INLIERS)
    return None


def log_mass(compared: Refined, cell_m: float) -> float:
    """Unnormalised log-probability of a mode (Laplace approximation)."""
    wide_m2 = compared.covariance_enu_m2 + np.eye(2) * (LEAST_MODE_SIGMA_CELLS * cell_m) ** 2
    return TEMPERING_EXPONENT * compared.log_odds + 0.5 * float(np.linalg.slogdet(wide_m2)[1])


def decide(masses: Sequence[float], places: Sequence[Refined], cell_m: float, elsewhere: float) -> Decision:
    """Status and probabilities of places, given the most probable first.

    ``masses``: their unnormalised log-probabilities (``log_mass``). ``elsewhere``: the weight of all places that were not
    compared, relative to the most probable one.
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
    """The decision with its first candidate replaced by a later fit; no longer ``fix`` if that is too uncertain."""
    reason = decision.reason or _too_uncertain(best, cell_m)
    status: Status = "ambiguous" if decision.status == "fix" and reason else decision.status
    return replace(decision, status=status, candidates=[best, *decision.candidates[1:]], reason=reason)


def _too_uncertain(candidate: Refined, cell_m: float) -> Reason | None:
    widest_m = float(np.sqrt(np.linalg.eigvalsh(candidate.covariance_enu_m2)[-1]))
    return large_uncertainty(widest_m) if widest_m > LARGEST_FIX_SIGMA_CELLS * cell_m else None
