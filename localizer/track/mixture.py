"""Gaussian mixture filter over the hypotheses of where the vehicle is.

The density is a mixture of Gaussians plus a uniform density over the DEM with the weight ``elsewhere``. Prediction shifts
and widens the Gaussians by the odometry, and moves some weight elsewhere, because odometry can fail. An update by a search with
candidates c of probabilities q multiplies the density p(x) by

    (1 - e) A sum_c q_c N(x; c) + e,

with the searched area A and the probability e that the measurement is an outlier (none of the candidates is the place).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydantic import BaseModel, ConfigDict

from localizer.fix import Probability
from localizer.search.decide import LEAST_EVIDENCE
from localizer.track.gaussian_place import GaussianPlace, displaced, fuse, log_density, merged, offset_m
from localizer.track.odometry import Movement

ODOMETRY_FAILURE_PROBABILITY = 0.01
"""Probability, for each leg, that the odometry is wrong beyond its sigmas: slip, towing, restart."""
EVIDENCE_TEMPERATURE = 8.0
"""Evidence that raises the odds of a measurement being right by the factor e. It is larger than 1, because a DEM error affects
many columns together and can favour a wrong place."""
SMALLEST_WEIGHT = 1e-7
"""Hypotheses with less weight are dropped; their weight goes into ``elsewhere``."""
MOST_HYPOTHESES = 64


class Hypothesis(BaseModel):
    """One place where the vehicle may be.

    ``evidence``: sum of the log Bayes factors of the measurements that support it.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    place: GaussianPlace
    probability: Probability
    evidence: float


class Mixture(BaseModel):
    """Hypotheses by decreasing probability. The remainder to 1 is the probability of being elsewhere."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    hypotheses: tuple[Hypothesis, ...] = ()

    @property
    def elsewhere(self) -> float:
        """The probability of none of them."""
        return max(0.0, 1.0 - sum(h.probability for h in self.hypotheses))


@dataclass(frozen=True)
class MeasuredPlace:
    """A candidate of one search: ``number`` in the order of the search."""

    number: int
    place: GaussianPlace
    probability: float
    evidence: float


@dataclass(frozen=True)
class Measurement:
    """The result of one search. ``outlier_probability``: that none of the candidates is the place.

    ``area_m2``: of the DEM. ``model_error_m``: standard deviation of errors that neither odometry nor search accounts for.
    ``same_m``: distance within which two places are one.
    """

    measured: tuple[MeasuredPlace, ...]
    outlier_probability: float
    area_m2: float
    model_error_m: float
    same_m: float


@dataclass(frozen=True)
class Posterior:
    """A hypothesis after an update; ``number`` of its candidate, None if the search did not find it."""

    hypothesis: Hypothesis
    number: int | None


def outlier_probability(evidence: float) -> float:
    """Probability that a place of this evidence is wrong: logistic, 0.5 at the least evidence that is believed."""
    return float(
        1.0 / (1.0 + np.exp(np.clip((evidence - LEAST_EVIDENCE) / EVIDENCE_TEMPERATURE, -500.0, 500.0)))
    )


def predict(mixture: Mixture, movement: Movement | None, area_m2: float) -> Mixture:
    """The hypotheses after a movement. After an unknown one, or if spread over the whole DEM, they go into ``elsewhere``."""
    if movement is None:
        return Mixture()
    kept = []
    for h in mixture.hypotheses:
        place = displaced(h.place, movement.step_m, movement.covariance_m2)
        if place.widest_m < 0.5 * np.sqrt(area_m2):
            kept.append(
                Hypothesis(
                    place=place,
                    probability=(1.0 - ODOMETRY_FAILURE_PROBABILITY) * h.probability,
                    evidence=h.evidence,
                )
            )
    return Mixture(hypotheses=tuple(kept))


def update(mixture: Mixture, measurement: Measurement) -> tuple[Posterior, ...]:
    """The hypotheses after a measurement, by decreasing probability; their sum is at most 1."""
    inlier, outlier = _log(1.0 - measurement.outlier_probability), _log(measurement.outlier_probability)
    log_weights: list[float] = [_log(mixture.elsewhere) + outlier]
    pairs: list[tuple[Hypothesis | None, MeasuredPlace | None]] = [(None, None)]
    for c in measurement.measured:
        here = inlier + _log(c.probability)
        log_weights.append(_log(mixture.elsewhere) + here)
        pairs.append((None, c))
        for h in mixture.hypotheses:
            agree = _log(measurement.area_m2) + log_density(h.place, c.place, measurement.model_error_m)
            log_weights.append(_log(h.probability) + here + agree)
            pairs.append((h, c))
    for h in mixture.hypotheses:
        log_weights.append(_log(h.probability) + outlier)
        pairs.append((h, None))
    weights = np.exp(np.array(log_weights) - max(log_weights))
    shares = weights / weights.sum()
    parts = [
        (float(share), _joined(*pair))
        for share, pair in zip(shares[1:], pairs[1:], strict=True)
        if share >= SMALLEST_WEIGHT
    ]
    return _merged_posteriors(parts, measurement.same_m)


def _joined(prior: Hypothesis | None, measured: MeasuredPlace | None) -> Posterior:
    """The place of a hypothesis, of a candidate, or of both fused."""
    if measured is None:
        assert prior is not None
        return Posterior(prior, None)
    if prior is None:
        hypothesis = Hypothesis(place=measured.place, probability=0.0, evidence=measured.evidence)
    else:
        hypothesis = Hypothesis(
            place=fuse(prior.place, measured.place),
            probability=0.0,
            evidence=prior.evidence + measured.evidence,
        )
    return Posterior(hypothesis, measured.number)


def mixture_of(posteriors: Sequence[Posterior]) -> Mixture:
    """The mixture that is carried to the next step."""
    return Mixture(hypotheses=tuple(p.hypothesis for p in posteriors))


def _merged_posteriors(parts: list[tuple[float, Posterior]], same_m: float) -> tuple[Posterior, ...]:
    """Posteriors with normalised weights; those of one place are merged into the heaviest of them."""
    # ties are ordered by place, so that the order of the hypotheses does not matter
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
    """Whether both are one place. A measured and an unmeasured hypothesis are never merged: the latter may be far wider."""
    if (first.number is None) != (second.number is None):
        return False
    one, two = first.hypothesis.place, second.hypothesis.place
    off = offset_m(one, two)
    if float(np.hypot(*off)) <= same_m:
        return True
    return bool(off @ np.linalg.solve(one.covariance + two.covariance, off) <= 1.0)


def _log(value: float) -> float:
    return float(np.log(value)) if value > 0.0 else -np.inf
