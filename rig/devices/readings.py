"""Sensor readings: values in the chip's or talker's own axes, with both times of the measurement.

``monotonic_s`` is for ages and order, ``utc`` for records; they are not interchangeable, as the wall clock may step.
"""

from dataclasses import dataclass
from datetime import datetime
from typing import Literal


@dataclass(frozen=True)
class AccelerationReading:
    """Specific force along the chip's axes, g: at rest +1 along the axis that points up.

    ``z_g`` is None for a two-axis inclinometer.
    """

    x_g: float
    y_g: float
    z_g: float | None
    temperature_c: float
    monotonic_s: float
    utc: datetime


@dataclass(frozen=True)
class FieldReading:
    """Magnetic field along the chip's axes, µT, without the sensor's offset, which is kept for diagnosis.

    ``temperature_c`` is None if the chip does not report it; nothing depends on it.
    """

    x_ut: float
    y_ut: float
    z_ut: float
    offset_ut: tuple[float, float, float]
    temperature_c: float | None
    monotonic_s: float
    utc: datetime


@dataclass(frozen=True)
class HeadingReading:
    """A compass talker's heading of its lubber line, clockwise from magnetic or true north.

    ``variation_deg`` is the magnetic variation sent by the talker, east positive; pitch and roll as the talker defines
    them. Each is None if not sent. ``source`` is the sentence's address ("HCHDG"), ``deviation_deg`` the sent
    deviation, already included in the heading, ``resolution_deg`` one unit of the last digit; ``estimated`` marks dead
    reckoning.
    """

    heading_deg: float
    reference: Literal["magnetic", "true"]
    variation_deg: float | None
    pitch_deg: float | None
    roll_deg: float | None
    monotonic_s: float
    utc: datetime
    source: str = ""
    deviation_deg: float = 0.0
    resolution_deg: float = 0.0
    estimated: bool = False


@dataclass(frozen=True)
class PressureReading:
    """Air pressure at the sensor; ``temperature_c`` is the chip's or the talker's, None if not sent. ``resolution_hpa``
    is one unit of a talker's last digit, ``source`` its sentence and transducer, ``remark`` a correction that was
    applied.
    """

    pressure_hpa: float
    temperature_c: float | None
    monotonic_s: float
    utc: datetime
    resolution_hpa: float = 0.0
    source: str = ""
    remark: str | None = None
