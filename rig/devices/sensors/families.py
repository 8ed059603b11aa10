"""Recognises other serial protocols by their first bytes, for messages about what is received instead."""

import contextlib
import re

from rig.devices.sensors.nmea_sentence import parse_sentence
from rig.errors import MessageError

USUAL_BAUDS = (4800, 9600, 38400, 19200, 115200, 57600)
MIN_TEXT_SHARE = 0.8

_FAMILIES: tuple[tuple[bytes, str], ...] = (
    (rb"\xb5\x62", "u-blox UBX"),
    (rb"\xa0\xa2", "SiRF binary"),
    (rb"\xaa\x44[\x12\x13\x1c]", "NovAtel binary"),
    (rb"\xd3[\x00-\x03].", "RTCM 3"),
    (rb"\xff\xff\xfd\x00", "Dynamixel protocol 2"),
    (rb"\x10\x02\x93", "NMEA 2000 by an Actisense gateway"),
    (rb"[\xfd\xfe].{5,}", "MAVLink"),
    (rb"\x01P\x021", "Vaisala PA50"),
    (rb"\$PCDIN,", "NMEA 2000 by a SeaSmart gateway"),
    (rb"\s*[{\[]\s*[\"{\[]", "JSON"),
    (rb"\s*[+-]?\d+(\.\d+)?([ ,;\t]+[+-]?\d+(\.\d+)?)*\s*", "plain numbers"),
)
_PATTERNS = [(re.compile(pattern, re.DOTALL), name) for pattern, name in _FAMILIES]
_WHOLE = "plain numbers"
_TEXT = frozenset(range(0x20, 0x7F)) | set(b"\t\r\n\x00\x01\x02\x03")


def family_of(data: bytes) -> str | None:
    """The usual name of the protocol of a line or of the beginning of a stream; None if it is not recognised."""
    for pattern, name in _PATTERNS:
        if pattern.fullmatch(data) if name == _WHOLE else pattern.match(data):
            return name
    return None


def is_text(data: bytes) -> bool:
    """Whether most bytes are printable, as they are at the correct baud rate."""
    return sum(byte in _TEXT for byte in data) >= MIN_TEXT_SHARE * len(data)


def other_format(line: bytes) -> str | None:
    """The kind of a line that is neither a sentence nor a damaged one: another protocol, or other text; else None."""
    family = family_of(line)
    if family:
        return f"{family}: {line[:40]!r}"
    with contextlib.suppress(MessageError):
        return f"NMEA 0183: {parse_sentence(line).address}"
    with contextlib.suppress(MessageError):
        address = parse_sentence(bytes(byte & 0x7F for byte in line)).address
        return f"{address} with parity bits: 8 data bits without parity are needed"
    if len(line) >= 3 and _is_readable(line) and not set(line) & set(b"$*!\\"):
        return f"text that is no NMEA: {line[:40]!r}"
    return None


def _is_readable(line: bytes) -> bool:
    """Whether all of it is printable, including UTF-8 such as degree signs."""
    try:
        return line.decode("utf-8").replace("\t", " ").isprintable()
    except UnicodeDecodeError:
        return False


def baud_advice(baud: int, noise: bytes) -> str:
    """What to do about damaged lines; if they are no text at all, the baud rates to try."""
    advice = "check `baud` and the cable"
    if not noise or is_text(noise):
        return advice
    others = ", ".join(str(usual) for usual in USUAL_BAUDS if usual != baud)
    return f"{advice}: so it looks at another rate than the talker's; {baud} is set, usual are {others}"
