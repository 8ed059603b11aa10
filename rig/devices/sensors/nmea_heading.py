"""Parsers of headings in NMEA 0183 sentences, Honeywell's PTNTHPR, and OceanServer's OHPR and factory format.

The fields are those of NMEA 0183 as gpsd's "NMEA Revealed" describes them, PTNTHPR of Honeywell's HMR3000 and True North's
compasses, OHPR and ``$C`` of OceanServer's OS5000. Raises ``NoReadingError`` where a whole sentence has no heading to trust.
"""

from collections.abc import Callable
from typing import Literal

from rig.clock import Instant
from rig.devices.readings import HeadingReading
from rig.devices.sensors.nmea_sentence import LETTERED, Sentence, step_of
from rig.errors import NoReadingError

COARSEST_DEG = 1.0
MAX_VARIATION_DEG = 90.0
"""A larger variation, real only near a magnetic pole, is a filler (999.9, 180); likewise a deviation."""

_CONTRADICTS = "the sentence contradicts itself: set the instrument to send HDG or HDM"


def parse_heading(sentence: Sentence, at: Instant) -> HeadingReading | None:
    """The heading in HDG, HDM, HDT, THS, PTNTHPR, OHPR or OceanServer's ``$C``; None for any other sentence."""
    parse = _HEADINGS.get(sentence.kind)
    return None if parse is None else parse(sentence, at)


def _heading(
    sentence: Sentence,
    at: Instant,
    reference: Literal["magnetic", "true"],
    *,
    text: str | None = None,
    deviation_deg: float = 0.0,
    variation_deg: float | None = None,
    pitch_deg: float | None = None,
    roll_deg: float | None = None,
    estimated: bool = False,
) -> HeadingReading:
    heading_deg = sentence.number(0) if text is None else float(text)
    if not 0.0 <= heading_deg <= 360.0:
        raise NoReadingError(
            f"{sentence.address} has the heading {heading_deg:g}, not 0 to 360 degrees",
            "wait until the instrument has a heading; check that it sends degrees",
        )
    if variation_deg is not None and abs(variation_deg) > MAX_VARIATION_DEG:
        variation_deg = None
    return HeadingReading(
        (heading_deg + deviation_deg) % 360.0,
        reference,
        variation_deg,
        pitch_deg,
        roll_deg,
        at.monotonic_s,
        at.utc,
        source=sentence.address,
        deviation_deg=deviation_deg,
        resolution_deg=min(step_of(sentence.field(0) if text is None else text), COARSEST_DEG),
        estimated=estimated,
    )


def _hdg(sentence: Sentence, at: Instant) -> HeadingReading:
    # Sensor heading, deviation E/W, variation E/W: magnetic = sensor + deviation, true = magnetic +
    # variation. Without its letter a variation is not known, but the heading is; a deviation is part of the heading.
    deviation_deg = _east(sentence, 1) or 0.0
    return _heading(
        sentence,
        at,
        "magnetic",
        deviation_deg=deviation_deg if abs(deviation_deg) <= MAX_VARIATION_DEG else 0.0,
        variation_deg=_east(sentence, 3) if sentence.field(4) else None,
    )


def _east(sentence: Sentence, index: int) -> float | None:
    """An angle and its E or W, east positive."""
    angle_deg = sentence.optional_number(index)
    if angle_deg is None or (angle_deg == 0.0 and not sentence.field(index + 1)):
        return angle_deg  # 0 is neither
    side = sentence.field(index + 1).upper()
    if side not in ("E", "W"):
        raise NoReadingError(f"{sentence.address} has {side!r} in field {index + 2} instead of E or W")
    return angle_deg if side == "E" else -angle_deg


def _hdm(sentence: Sentence, at: Instant) -> HeadingReading:
    _require_letter(sentence, "M")
    return _heading(sentence, at, "magnetic")


def _hdt(sentence: Sentence, at: Instant) -> HeadingReading:
    _require_letter(sentence, "T")
    return _heading(sentence, at, "true")


def _require_letter(sentence: Sentence, letter: str) -> None:
    """Reject HDT with M and HDM with T, which are ambiguous between true and magnetic."""
    said = sentence.field(1).upper()
    if said and said != letter:
        raise NoReadingError(f"{sentence.address} has {said!r} in field 2 instead of {letter}", _CONTRADICTS)


def _ths(sentence: Sentence, at: Instant) -> HeadingReading:
    mode = sentence.field(1)
    if mode not in ("A", "E"):  # autonomous, estimated; else manual, simulated or not valid
        raise NoReadingError(f"{sentence.address} has the mode {mode!r}: not a measured heading")
    return _heading(sentence, at, "true", estimated=mode == "E")


def _ptnthpr(sentence: Sentence, at: Instant) -> HeadingReading:
    for index, what in ((1, "heading"), (3, "pitch"), (5, "roll")):
        status = sentence.field(index)
        if status not in ("N", "M", "O"):  # normal, low or high warning; else alarm, or tuning
            raise NoReadingError(f"{sentence.address} has the {what} status {status!r}: not to be used")
    pitch_deg, roll_deg = sentence.number(2), sentence.number(4)
    return _heading(sentence, at, "magnetic", pitch_deg=pitch_deg, roll_deg=roll_deg)


def _ohpr(sentence: Sentence, at: Instant) -> HeadingReading:
    # The fields after azimuth, pitch and roll depend on the compass's settings and cannot be identified here.
    pitch_deg, roll_deg = sentence.number(1), sentence.number(2)
    return _heading(sentence, at, "magnetic", pitch_deg=pitch_deg, roll_deg=roll_deg)


def _lettered(sentence: Sentence, at: Instant) -> HeadingReading:
    # The letters depend on the compass's settings; E is the error code of PNI's compasses, which use the same
    # format.
    values = {
        field.rstrip("+-.0123456789"): field.lstrip("ABCDEFGHIJKLMNOPQRSTUVWXYZxyz")
        for field in sentence.fields
    }
    numbers = {letter: number(text) for letter, text in values.items()}
    if numbers.get("E"):
        raise NoReadingError(f"$C has the error code E{values['E']}: not to be used")
    if numbers["C"] is None:
        raise NoReadingError(f"$C has {values['C']!r} instead of a heading")
    return _heading(
        sentence, at, "magnetic", text=values["C"], pitch_deg=numbers.get("P"), roll_deg=numbers.get("R")
    )


def number(text: str) -> float | None:
    """A number of digits with at most one point; None for anything else."""
    try:
        return float(text)
    except ValueError:
        return None


_HEADINGS: dict[str, Callable[[Sentence, Instant], HeadingReading]] = {
    "HDG": _hdg,
    "HDM": _hdm,
    "HDT": _hdt,
    "THS": _ths,
    "PTNTHPR": _ptnthpr,
    "OHPR": _ohpr,
    LETTERED: _lettered,
}
HEADING_KINDS = frozenset(_HEADINGS)
