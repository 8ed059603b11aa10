"""Headings of talkers as true ones: whose claim about north, variation and deviation holds, and which sentence is believed.

A talker's fields are claims. The rig knows better: the World Magnetic Model at [place], the other sentences of the same talker,
and that a compass's deviation changes as the head turns.
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
LEAST_VARIATION_DEG = 1.0
"""A smaller one in the wrong field does no harm that matters, and cannot be told from a deviation."""
SOURCES_AGREE_DEG = 5.0
NORTHS_AGREE_DEG = 2.0
SAME_HEADING_DEG = 0.5
APART_DEG = 3.0
"""A compass's deviation changes by so much from one pan angle to another, and the vehicle's slope turns a heading by it."""
ESTIMATED_SIGMA_DEG = 5.0
MUCH_FINER = 1.5


class PanAngle(Protocol):
    @property
    def pan_deg(self) -> float: ...


class ReadStop(Protocol):
    """A stop of the head, as far as it matters here."""

    @property
    def joints(self) -> PanAngle: ...
    @property
    def headings(self) -> tuple[HeadingReading, ...]: ...
    @property
    def utc(self) -> datetime: ...


@dataclass(frozen=True)
class TrueHeadings:
    """Headings from true north at each pan angle; ``declination`` where they were magnetic.

    ``sigma_deg`` is common to all: resolution, what the declination may be off, and dead reckoning.
    """

    at_pans: list[HeadingsAtPan]
    declination: Declination | None
    sigma_deg: float


def true_headings(
    stops: Sequence[ReadStop], section: NmeaCompassSection, place: Place | None
) -> TrueHeadings:
    """What the talker's headings come to.

    ``ConfigError`` where they are magnetic and there is no declination, ``DeviceError`` where two sentences do not agree.
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
class _Here:
    """One stop, without turning the head."""

    headings: tuple[HeadingReading, ...]
    utc: datetime
    pan_deg: float = 0.0

    @property
    def joints(self) -> PanAngle:
        return self


def heading_doubts(
    headings: Sequence[HeadingReading], section: NmeaCompassSection, place: Place | None
) -> list[str]:
    """What a capture would note about such headings, "PROBLEM: ACTION" each. Raises as ``true_headings`` does."""
    with collecting() as faults:
        true_headings([_Here(tuple(headings), headings[-1].utc)], section, place)
    return [f"{note.problem}: {note.action}" for note in faults.all() if note.device == "compass"]


def _true_deg(reading: HeadingReading, used: Mapping[float | None, Declination]) -> float:
    if reading.reference == "true":
        return reading.heading_deg
    return (reading.heading_deg + used[reading.variation_deg].declination_deg) % 360.0


def _declinations(
    raw: Sequence[Sequence[HeadingReading]], section: NmeaCompassSection, place: Place | None, when: datetime
) -> dict[float | None, Declination]:
    """For each variation that is sent. A true heading needs none."""
    sent = {each.variation_deg for headings in raw for each in headings if each.reference == "magnetic"}
    known = next((each for each in sorted(filter(None, sent))), None)
    # HDM beside HDG is of the same compass: what the one leaves out, the other says.
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
    """A deviation that is the variation is no deviation, and would be added twice.

    A compass's deviation goes as sine and cosine of its heading: one that stays the same all around the pan, and is just what
    the declination is, stands in the wrong field.
    """
    found = [each for headings in raw for each in headings if each.deviation_deg]
    if len(raw) < 2 or not found:
        return raw
    deviations = [each.deviation_deg for each in found]
    deviation_deg = sum(deviations) / len(deviations)
    everywhere = all(
        each.deviation_deg for headings in raw for each in headings if each.source == found[0].source
    )
    if np.ptp(deviations) > SAME_DEVIATION_DEG or abs(deviation_deg) < LEAST_VARIATION_DEG or not everywhere:
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

    def mended(reading: HeadingReading) -> HeadingReading:
        if not reading.deviation_deg:
            return reading
        heading_deg = (reading.heading_deg - reading.deviation_deg) % 360.0
        variation_deg = reading.variation_deg or reading.deviation_deg
        return replace(reading, heading_deg=heading_deg, deviation_deg=0.0, variation_deg=variation_deg)

    return [[mended(each) for each in headings] for headings in raw]


def _without_false_north(
    raw: list[list[HeadingReading]], pans_deg: Sequence[float], used: Mapping[float | None, Declination]
) -> list[list[HeadingReading]]:
    """Without the true headings of a talker that also sends magnetic ones, where they are the same, or by another variation."""
    false: set[str] = set()
    norths = {each.source: each for headings in raw for each in headings}
    means = _means(raw, pans_deg, lambda each: each.heading_deg)
    for true_source, source in itertools.product(norths, norths):
        if (norths[true_source].reference, norths[source].reference) != ("true", "magnetic"):
            continue
        turned = _ahead(means, true_source, source)
        if turned is None or true_source[:2] != source[:2]:
            continue
        north_deg = used[norths[source].variation_deg].declination_deg
        is_same = abs(turned.by_deg) <= SAME_HEADING_DEG + turned.loose_deg
        agree_deg = (LEAST_VARIATION_DEG if is_same else NORTHS_AGREE_DEG) + turned.loose_deg
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
class _Ahead:
    """By how much one source is ahead of another, and how loosely that is known."""

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


def _ahead(means: Sequence[tuple[float, Mapping[str, float]]], source: str, other: str) -> _Ahead | None:
    """On the mean of the stops that have both; where none has, as slow talkers take turns, of what each says of the bow."""
    together = [here[source] - here[other] for _, here in means if source in here and other in here]
    if together:
        return _Ahead(wrapped_deg(circular_mean_deg(together)), 0.0)
    of_bow = [[here[name] - pan_deg for pan_deg, here in means if name in here] for name in (source, other)]
    if not all(of_bow):
        return None
    return _Ahead(wrapped_deg(circular_mean_deg(of_bow[0]) - circular_mean_deg(of_bow[1])), APART_DEG)


def _require_agreement(means: Sequence[tuple[float, Mapping[str, float]]]) -> None:
    """Raise ``DeviceError`` where two sources differ by more than compasses beside each other do."""
    sources = sorted({source for _, here in means for source in here})
    for first, second in itertools.combinations(sources, 2):
        ahead = _ahead(means, second, first)
        if ahead and abs(ahead.by_deg) > SOURCES_AGREE_DEG + ahead.loose_deg:
            raise DeviceError(
                "compass",
                f"its sources do not agree: {second} is {ahead.by_deg:.1f} deg off {first}",
                "choose one with [compass] sentence, and look at what is near the other",
            )


def _finest(raw: list[list[HeadingReading]]) -> list[list[HeadingReading]]:
    """Without sources that are much coarser than the finest one: a mean of both is no better than the coarse one."""
    steps: dict[str, float] = {}
    for headings in raw:
        for each in headings:
            steps[each.source] = min(steps.get(each.source, math.inf), each.resolution_deg)
    best = min(steps.values())
    fine = {source for source, step in steps.items() if step <= MUCH_FINER * best}
    return [[each for each in headings if each.source in fine] for headings in raw]
