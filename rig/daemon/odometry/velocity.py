"""Velocity from NMEA 0183 sentences: VTG and RMC to speed and course, or to nothing if they are not valid.

Validity follows from the mode indicator (NMEA 0183 2.3) and RMC's status. RMC's navigational status (4.1) is ignored:
u-blox receivers always send V there.
"""

from dataclasses import dataclass

from rig.devices.sensors.nmea import Sentence
from rig.errors import MessageError, NoReadingError

KNOT_M_S = 1852.0 / 3600.0
KMH_M_S = 1.0 / 3.6
SLOW_M_S = 0.1
"""Up to this speed a course is meaningless and may be missing."""
FASTEST_M_S = 150.0
UNITS_AGREE_M_S, UNITS_AGREE_SHARE = 0.3, 0.03
STALE_S = 2.0

_MEASURED_MODES = ("A", "D", "F", "P", "R")  # autonomous, differential, RTK float, precise, RTK fixed
_ESTIMATED_MODE = "E"  # by dead reckoning
_VALID_STATUS = ("A", "D")  # Unicore receivers say D where the position is differential
_NOT_TO_BE_USED = ("U", "N", "M")  # of the navigational status: unsafe; not valid and manual, as some have it


@dataclass(frozen=True)
class Velocity:
    """Speed over ground and true course; None if the course was not sent."""

    speed_m_s: float
    course_deg: float | None


def velocity_in(sentence: Sentence, *, accept_estimated: bool = False) -> Velocity | None:
    """The velocity in a VTG or RMC; None for other sentences and for speeds that were not measured.

    Not valid, manual and simulated speeds give None; estimated ones too unless ``accept_estimated``. ``MessageError``
    for inconsistent content.
    """
    if sentence.kind == "VTG":
        speed_m_s, course_deg, mode = _vtg(sentence)
    elif sentence.kind == "RMC":
        if sentence.field(1) not in _VALID_STATUS or sentence.field(12) in _NOT_TO_BE_USED:
            return None
        knots, course_deg = sentence.optional_number(6), sentence.optional_number(7)
        speed_m_s = None if knots is None else knots * KNOT_M_S
        mode = sentence.field(11)
    else:
        return None
    if speed_m_s is None or not _is_measured(mode, accept_estimated):
        return None
    if course_deg is None and speed_m_s <= SLOW_M_S:
        course_deg = 0.0
    if not 0.0 <= speed_m_s <= FASTEST_M_S or not 0.0 <= (course_deg or 0.0) <= 360.0:
        raise MessageError(f"{sentence.address} says {speed_m_s:.1f} m/s towards {course_deg} deg")
    return Velocity(speed_m_s, course_deg)


def _is_measured(mode: str, accept_estimated: bool) -> bool:
    """Sentences before NMEA 0183 2.3 have no mode."""
    return mode in ("", *_MEASURED_MODES) or (mode == _ESTIMATED_MODE and accept_estimated)


def _vtg(sentence: Sentence) -> tuple[float | None, float | None, str]:
    """Speed, true course and mode. The oldest form has four numbers and no letters."""
    letters = [sentence.field(index).upper() for index in (1, 3, 5, 7)]
    if len(sentence.fields) == 4 and not any(letter.isalpha() for letter in letters):
        course_deg, _, knots, kmh = (sentence.optional_number(index) for index in range(4))
        return _speed_m_s(sentence, knots, kmh), course_deg, ""
    if any(letter not in ("", wanted) for letter, wanted in zip(letters, "TMNK", strict=True)):
        raise NoReadingError(f"{sentence.address} has {letters} where T, M, N and K belong")
    knots, kmh = sentence.optional_number(4), sentence.optional_number(6)
    return _speed_m_s(sentence, knots, kmh), sentence.optional_number(0), sentence.field(8)


def _speed_m_s(sentence: Sentence, knots: float | None, kmh: float | None) -> float | None:
    """The speed from knots or km/h; they must agree if both are sent."""
    speeds_m_s = [value * unit for value, unit in ((kmh, KMH_M_S), (knots, KNOT_M_S)) if value is not None]
    if len(speeds_m_s) == 2 and abs(
        speeds_m_s[0] - speeds_m_s[1]
    ) > UNITS_AGREE_M_S + UNITS_AGREE_SHARE * max(speeds_m_s):
        raise NoReadingError(f"{sentence.address} says {knots} knots and {kmh} km/h, which do not agree")
    return speeds_m_s[0] if speeds_m_s else None


class StaleClock:
    """Detects a receiver that repeats the same time: its speed is then stale.

    A talker whose time has never changed has no clock, and is not stale for that reason.
    """

    def __init__(self) -> None:
        self._said: dict[str, tuple[str, float, bool]] = {}

    def is_stale(self, sentence: Sentence, at_s: float) -> bool:
        """Whether an RMC received at ``at_s`` (monotonic) has repeated its time for too long."""
        time_text = sentence.field(0)
        if sentence.kind != "RMC" or not time_text:
            return False
        before = self._said.get(sentence.address)
        if before is None or before[0] != time_text:
            self._said[sentence.address] = time_text, at_s, before is not None
            return False
        _, since_s, has_moved = before
        return has_moved and at_s - since_s > STALE_S
