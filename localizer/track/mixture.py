"""The hypotheses of where the vehicle is, and what movements and looks do to them.

A mixture of Gaussians and, for what none of them covers, the weight of ``elsewhere``: evenly all over the DEM. A movement
shifts and widens the Gaussians, and moves some weight elsewhere, for odometry slips and vehicles are carried. A look that
found candidates c with probabilities q makes

    p(x) [(1 - e) A sum_c q_c N(x; c) + e]

of p(x), with the searched area A and the probability e that the images misled and the vehicle is at none of the candidates.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydantic import BaseModel, ConfigDict

from localizer.fix import Probability
from localizer.search.decide import LEAST_EVIDENCE
from localizer.track.gaussian_place import Place, fuse, log_density, merged, moved, offset_m
from localizer.track.odometry import Movement

ODOMETRY_FAILURE_PROBABILITY = 0.01
"""Probability, for each leg, that the odometry is wrong beyond its sigmas: slipped, towed, restarted."""
EVIDENCE_TEMPERATURE = 8.0
"""So much evidence of a look makes it e times likelier to be right. It is not 1, since an error of the DEM speaks for a wrong
place in many columns at once."""
SMALLEST_WEIGHT = 1e-7
"""Less than this goes elsewhere."""
MOST_HYPOTHESES = 64


class Hypothesis(BaseModel):
    """One place where the vehicle may be.

    ``evidence`` is the sum of that of the looks behind it: by how much, in logarithms, the terrain explains them better than
    chance.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    place: Place
    probability: Probability
    evidence: float


class Mixture(BaseModel):
    """Hypotheses by falling probability. What they lack of a sum of 1 is the probability of being elsewhere."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    hypotheses: tuple[Hypothesis, ...] = ()

    @property
    def elsewhere(self) -> float:
        """The probability of none of them."""
        return max(0.0, 1.0 - sum(h.probability for h in self.hypotheses))


@dataclass(frozen=True)
class Seen:
    """A candidate of one look: ``number`` in the look's own order."""

    number: int
    place: Place
    probability: float
    evidence: float


@dataclass(frozen=True)
class Look:
    """What one search found. ``chance``: the probability that none of the candidates is the place.

    ``area_m2`` is the DEM's, ``floor_m`` what neither the odometry's nor the search's sigmas cover, ``same_m`` within which two
    places are one.
    """

    seen: tuple[Seen, ...]
    chance: float
    area_m2: float
    floor_m: float
    same_m: float


@dataclass(frozen=True)
class Posterior:
    """A hypothesis after a look; ``number`` of the candidate it rests on, None where the look shows it nowhere."""

    hypothesis: Hypothesis
    number: int | None


def outlier_probability(evidence: float) -> float:
    """The probability that images which a place explains by that much show another: even odds where a look is just believed."""
    return float(
        1.0 / (1.0 + np.exp(np.clip((evidence - LEAST_EVIDENCE) / EVIDENCE_TEMPERATURE, -500.0, 500.0)))
    )


def predict(mixture: Mixture, movement: Movement | None, area_m2: float) -> Mixture:
    """The hypotheses after a movement. Those spread over the whole DEM, and all after an unknown one, are elsewhere."""
    if movement is None:
        return Mixture()
    kept = []
    for h in mixture.hypotheses:
        place = moved(h.place, movement.step_m, movement.covariance_m2)
        if place.widest_m < 0.5 * np.sqrt(area_m2):
            kept.append(
                Hypothesis(
                    place=place,
                    probability=(1.0 - ODOMETRY_FAILURE_PROBABILITY) * h.probability,
                    evidence=h.evidence,
                )
            )
    return Mixture(hypotheses=tuple(kept))


def update(mixture: Mixture, look: Look) -> tuple[Posterior, ...]:
    """The hypotheses after a look, by falling probability; their probabilities add up to at most 1."""
    believed, misled = _log(1.0 - look.chance), _log(look.chance)
    log_weights: list[float] = [_log(mixture.elsewhere) + misled]
    pairs: list[tuple[Hypothesis | None, Seen | None]] = [(None, None)]
    for c in look.seen:
        here = believed + _log(c.probability)
        log_weights.append(_log(mixture.elsewhere) + here)
        pairs.append((None, c))
        for h in mixture.hypotheses:
            agree = _log(look.area_m2) + log_density(h.place, c.place, look.floor_m)
            log_weights.append(_log(h.probability) + here + agree)
            pairs.append((h, c))
    for h in mixture.hypotheses:
        log_weights.append(_log(h.probability) + misled)
        pairs.append((h, None))
    weights = np.exp(np.array(log_weights) - max(log_weights))
    shares = weights / weights.sum()
    parts = [
        (float(share), _joined(*pair))
        for share, pair in zip(shares[1:], pairs[1:], strict=True)
        if share >= SMALLEST_WEIGHT
    ]
    return _merged_posteriors(parts, look.same_m)


def _joined(known: Hypothesis | None, seen: Seen | None) -> Posterior:
    """The place of a hypothesis, of a candidate, or of both if they are one."""
    if seen is None:
        assert known is not None
        return Posterior(known, None)
    if known is None:
        hypothesis = Hypothesis(place=seen.place, probability=0.0, evidence=seen.evidence)
    else:
        hypothesis = Hypothesis(
            place=fuse(known.place, seen.place), probability=0.0, evidence=known.evidence + seen.evidence
        )
    return Posterior(hypothesis, seen.number)


def mixture_of(posteriors: Sequence[Posterior]) -> Mixture:
    """What is carried to the next look."""
    return Mixture(hypotheses=tuple(p.hypothesis for p in posteriors))


def _merged_posteriors(parts: list[tuple[float, Posterior]], same_m: float) -> tuple[Posterior, ...]:
    """The weights as probabilities, with those that are one place made one, around the heaviest of them."""
    # by place where weights are equal, so that the order of the hypotheses does not matter
    rest = sorted(parts, key=lambda s: (-s[0], s[1].hypothesis.place.lat_deg, s[1].hypothesis.place.lon_deg))
    groups: list[list[tuple[float, Posterior]]] = []
    for share, part in rest:
        for group in groups:
            if _same_place(group[0][1], part, same_m):
                group.append((share, part))
                break
        else:
            groups.append([(share, part)])
    posteriors = []
    for group in groups:
        lead = group[0][1]
        weights = [share for share, _ in group]
        hypothesis = Hypothesis(
            place=merged([part.hypothesis.place for _, part in group], weights),
            probability=min(1.0, sum(weights)),
            evidence=lead.hypothesis.evidence,
        )
        posteriors.append(Posterior(hypothesis, lead.number))
    posteriors.sort(key=lambda p: -p.hypothesis.probability)
    return tuple(posteriors[:MOST_HYPOTHESES])


def _same_place(first: Posterior, second: Posterior, same_m: float) -> bool:
    """Whether both are one place. What the look did not show stays apart from what it showed: it may be far wider."""
    if (first.number is None) != (second.number is None):
        return False
    one, two = first.hypothesis.place, second.hypothesis.place
    off = offset_m(one, two)
    if float(np.hypot(*off)) <= same_m:
        return True
    return bool(off @ np.linalg.solve(one.covariance + two.covariance, off) <= 1.0)


def _log(value: float) -> float:
    return float(np.log(value)) if value > 0.0 else -np.inf
