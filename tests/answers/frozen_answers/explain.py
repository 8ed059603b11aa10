"""What would explain a difference between two answers to the same case."""

from collections.abc import Sequence
from typing import Literal

import numpy as np

from frozen_answers.answer import Answer, Candidate

Explanation = Literal[
    "new case",
    "case gone",
    "inputs changed",
    "other status",
    "twin swap",
    "another place, same evidence",
    "another place, more evidence",
    "another place, less evidence",
    "place moved",
    "same place, other sigma",
    "same place, other probability",
    "same place, other evidence",
    "other details",
]
MEANING: dict[Explanation, str] = {
    "new case": "is not frozen yet",
    "case gone": "is frozen, but there is no such case any more",
    "inputs changed": "the search was given something else than when it was frozen: sim or the makers of cases changed",
    "other status": "fix, ambiguous, none or refused instead of another of these",
    "twin swap": "two places look alike, and the other one now comes first",
    "another place, same evidence": "a place that explains the contours as well, and was not listed before",
    "another place, more evidence": "the search found a better place than it did",
    "another place, less evidence": "the search misses the better place",
    "place moved": "the same optimum, somewhere else by more than the tolerance",
    "same place, other sigma": "the error model or the covariance changed",
    "same place, other probability": "the weights of the alternatives changed",
    "same place, other evidence": "the likelihood or the reference of the evidence changed",
    "other details": "reason, estimated errors, alternatives or frames left out changed; the place did not",
}
ANOTHER_SIGMAS = 10.0
"""A place so far away is another optimum."""
WRONG_SIGMAS, WRONG_M = 10.0, 60.0
"""A fix is wrong if it is farther than both from the truth. Most cases have cells of 30 m."""


def explanation(
    beyond: set[str], frozen: Answer, now: Answer, evidence_tolerance: float, inputs_changed: bool
) -> Explanation | None:
    """The first that applies; None if nothing is beyond its tolerance. ``beyond``: names of the quantities that are."""
    if inputs_changed:
        return "inputs changed"
    if not beyond:
        return None
    if "status" in beyond:
        return "other status"
    if beyond & {"place", "crs"}:
        return _of_a_place(frozen, now, evidence_tolerance)
    if "sigma" in beyond:
        return "same place, other sigma"
    if beyond & {"probability", "elsewhere", "alternatives"}:
        return "same place, other probability"
    return "same place, other evidence" if "evidence" in beyond else "other details"


def _of_a_place(frozen: Answer, now: Answer, evidence_tolerance: float) -> Explanation:
    places = [
        (answer.easting_m, answer.northing_m)
        for answer in (frozen, now)
        if answer.easting_m is not None and answer.northing_m is not None
    ]
    if len(places) < 2 or not frozen.candidates or not now.candidates:
        return "place moved"
    before, after = places
    if same_spot(frozen.candidates[0], after, ANOTHER_SIGMAS):
        return "place moved"
    listed = any(same_spot(place, after, 3.0) for place in frozen.candidates[1:])
    if listed or any(same_spot(place, before, 3.0) for place in now.candidates[1:]):
        return "twin swap"
    more = (now.evidence or 0.0) - (frozen.evidence or 0.0)
    if abs(more) <= evidence_tolerance:
        return "another place, same evidence"
    return "another place, more evidence" if more > 0.0 else "another place, less evidence"


def same_spot(place: Candidate, other: Sequence[float], sigmas: float) -> bool:
    """Whether a position lies within so many of the place's own (larger) sigmas."""
    return bool(np.hypot(other[0] - place[0], other[1] - place[1]) <= sigmas * place[3])


def alarm(frozen: Sequence[Answer], now: Sequence[Answer]) -> str | None:
    """What must not be overlooked: a defect, or a fix far from the truth that was none."""
    for answer in now:
        if answer.status == "error":
            return f"defect: {answer.reason}"
    wrong = [answer for answer in now if is_wrong_fix(answer)]
    if wrong and not any(is_wrong_fix(answer) for answer in frozen):
        return f"a fix {wrong[0].off_m:.0f} m from the truth"
    return None


def is_wrong_fix(answer: Answer) -> bool:
    """Whether a fix is far from the truth, in metres and by its own covariance."""
    if answer.status != "fix" or answer.off_m is None or answer.covariance_m2 is None:
        return False
    east, _, north = answer.covariance_m2
    return answer.off_m > max(WRONG_SIGMAS * float(np.sqrt(east + north)), WRONG_M)
