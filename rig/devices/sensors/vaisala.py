"""Parser of Vaisala's PA50 barometer message. No I/O.

    SOH P STX 1 p p3h a3h p1 p2 p3 err ETX checksum

Pressure, tendency, the three transducers, and an error code; a missing value is stars or a slash. The checksum is the
sum of all bytes from SOH to ETX, modulo 256, in hexadecimal.
"""

import re

from rig.clock import Instant
from rig.devices.readings import PressureReading
from rig.devices.sensors.nmea import pressure_reading
from rig.errors import MessageError, NoReadingError

SOH = b"\x01"

_MESSAGE = re.compile(rb"(\x01P\x021([^\x01-\x1f\x7f-\xff]*)\x03)([0-9A-Fa-f]{2})")
_FIELDS = 7
_NUMBER = re.compile(rb"\d{1,5}\.\d+")
_NO_ERROR = b"000"


def parse_pa50(line: bytes, at: Instant) -> PressureReading:
    """The pressure in one line. Raises ``MessageError`` if it is no PA50, damaged, or reports an error."""
    text = line[max(line.rfind(SOH), 0) :].rstrip(b"\r\n\x00")
    match = _MESSAGE.fullmatch(text)
    if match is None:
        raise MessageError(f"{text[:82]!r} is no PA50 message")
    if sum(match[1]) % 256 != int(match[3], 16):
        raise MessageError(
            f"a PA50 message has the checksum {sum(match[1]) % 256:02X}, not {match[3].decode()}"
        )
    fields = match[2].split()
    if len(fields) != _FIELDS:
        raise MessageError(f"a PA50 message has {len(fields)} values instead of {_FIELDS}")
    pressure, error = fields[0], fields[-1]
    if error != _NO_ERROR:
        raise NoReadingError(
            f"the barometer reports the error {error.decode()}", "look its error code up in its manual"
        )
    if not _NUMBER.fullmatch(pressure):
        raise NoReadingError(f"a PA50 message has {pressure.decode()!r} instead of a pressure")
    step_hpa = 10.0 ** -len(pressure.partition(b".")[2])
    return pressure_reading(float(pressure), None, at, resolution_hpa=step_hpa, source="PA50")
