"""Parser of NMEA 0183 sentences: from a line to checked fields. No I/O.

A sentence starts with ``$``, or with ``!`` if it encapsulates something else (AIS); a tag block (NMEA 0183 4.0, section
7) may precede it. OceanServer's compasses (and PNI's) use another format by default: ``$C320.5P0.2R-18.3T19.0*3C``,
letters before numbers, no commas. Every function raises ``MessageError`` for an invalid line.
"""

import re
from collections.abc import Collection
from dataclasses import dataclass
from dataclasses import field as dataclass_field

from rig.errors import MessageError, NoChecksumError, NoReadingError

LETTERED = "$C"
"""The kind of the lettered format; each field is a letter with its number."""

_AFTER = bytes(range(0x21)) + b"\x7f\xff"
"""Bytes that terminals, modems and C strings append to a line."""
_BODY = rb"[\x20-\x23\x25-\x29\x2b-\x7e]*"
_SENTENCE = re.compile(rb"[$!](" + _BODY + rb")\*([0-9A-Fa-f]{1,2})")
_WITHOUT_CHECKSUM = re.compile(rb"\$([A-Z][A-Z0-9]{2,}," + _BODY + rb"|C[+-]?\d[^,*]*)\*?")
_LETTERED_BODY = re.compile(r"C[+-]?[\d.]+([A-Z][a-z]*[+-]?[\d.]+)+")
_LETTERED_FIELD = re.compile(r"[A-Z][a-z]*[+-]?[\d.]+")
_NUMBER = re.compile(r"[+-]?(\d{1,9}\.?\d{0,12}|\.\d{1,12})")
_WITHOUT_TALKER = ("OHPR",)
_COMPLETE = {
    "HDG": 5,
    "HDM": 2,
    "HDT": 2,
    "THS": 2,
    "PTNTHPR": 6,
    "OHPR": 3,
    "MDA": 4,
    "MMB": 4,
    "VTG": 4,
    "RMC": 8,
    LETTERED: 2,
}
"""Least number of fields, required if no checksum proves completeness."""


@dataclass(frozen=True)
class Sentence:
    """A sentence: its address ("HCHDG"), its kind ("HDG") and its fields.

    ``has_checksum``: whether a valid checksum came with it.
    """

    address: str
    kind: str
    fields: tuple[str, ...]
    has_checksum: bool = dataclass_field(default=True, compare=False)

    def field(self, index: int) -> str:
        """A field, stripped; "" if the sentence is too short."""
        return self.fields[index].strip() if index < len(self.fields) else ""

    def number(self, index: int) -> float:
        """A required number. ``NoReadingError`` if the field is none."""
        number = self.optional_number(index)
        if number is None:
            raise NoReadingError(f"{self.address} has no value in field {index + 1} now")
        return number

    def optional_number(self, index: int) -> float | None:
        """An optional number, None if empty. ``NoReadingError`` if the field is no number."""
        text = self.field(index)
        if not text:
            return None
        if not _NUMBER.fullmatch(text):
            raise NoReadingError(f"{self.address} has {text!r} in field {index + 1} instead of a number")
        return float(text)

    def number_if_any(self, index: int) -> float | None:
        """A number, or None for anything else."""
        text = self.field(index)
        return float(text) if _NUMBER.fullmatch(text) else None

    def resolution(self, index: int) -> float:
        """Resolution of a number: one unit of its last non-zero digit, as trailing zeros may be fillers.

        Never finer than the digits sent; for 0, exactly these.
        """
        return step_of(self.field(index))


def step_of(text: str) -> float:
    """One unit of the last digit that is not 0: 0.01 for ``0.97`` and ``0.9700``, 100 for ``99900``; of 0, its last digit's."""
    written = text.lstrip("+-")
    whole, _, decimals = written.partition(".")
    if not (whole + decimals).strip("0"):
        return float(10.0 ** -len(decimals))
    if decimals.rstrip("0"):
        return float(10.0 ** -len(decimals.rstrip("0")))
    return float(10.0 ** (len(whole) - len(whole.rstrip("0"))))


def checksum(body: bytes) -> int:
    """XOR of the characters between $ and *."""
    result = 0
    for byte in body:
        result ^= byte
    return result


def parse_sentence(line: bytes, *, require_checksum: bool = True) -> Sentence:
    """The sentence in a line, after any garbage or tag block, and before trailing zeros and the like.

    Raises ``MessageError`` for a damaged one, and ``NoChecksumError`` for one without a required checksum. Without a
    checksum all fields of its kind must be present.
    """
    text = line[_start(line) :].strip(_AFTER)
    match = _SENTENCE.fullmatch(text)
    if match is None or (len(match[2]) == 1 and checksum(match[1]) != int(match[2], 16)):
        if _WITHOUT_CHECKSUM.fullmatch(text):
            return _parse_without_checksum(text, require_checksum)
        raise MessageError(f"{shown(text)} is no NMEA sentence with a checksum")
    body, sent = match[1], int(match[2], 16)
    if checksum(body) != sent:
        raise MessageError(f"{shown(text)} has the checksum {checksum(body):02X}")
    return _fields(body, has_checksum=True)


def _start(line: bytes) -> int:
    """Start of the last sentence: at the last $; at the last ! if there is no $."""
    dollar = line.rfind(b"$")
    return dollar if dollar >= 0 else max(line.rfind(b"!"), 0)


def _parse_without_checksum(text: bytes, require_checksum: bool) -> Sentence:
    if require_checksum:
        raise NoChecksumError(f"{shown(text)} is no NMEA sentence with a checksum: it ends without one")
    sentence = _fields(text[1:].removesuffix(b"*"), has_checksum=False)
    short = len(sentence.fields) < _COMPLETE.get(sentence.kind, 0)
    torn = sentence.kind == "XDR" and len(sentence.fields) % 4
    cut = sentence.kind in ("HDM", "HDT", "THS") and not sentence.field(1)
    if short or torn or cut:
        raise MessageError(f"{shown(text)} has no checksum and is not complete")
    return sentence


def _fields(body: bytes, *, has_checksum: bool) -> Sentence:
    text = body.decode("ascii")
    if _LETTERED_BODY.fullmatch(text):
        return Sentence("C", LETTERED, tuple(_LETTERED_FIELD.findall(text)), has_checksum)
    address, *fields = text.split(",")
    # A proprietary sentence has no talker: the last letters of Garmin's PGRMC are no RMC.
    whole = address in _WITHOUT_TALKER or address.startswith("P")
    return Sentence(address, address if whole else address[2:], tuple(fields), has_checksum)


class SentenceReader:
    """``parse_sentence`` for successive lines of one port, for a listener interested in some ``kinds`` of sentences.

    A talker that sent a checksum once always does: a missing one is then damage. Other kinds do not matter.
    """

    def __init__(self, kinds: Collection[str], *, require_checksum: bool = True) -> None:
        self._kinds = kinds
        self._require = require_checksum
        self._sealed: set[str] = set()

    def __call__(self, line: bytes) -> Sentence:
        """The sentence in a line. Raises as ``parse_sentence`` does."""
        try:
            sentence = parse_sentence(line, require_checksum=self._require)
        except NoChecksumError as problem:
            sentence = parse_sentence(line, require_checksum=False)
            if sentence.address in self._sealed:
                raise MessageError(str(problem)) from problem
            if sentence.kind in self._kinds:
                raise
        if sentence.has_checksum:
            self._sealed.add(sentence.address)
        elif sentence.address in self._sealed:
            raise MessageError(f"{shown(line)} has lost its checksum")
        return sentence


def shown(text: bytes) -> str:
    """The beginning of a line, for a message."""
    return repr(text[:82].decode("ascii", "replace"))
