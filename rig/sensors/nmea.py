"""NMEA 0183 sentences of compasses and barometers: bytes to readings, no port involved.

The fields are those of NMEA 0183 as gpsd's "NMEA Revealed" describes them, PTNTHPR of Honeywell's HMR3000
and True North's compasses, OHPR of OceanServer's OS5000. Every function here raises ``MessageError`` for
what it cannot trust.
"""

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from rig.errors import MessageError
from rig.readings import HeadingReading, Instant, PressureReading

_SENTENCE = re.compile(rb"\$([\x20-\x23\x25-\x29\x2b-\x7e]*)\*([0-9A-Fa-f]{2})")
_NUMBER = re.compile(r"[+-]?(\d{1,9}\.?\d{0,12}|\.\d{1,12})")
_WITHOUT_TALKER = ("PTNTHPR", "OHPR")

_HPA_PER_INHG = 33.86389
_HPA_PER_UNIT = {"B": 1000.0, "P": 0.01, "H": 1.0}  # bar, pascal, and hPa as Vaisala writes it


@dataclass(frozen=True)
class Sentence:
    """A sentence whose checksum is right: its address ("HCHDG"), its kind ("HDG") and its fields."""

    address: str
    kind: str
    fields: tuple[str, ...]

    def field(self, index: int) -> str:
        """A field without blanks around it, "" where the sentence is too short."""
        return self.fields[index].strip() if index < len(self.fields) else ""

    def number(self, index: int) -> float:
        """A field that must be there and be a number."""
        number = self.optional_number(index)
        if number is None:
            raise MessageError(f"{self.address} has no value in field {index + 1}")
        return number

    def optional_number(self, index: int) -> float | None:
        """A field that may be empty, but else must be a number."""
        text = self.field(index)
        if not text:
            return None
        if not _NUMBER.fullmatch(text):
            raise MessageError(f"{self.address} has {text!r} in field {index + 1} instead of a number")
        return float(text)


def checksum(body: bytes) -> int:
    """XOR of the characters between $ and *."""
    result = 0
    for byte in body:
        result ^= byte
    return result


def parse_sentence(line: bytes) -> Sentence:
    """The sentence in a line, after whatever garbage precedes its $."""
    text = line[max(line.rfind(b"$"), 0) :].rstrip()
    match = _SENTENCE.fullmatch(text)
    if match is None:
        raise MessageError(f"{_shown(text)} is no NMEA sentence with a checksum")
    body, sent = match[1], int(match[2], 16)
    if checksum(body) != sent:
        raise MessageError(f"{_shown(text)} has the checksum {checksum(body):02X}")
    address, *fields = body.decode("ascii").split(",")
    return Sentence(address, address if address in _WITHOUT_TALKER else address[2:], tuple(fields))


def parse_heading(sentence: Sentence, at: Instant) -> HeadingReading | None:
    """The heading in HDG, HDM, HDT, THS, PTNTHPR or OHPR; None for any other sentence."""
    parse = _HEADINGS.get(sentence.kind)
    return None if parse is None else parse(sentence, at)


def _heading(
    sentence: Sentence,
    at: Instant,
    reference: Literal["magnetic", "true"],
    deviation_deg: float = 0.0,
    variation_deg: float | None = None,
    pitch_deg: float | None = None,
    roll_deg: float | None = None,
) -> HeadingReading:
    heading_deg = sentence.number(0)
    if not 0.0 <= heading_deg <= 360.0:
        raise MessageError(f"{sentence.address} has the heading {heading_deg:g}, not 0 to 360 degrees")
    heading_deg = (heading_deg + deviation_deg) % 360.0
    return HeadingReading(heading_deg, reference, variation_deg, pitch_deg, roll_deg, at.monotonic_s, at.utc)


def _hdg(sentence: Sentence, at: Instant) -> HeadingReading:
    # Sensor heading, deviation E/W, variation E/W: magnetic = sensor + deviation, true = magnetic +
    # variation.
    return _heading(sentence, at, "magnetic", _east(sentence, 1) or 0.0, _east(sentence, 3))


def _east(sentence: Sentence, index: int) -> float | None:
    """An angle and its E or W, east positive."""
    angle_deg = sentence.optional_number(index)
    if angle_deg is None:
        return None
    side = sentence.field(index + 1)
    if side not in ("E", "W"):
        raise MessageError(f"{sentence.address} has {side!r} in field {index + 2} instead of E or W")
    return angle_deg if side == "E" else -angle_deg


def _hdm(sentence: Sentence, at: Instant) -> HeadingReading:
    return _heading(sentence, at, "magnetic")


def _hdt(sentence: Sentence, at: Instant) -> HeadingReading:
    return _heading(sentence, at, "true")


def _ths(sentence: Sentence, at: Instant) -> HeadingReading:
    mode = sentence.field(1)
    if mode not in ("A", "E"):  # autonomous, estimated; else manual, simulated or not valid
        raise MessageError(f"{sentence.address} has the mode {mode!r}: not a measured heading")
    return _heading(sentence, at, "true")


def _ptnthpr(sentence: Sentence, at: Instant) -> HeadingReading:
    for index, what in ((1, "heading"), (3, "pitch"), (5, "roll")):
        status = sentence.field(index)
        if status not in ("N", "M", "O"):  # normal, low or high warning; else alarm, or tuning
            raise MessageError(f"{sentence.address} has the {what} status {status!r}: not to be used")
    pitch_deg, roll_deg = sentence.number(2), sentence.number(4)
    return _heading(sentence, at, "magnetic", pitch_deg=pitch_deg, roll_deg=roll_deg)


def _ohpr(sentence: Sentence, at: Instant) -> HeadingReading:
    # Which fields follow azimuth, pitch and roll is a setting of the compass: they cannot be told apart here.
    pitch_deg, roll_deg = sentence.number(1), sentence.number(2)
    return _heading(sentence, at, "magnetic", pitch_deg=pitch_deg, roll_deg=roll_deg)


_HEADINGS: dict[str, Callable[[Sentence, Instant], HeadingReading]] = {
    "HDG": _hdg,
    "HDM": _hdm,
    "HDT": _hdt,
    "THS": _ths,
    "PTNTHPR": _ptnthpr,
    "OHPR": _ohpr,
}


def parse_pressure(sentence: Sentence, at: Instant) -> PressureReading | None:
    """The air pressure in XDR or MDA; None for any other sentence, and for an XDR of other transducers."""
    match sentence.kind:
        case "XDR":
            return _xdr(sentence, at)
        case "MDA":
            return _mda(sentence, at)
    return None


def _xdr(sentence: Sentence, at: Instant) -> PressureReading | None:
    pressure_hpa = temperature_c = None
    for group in range(0, len(sentence.fields), 4):  # type, value, unit, name
        kind, unit = sentence.field(group), sentence.field(group + 2)
        if kind == "P" and unit in _HPA_PER_UNIT:
            pressure_hpa = sentence.number(group + 1) * _HPA_PER_UNIT[unit]
        elif kind == "C" and unit == "C":
            temperature_c = sentence.optional_number(group + 1)
    return None if pressure_hpa is None else pressure_reading(pressure_hpa, temperature_c, at)


def _mda(sentence: Sentence, at: Instant) -> PressureReading:
    place, hpa_per_unit = (2, _HPA_PER_UNIT["B"]) if sentence.field(2) else (0, _HPA_PER_INHG)
    return pressure_reading(sentence.number(place) * hpa_per_unit, sentence.optional_number(4), at)


def pressure_reading(pressure_hpa: float, temperature_c: float | None, at: Instant) -> PressureReading:
    """A reading, unless the pressure is none that there is on land."""
    if not (math.isfinite(pressure_hpa) and 300.0 <= pressure_hpa <= 1250.0):
        raise MessageError(f"{pressure_hpa:g} hPa is no air pressure")
    return PressureReading(pressure_hpa, temperature_c, at.monotonic_s, at.utc)


def _shown(text: bytes) -> str:
    return repr(text[:82].decode("ascii", "replace"))
