"""What the sensors give: values in the chip's or talker's own axes, with the two times of the measurement.

``monotonic_s`` is for ages and order, ``utc`` for the record; neither can stand in for the other, because the
wall clock of a vehicle computer may step.
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
    """Magnetic field along the chip's axes, µT, free of the sensor's offset, which is kept for diagnosis.

    ``temperature_c`` is None where the chip does not tell it: nothing is derived from it.
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
    """What a compass talker says: where its lubber line points, clockwise from magnetic or true north.

    ``variation_deg`` is the magnetic variation that the talker itself sends, east positive; pitch and roll
    as the talker defines them. Each is None where it is not sent. ``source`` is the sentence's address ("HCHDG"),
    ``deviation_deg`` what the talker says of its own deviation and is in the heading already, ``resolution_deg`` one
    unit of the last digit that it sends; ``estimated`` is a heading by dead reckoning.
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
    """Air pressure where the sensor is; ``temperature_c`` is the chip's own or the talker's, None where not
    sent. ``resolution_hpa`` is one unit of the last digit that a talker sends, ``source`` its sentence and transducer,
    ``remark`` what was put right in it.
    """

    pressure_hpa: float
    temperature_c: float | None
    monotonic_s: float
    utc: datetime
    resolution_hpa: float = 0.0
    source: str = ""
    remark: str | None = None
