"""What differs between frozen answers and those of now, by how much, and what would explain it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from frozen_answers.answer import Answer, Candidate, Frozen
from frozen_answers.explain import Explanation, alarm, explanation, same_spot

Value = str | float | None


@dataclass(frozen=True)
class Quantity:
    """What is compared: amounts up to ``tolerance`` in ``unit`` are the same."""

    tolerance: float
    unit: str


QUANTITIES: dict[str, Quantity] = {
    "status": Quantity(0.0, ""),
    "reason": Quantity(0.0, ""),
    "crs": Quantity(0.0, ""),
    "searched": Quantity(0.0, ""),
    "left out": Quantity(0.0, ""),
    "place": Quantity(0.1, "sigma"),
    "sigma": Quantity(0.02, "relative"),
    "probability": Quantity(0.005, ""),
    "elsewhere": Quantity(0.005, ""),
    "alternatives": Quantity(0.0, "places"),
    "evidence": Quantity(0.1, ""),
    "inlier share": Quantity(0.005, ""),
    "DEM error": Quantity(0.02, "m"),
    "correlation": Quantity(0.05, "columns"),
    "prior chi2": Quantity(0.05, ""),
    "azimuth bias": Quantity(0.002, "deg"),
    "tilt bias": Quantity(0.001, "deg"),
    "altitude bias": Quantity(0.05, "m"),
    "points": Quantity(2.0, "points"),
}
"""Tolerances: chosen, so that what is within them does not matter to a user (docs/testing.md)."""
NUMBERS = {
    "probability": "probability",
    "elsewhere": "elsewhere",
    "evidence": "evidence",
    "inlier share": "inlier_share",
    "DEM error": "dem_error_m",
    "correlation": "correlation_columns",
    "prior chi2": "prior_chi2",
    "azimuth bias": "azimuth_bias_deg",
    "tilt bias": "tilt_bias_deg",
    "altitude bias": "altitude_bias_m",
    "points": "points",
}
WORDS = {"status": "status", "reason": "reason", "crs": "crs", "searched": "searched", "left out": "left_out"}
LIKELY = 0.01
"""Alternatives below this probability are not compared."""
ALTERNATIVE_SIGMAS = 0.2
"""Largest move of an alternative, in its own sigmas."""


@dataclass(frozen=True)
class Change:
    """One quantity that is not equal. ``look``: which answer of a drive, from 0; ``moved_m``: of a place."""

    look: int
    what: str
    frozen: Value
    now: Value
    amount: float
    beyond: bool
    moved_m: float | None = None

    def text(self) -> str:
        """For people."""
        unit = QUANTITIES[self.what].unit
        if self.what == "place":
            if self.moved_m is None:
                return "place gone" if self.now is None else "place where none was"
            return f"place moved {self.moved_m:.3g} m = {self.amount:.3g} sigma"
        if self.what == "sigma":
            return f"sigma {_shown(self.frozen)} -> {_shown(self.now)} m, by {self.amount:.1%} in a direction"
        if not (isinstance(self.frozen, int | float) and isinstance(self.now, int | float)):
            return f"{self.what} {_shown(self.frozen)} -> {_shown(self.now)}"
        if self.what == "evidence":
            better = "better" if self.now > self.frozen else "worse"
            return f"evidence {self.frozen:.1f} -> {self.now:.1f} ({better})"
        return f"{self.what} {self.frozen:.4g} -> {self.now:.4g}{f' {unit}' if unit else ''}"


def _shown(value: Value) -> str:
    if value is None:
        return "none"
    return value if isinstance(value, str) else f"{value:.4g}"


@dataclass(frozen=True)
class Comparison:
    """A case. ``changes``: all that is not equal, also within the tolerances; ``explanation`` is None within them."""

    case: str
    explanation: Explanation | None
    changes: tuple[Change, ...]
    alarm: str | None = None
    """Said first: a fix far from the truth, a defect."""

    @property
    def beyond(self) -> tuple[Change, ...]:
        """Changes beyond their tolerance."""
        return tuple(change for change in self.changes if change.beyond)


def compare(frozen: Mapping[str, Frozen], now: Mapping[str, Frozen]) -> list[Comparison]:
    """Every case of either, by name."""
    return [compare_case(name, frozen.get(name), now.get(name)) for name in sorted({*frozen, *now})]


def compare_case(name: str, frozen: Frozen | None, now: Frozen | None) -> Comparison:
    """One case; None where there is no such case."""
    if frozen is None or now is None:
        return Comparison(name, "new case" if frozen is None else "case gone", ())
    changes: list[Change] = []
    for look, (before, after) in enumerate(zip(frozen.answers, now.answers, strict=False)):
        changes += compare_answers(before, after, look)
    if len(frozen.answers) != len(now.answers):
        count = len(frozen.answers), len(now.answers)
        changes.append(_words(len(changes), "status", f"{count[0]} answers", f"{count[1]} answers"))
    inputs_changed = now.fingerprint.differs_from(frozen.fingerprint)
    first = min((change.look for change in changes if change.beyond), default=0)
    why = explanation(
        {change.what for change in changes if change.beyond and change.look == first},
        frozen.answers[min(first, len(frozen.answers) - 1)],
        now.answers[min(first, len(now.answers) - 1)],
        QUANTITIES["evidence"].tolerance,
        inputs_changed,
    )
    return Comparison(name, why, tuple(changes), alarm(frozen.answers, now.answers))


def compare_answers(frozen: Answer, now: Answer, look: int = 0) -> list[Change]:
    """All that is not equal."""
    changes = []
    for what, field in WORDS.items():
        before, after = getattr(frozen, field), getattr(now, field)
        if before != after:
            changes.append(_words(look, what, before, after))
    frozen = _in_the_order_of(now, frozen)
    if (frozen.easting_m is None) != (now.easting_m is None):
        there = frozen.easting_m is not None
        changes.append(
            Change(look, "place", "a place" if there else None, None if there else "a place", np.inf, True)
        )
    elif frozen.easting_m is not None and frozen.crs == now.crs:
        changes += _place_and_sigma(frozen, now, look)
    for what, field in NUMBERS.items():
        changes += _numbers(look, what, getattr(frozen, field), getattr(now, field))
    return [*changes, *_alternatives(frozen.candidates, now.candidates, look)]


def _words(look: int, what: str, frozen: Value, now: Value) -> Change:
    return Change(look, what, frozen, now, 1.0, beyond=True)


def _numbers(look: int, what: str, frozen: float | None, now: float | None) -> list[Change]:
    if frozen == now:
        return []
    if frozen is None or now is None:
        return [Change(look, what, frozen, now, np.inf, beyond=True)]
    amount = abs(now - frozen)
    return [Change(look, what, frozen, now, amount, amount > QUANTITIES[what].tolerance)]


def _in_the_order_of(now: Answer, frozen: Answer) -> Answer:
    """Where the first of several equally probable places changed with another: the frozen answer with that one first.

    Which of two equals comes first is a matter of last bits.
    """
    if not frozen.candidates or now.easting_m is None or now.northing_m is None or frozen.crs != now.crs:
        return frozen
    place = now.easting_m, now.northing_m
    first = frozen.candidates[0]
    for candidate in frozen.candidates[1:]:
        equal = abs(candidate[2] - first[2]) <= QUANTITIES["probability"].tolerance
        if equal and same_spot(candidate, place, ALTERNATIVE_SIGMAS) and not same_spot(first, place, 1.0):
            variance_m2 = candidate[3] ** 2
            return frozen.model_copy(
                update={
                    "easting_m": candidate[0],
                    "northing_m": candidate[1],
                    "probability": candidate[2],
                    "covariance_m2": now.covariance_m2
                    if np.isclose(_sigma_m(now), candidate[3], rtol=QUANTITIES["sigma"].tolerance)
                    else (variance_m2, 0.0, variance_m2),
                }
            )
    return frozen


def _place_and_sigma(frozen: Answer, now: Answer, look: int) -> list[Change]:
    assert frozen.easting_m is not None
    assert frozen.northing_m is not None
    assert now.easting_m is not None
    assert now.northing_m is not None
    before, after = _matrix(frozen), _matrix(now)
    off = np.array([now.easting_m - frozen.easting_m, now.northing_m - frozen.northing_m])
    moved_m, sigmas = float(np.hypot(*off)), float(np.sqrt(off @ np.linalg.solve(before, off)))
    changes = []
    if moved_m > 0.0:
        beyond = sigmas > QUANTITIES["place"].tolerance
        here, there = (f"{a.easting_m:.1f} {a.northing_m:.1f}" for a in (frozen, now))
        changes.append(Change(look, "place", here, there, sigmas, beyond, moved_m))
    # the sigma that changed most, in any direction
    ratios = np.sqrt(np.abs(np.linalg.eigvals(np.linalg.solve(before, after))))
    amount = float(np.abs(np.log(np.maximum(ratios, 1e-9))).max())
    if amount > 0.0 and frozen.covariance_m2 != now.covariance_m2:
        beyond = amount > QUANTITIES["sigma"].tolerance
        changes.append(Change(look, "sigma", _sigma_m(frozen), _sigma_m(now), amount, beyond))
    return changes


def _alternatives(frozen: Sequence[Candidate], now: Sequence[Candidate], look: int) -> list[Change]:
    """Places beside the first that only one of the answers has; a place within another's reach is the same."""
    before = [place for place in frozen if place[2] >= LIKELY]
    after = [place for place in now if place[2] >= LIKELY]
    lost = [place for place in before if not any(_alike(place, other) for other in now)]
    added = [place for place in after if not any(_alike(other, place) for other in frozen)]
    if lost or added:
        differing = float(max(len(lost), len(added)))
        return [Change(look, "alternatives", float(len(before)), float(len(after)), differing, beyond=True)]
    return []


def _alike(place: Candidate, other: Candidate) -> bool:
    near = same_spot(place, other[:2], ALTERNATIVE_SIGMAS)
    return near and abs(place[2] - other[2]) <= 2.0 * QUANTITIES["probability"].tolerance


def _matrix(answer: Answer) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    assert answer.covariance_m2 is not None
    east, both, north = answer.covariance_m2
    return np.array([[east, both], [both, north]])


def _sigma_m(answer: Answer) -> float:
    return float(np.sqrt(np.linalg.eigvalsh(_matrix(answer))[-1]))
