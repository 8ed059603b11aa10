"""Sensor readings: values in the chip's or talker's own axes, with both times of the measurement.

``monotonic_s`` is for ages and order, ``utc`` for records; they are not interchangeable, as the wall clock may step.
"""

from dataclasses import dataclass
from datetime import datetime
from typing import Literal


@dataclass(frozen=True)
class AccelerationReading:
    """Specific force along the chip's axes: at rest +1 g along the axis that points up.

    Attributes
    ----------
    x_g, y_g : float
        Along the chip's own axes, g.
    z_g : float or None
        None of an inclinometer of two axes.
    temperature_c : float
        Of the chip.
    monotonic_s : float
        When, on ``time.monotonic``'s clock.
    utc : datetime
        When, by the wall clock.
    """

    x_g: float
    y_g: float
    z_g: float | None
    temperature_c: float
    monotonic_s: float
    utc: datetime


@dataclass(frozen=True)
class FieldReading:
    """Magnetic field along the chip's axes, free of the sensor's offset, which is kept for diagnosis.

    Attributes
    ----------
    x_ut, y_ut, z_ut : float
        Along the chip's own axes, µT.
    offset_ut : tuple of float
        The sensor's own zero along the three axes, µT.
    temperature_c : float or None
        None where the chip does not tell it: nothing is derived from it.
    monotonic_s : float
        When, on ``time.monotonic``'s clock.
    utc : datetime
        When, by the wall clock.
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
    """What a compass talker says: where its lubber line points.

    Attributes
    ----------
    heading_deg : float
        Clockwise from ``reference``.
    reference : {"magnetic", "true"}
        The north that it counts from.
    variation_deg : float or None
        The magnetic variation that the talker itself sends, east positive; None where it sends none.
    pitch_deg, roll_deg : float or None
        As the talker defines them; None where it does not send them.
    monotonic_s : float
        When, on ``time.monotonic``'s clock.
    utc : datetime
        When, by the wall clock.
    source : str
        The sentence's address: ``"HCHDG"``.
    deviation_deg : float
        What the talker says of its own deviation; it is in the heading already.
    resolution_deg : float
        One unit of the last digit that it sends.
    estimated : bool
        Whether it is a heading by dead reckoning.
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
    """Air pressure where the sensor is.

    Attributes
    ----------
    pressure_hpa : float
        Not reduced to sea level.
    temperature_c : float or None
        Of the chip, or what the talker says; None where it says nothing.
    monotonic_s : float
        When, on ``time.monotonic``'s clock.
    utc : datetime
        When, by the wall clock.
    resolution_hpa : float
        One unit of the last digit that a talker sends.
    source : str
        The talker's sentence and transducer.
    remark : str or None
        What was put right in it.
    """

    pressure_hpa: float
    temperature_c: float | None
    monotonic_s: float
    utc: datetime
    resolution_hpa: float = 0.0
    source: str = ""
    remark: str | None = None
