"""True headings from compass talkers: which north, variation and deviation are believed, and which sentence.

A talker's fields may be wrong. They are checked against the World Magnetic Model at [place], the other sentences of the
same talker, and the change of a real deviation with the pan angle.
"""

import itertools
import math
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from typing import Protocol

import numpy as np

from rig.attitude.declination import Declination, declination
from rig.attitude.heading import HeadingsAtPan, circular_mean_deg
from rig.attitude.kinematics import wrapped_deg
from rig.config.sections import NmeaCompassSection, Place
from rig.devices.readings import HeadingReading
from rig.errors import DeviceError
from rig.fault_notes import collecting, note_fault

SAME_DEVIATION_DEG = 0.15
MIN_VARIATION_DEG = 1.0
"""A smaller variation in the wrong field does no significant harm and cannot be distinguished from a deviation."""
SOURCES_AGREE_DEG = 5.0
NORTHS_AGREE_DEG = 2.0
SAME_HEADING_DEG = 0.5
APART_DEG = 3.0
"""Change of a compass's deviation from one pan angle to another; a slope of the vehicle changes a heading by as much."""
ESTIMATED_SIGMA_DEG = 5.0
MUCH_FINER = 1.5


class PanAngle(Protocol):
    @property
    def pan_deg(self) -> float: ...


class ReadStop(Protocol):
    """The part of a stop of the head that is used here."""

    @property
    def joints(self) -> PanAngle: ...
    @property
    def headings(self) -> tuple[HeadingReading, ...]: ...
    @property
    def utc(self) -> datetime: ...


@dataclass(frozen=True)
class TrueHeadings:
    """True headings at each pan angle; ``declination`` if the talker's headings were magnetic.

    ``sigma_deg`` is common to all: resolution, error of the declination, and dead reckoning.
    """

    at_pans: list[HeadingsAtPan]
    declination: Declination | None
    sigma_deg: float


def true_headings(
    stops: Sequence[ReadStop], section: NmeaCompassSection, place: Place | None
) -> TrueHeadings:
    """The true headings from what the talker sent.

    ``ConfigError`` if they are magnetic and there is no declination, ``DeviceError`` if two sentences disagree.
    """
    read = [stop for stop in stops if stop.headings]
    raw = [list(stop.headings) for stop in read]
    raw = _without_misplaced_variation(raw, section, place, read[0].utc)
    used = _declinations(raw, section, place, read[0].utc)
    pans_deg = [stop.joints.pan_deg for stop in read]
    raw = _without_false_north(raw, pans_deg, used)
    _require_agreement(_means(raw, pans_deg, lambda each: _true_deg(each, used)))
    raw = _finest(raw)
    at_pans = [
        HeadingsAtPan(stop.joints.pan_deg, tuple(_true_deg(each, used) for each in headings))
        for stop, headings in zip(read, raw, strict=True)
        if headings
    ]
    left = [each for headings in raw for each in headings]
    north = next((used[each.variation_deg] for each in left if each.reference == "magnetic"), None)
    if north:
        north.note()
    estimated = any(each.estimated for each in left)
    if estimated:
        note_fault(
            "compass", "its heading is estimated (dead reckoning)", f"{ESTIMATED_SIGMA_DEG:g} deg of sigma"
        )
    step_deg = min(each.resolution_deg for each in left)
    sigma_deg = math.hypot(
        step_deg / math.sqrt(12.0),
        north.sigma_deg if north else 0.0,
        ESTIMATED_SIGMA_DEG if estimated else 0.0,
    )
    return TrueHeadings(at_pans, north, sigma_deg)


@dataclass(frozen=True)
class _SingleStop:
    """The readings at the present pan angle only."""

    headings: tuple[HeadingReading, ...]
    utc: datetime
    pan_deg: float = 0.0

    @property
    def joints(self) -> PanAngle:
        return self


def heading_notes(
    headings: Sequence[HeadingReading], section: NmeaCompassSection, place: Place | None
) -> list[str]:
    """The notes that a capture would make about such headings, "PROBLEM: ACTION" each. Raises as ``true_headings``
    does.
    """
    with collecting() as faults:
        true_headings([_SingleStop(tuple(headings), headings[-1].utc)], section, place)
    return [f"{note.problem}: {note.action}" for note in faults.all() if note.device == "compass"]


def _true_deg(reading: HeadingReading, used: Mapping[float | None, Declination]) -> float:
    if reading.reference == "true":
        return reading.heading_deg
    return (reading.heading_deg + used[reading.variation_deg].declination_deg) % 360.0


def _declinations(
    raw: Sequence[Sequence[HeadingReading]], section: NmeaCompassSection, place: Place | None, when: datetime
) -> dict[float | None, Declination]:
    """The declination for each variation that is sent. True headings need none."""
    sent = {each.variation_deg for headings in raw for each in headings if each.reference == "magnetic"}
    known = next((each for each in sorted(filter(None, sent))), None)
    # HDM and HDG come from the same compass: HDG has the variation that HDM lacks.
    return {
        each: declination(section.declination_deg, known if each is None else each, place, when)
        for each in sent
    }


def _by_source(headings: Sequence[HeadingReading]) -> dict[str, list[HeadingReading]]:
    found: dict[str, list[HeadingReading]] = defaultdict(list)
    for each in headings:
        found[each.source].append(each)
    return found


def _without_misplaced_variation(
    raw: list[list[HeadingReading]], section: NmeaCompassSection, place: Place | None, when: datetime
) -> list[list[HeadingReading]]:
    """Remove a deviation field that holds the variation: it would be added twice.

    A real deviation varies as sine and cosine of the heading. One that is constant over all pan angles and equals the
    declination is in the wrong field.
    """
    found = [each for headings in raw for each in headings if each.deviation_deg]
    if len(raw) < 2 or not found:
        return raw
    deviations = [each.deviation_deg for each in found]
    deviation_deg = sum(deviations) / len(deviations)
    everywhere = all(
        each.deviation_deg for headings in raw for each in headings if each.source == found[0].source
    )
    if np.ptp(deviations) > SAME_DEVIATION_DEG or abs(deviation_deg) < MIN_VARIATION_DEG or not everywhere:
        return raw
    twice = all(each.variation_deg == each.deviation_deg for each in found)
    known_deg = section.declination_deg
    if known_deg is None and place is not None:
        known_deg = declination(None, None, place, when).declination_deg
    near = known_deg is not None and abs(wrapped_deg(deviation_deg - known_deg)) <= min(
        NORTHS_AGREE_DEG, max(0.5, 0.15 * abs(known_deg))
    )
    if not (twice or near):
        return raw
    note_fault(
        "compass",
        f"sends the variation {deviation_deg:.1f} deg as its deviation",
        "added once, as the variation",
    )

    def corrected(reading: HeadingReading) -> HeadingReading:
        if not reading.deviation_deg:
            return reading
        heading_deg = (reading.heading_deg - reading.deviation_deg) % 360.0
        variation_deg = reading.variation_deg or reading.deviation_deg
        return replace(reading, heading_deg=heading_deg, deviation_deg=0.0, variation_deg=variation_deg)

    return [[corrected(each) for each in headings] for headings in raw]


def _without_false_north(
    raw: list[list[HeadingReading]], pans_deg: Sequence[float], used: Mapping[float | None, Declination]
) -> list[list[HeadingReading]]:
    """Drop "true" headings that equal the magnetic ones of the same talker, or differ by a wrong variation."""
    false: set[str] = set()
    norths = {each.source: each for headings in raw for each in headings}
    means = _means(raw, pans_deg, lambda each: each.heading_deg)
    for true_source, source in itertools.product(norths, norths):
        if (norths[true_source].reference, norths[source].reference) != ("true", "magnetic"):
            continue
        turned = _heading_difference(means, true_source, source)
        if turned is None or true_source[:2] != source[:2]:
            continue
        north_deg = used[norths[source].variation_deg].declination_deg
        is_same = abs(turned.by_deg) <= SAME_HEADING_DEG + turned.loose_deg
        agree_deg = (MIN_VARIATION_DEG if is_same else NORTHS_AGREE_DEG) + turned.loose_deg
        if abs(wrapped_deg(turned.by_deg - north_deg)) <= agree_deg:
            continue
        what = (
            f"sends its magnetic heading as a true one, in {true_source}"
            if is_same
            else f"is {turned.by_deg:.1f} deg from magnetic to true in {true_source}, {north_deg:.1f} are right"
        )
        note_fault("compass", what, f"{source} is used")
        false.add(true_source)
    return [[each for each in headings if each.source not in false] for headings in raw]


@dataclass(frozen=True)
class _HeadingDifference:
    """Mean difference of two sources, and its uncertainty."""

    by_deg: float
    loose_deg: float


def _means(
    raw: Sequence[Sequence[HeadingReading]],
    pans_deg: Sequence[float],
    value: Callable[[HeadingReading], float],
) -> list[tuple[float, dict[str, float]]]:
    """Each pan angle with the mean of each source there."""
    return [
        (
            pan_deg,
            {
                source: circular_mean_deg([value(each) for each in some])
                for source, some in _by_source(headings).items()
            },
        )
        for pan_deg, headings in zip(pans_deg, raw, strict=True)
    ]


def _heading_difference(
    means: Sequence[tuple[float, Mapping[str, float]]], source: str, other: str
) -> _HeadingDifference | None:
    """Over the stops that have both. If none has both (slow talkers take turns), from the heading of the bow that each
    implies.
    """
    together = [here[source] - here[other] for _, here in means if source in here and other in here]
    if together:
        return _HeadingDifference(wrapped_deg(circular_mean_deg(together)), 0.0)
    of_bow = [[here[name] - pan_deg for pan_deg, here in means if name in here] for name in (source, other)]
    if not all(of_bow):
        return None
    return _HeadingDifference(
        wrapped_deg(circular_mean_deg(of_bow[0]) - circular_mean_deg(of_bow[1])), APART_DEG
    )


def _require_agreement(means: Sequence[tuple[float, Mapping[str, float]]]) -> None:
    """Raise ``DeviceError`` if two sources differ by more than two compasses on one mast do."""
    sources = sorted({source for _, here in means for source in here})
    for first, second in itertools.combinations(sources, 2):
        ahead = _heading_difference(means, second, first)
        if ahead and abs(ahead.by_deg) > SOURCES_AGREE_DEG + ahead.loose_deg:
            raise DeviceError(
                "compass",
                f"its sources do not agree: {second} is {ahead.by_deg:.1f} deg off {first}",
                "choose one with [compass] sentence, and look at what is near the other",
            )


def _finest(raw: list[list[HeadingReading]]) -> list[list[HeadingReading]]:
    """Drop sources with a much coarser resolution than the finest: averaging them in makes it worse."""
    steps: dict[str, float] = {}
    for headings in raw:
        for each in headings:
            steps[each.source] = min(steps.get(each.source, math.inf), each.resolution_deg)
    best = min(steps.values())
    fine = {source for source, step in steps.items() if step <= MUCH_FINER * best}
    return [[each for each in headings if each.source in fine] for headings in raw]
