"""Correction of an accelerometer: zero error, scale, temperature drift and mounting.

A stationary chip measures ``zero + drift * (T - T0) + scale * (R^T up)`` in the head's axes: zero error and temperature
drift per axis, scale error per axis, and the small mounting rotation R.
"""

import math
from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Triple = tuple[float, float, float]


class AccelerometerKeys(Protocol):
    """The keys of [inclinometer] that correct readings."""

    @property
    def zero_mg(self) -> Triple: ...
    @property
    def scale(self) -> Triple: ...
    @property
    def mounting_deg(self) -> Triple: ...
    @property
    def drift_mg_c(self) -> Triple: ...
    @property
    def zero_temperature_c(self) -> float: ...


@dataclass(frozen=True)
class AccelerometerCorrection:
    """``mounting_deg`` is a rotation vector (right, forward, up) from the chip's measured axes to the head's axes."""

    zero_mg: Triple = (0.0, 0.0, 0.0)
    scale: Triple = (1.0, 1.0, 1.0)
    mounting_deg: Triple = (0.0, 0.0, 0.0)
    drift_mg_c: Triple = (0.0, 0.0, 0.0)
    zero_temperature_c: float = 20.0

    @classmethod
    def from_section(cls, section: AccelerometerKeys) -> "AccelerometerCorrection":
        """The correction of a configuration."""
        return cls(
            section.zero_mg,
            section.scale,
            section.mounting_deg,
            section.drift_mg_c,
            section.zero_temperature_c,
        )

    def up_in_head(self, measured_g: Vector, temperature_c: float) -> Vector:
        """Corrected vectors (n, 3) in the head's axes. A NaN z (two-axis chip) is replaced so that the length is 1 g.

        If the two axes alone reach 1 g or more, z stays NaN: that is not gravity.
        """
        warmer_c = temperature_c - self.zero_temperature_c
        if not math.isfinite(warmer_c):  # a chip without a thermometer
            warmer_c = 0.0
        zero_g = (np.array(self.zero_mg) + np.array(self.drift_mg_c) * warmer_c) / 1000.0
        vectors = (np.asarray(measured_g, float) - zero_g) / np.array(self.scale)
        two_axes = np.isnan(vectors[:, 2])
        left = 1.0 - vectors[two_axes, 0] ** 2 - vectors[two_axes, 1] ** 2
        vectors[two_axes, 2] = np.sqrt(np.where(left > 0.0, left, np.nan))
        turn = cv2.Rodrigues(np.radians(self.mounting_deg))[0]
        return np.asarray(vectors @ turn.T)


NO_CORRECTION = AccelerometerCorrection()
