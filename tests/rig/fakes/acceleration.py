"""Samples of an accelerometer, in numbers that a test chooses."""

from dataclasses import dataclass

STRAIGHT = ("+x", "+y", "+z")
"""Axes of a chip that is mounted as the head's."""


@dataclass(frozen=True)
class Sample:
    x_g: float
    y_g: float
    z_g: float | None
    temperature_c: float = 20.0
