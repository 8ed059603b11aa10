"""What a case gives to the search, and numbers by which one sees whether it is still the same.

The numbers are sums with fixed weights. They stand in units of a change that counts (a millimetre of height, a thousandth of a
pixel), so that the last bits, in which machines differ, change nothing, and other noise changes much.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from frozen_answers.ground import Ground
from localizer import Bundle, Movement, Observation, frame_image

HEIGHT_M = 1e-3
ROW_PX = 1e-3
READING = 1e-5
GREY = 1e-2
NO_READING = -1e4
TOLERANCE = 1.0


@dataclass(frozen=True)
class Look:
    """One measurement. ``movement``: since the one before it, of a drive. ``truth``: longitude and latitude of the camera."""

    measurement: Bundle | Observation
    truth: tuple[float, float] | None = None
    movement: Movement | None = None


@dataclass(frozen=True)
class Question:
    """A DEM, and what is looked for in it: one look, or those of a drive."""

    ground: Ground
    looks: tuple[Look, ...]
    drive: bool = False


@dataclass(frozen=True)
class Fingerprint:
    """``text``: digest of what is exact, as names and cell sizes; ``numbers``: of what is computed."""

    text: str
    numbers: tuple[float, ...]

    def differs_from(self, other: "Fingerprint") -> bool:
        """Whether more than last bits differ."""
        if self.text != other.text or len(self.numbers) != len(other.numbers):
            return True
        return bool((np.abs(np.subtract(self.numbers, other.numbers)) > TOLERANCE).any())


def fingerprint(question: Question) -> Fingerprint:
    """Of everything that a question consists of, before the localizer has touched it."""
    numbers: list[float] = []
    for grid in question.ground.grids:
        numbers += _numbers(grid.height_m, HEIGHT_M)
    for look in question.looks:
        numbers += _numbers_of_a_look(look)
    exact = f"{question.ground.text} {len(question.looks)} {question.drive}"
    digest = hashlib.sha256(exact.encode()).hexdigest()[:8]
    return Fingerprint(digest, tuple(round(number, 1) for number in numbers))


def _numbers(values: ArrayLike, unit: float) -> list[float]:
    """How many there are, their mean, and their sum with weights of mean square 1 over the root of their number."""
    x = np.asarray(values, np.float64).ravel()
    known = np.isfinite(x)
    if not known.any():
        return [float(known.sum()), 0.0, 0.0]
    filled = np.where(known, x, 0.0)
    weighted = float(filled @ _weights(x.size)) / np.sqrt(x.size)
    return [float(known.sum()), float(filled.sum()) / float(known.sum()) / unit, weighted / unit]


def _weights(count: int) -> NDArray[np.float64]:
    """Uniform in +-sqrt(3). The generator's raw output is the same in all versions of NumPy."""
    raw = np.random.PCG64(15).random_raw(count)
    return np.asarray(np.sqrt(12.0) * (np.asarray(raw, np.float64) / 2.0**64 - 0.5))


def _numbers_of_a_look(look: Look) -> list[float]:
    measured = look.measurement
    numbers: list[float] = []
    readings: list[float | None] = []
    if isinstance(measured, Bundle):
        altitude = measured.altitude
        readings += [altitude.value_m, altitude.sigma_m] if altitude else [None, None]
        pictures = [frame_image(measured, frame).ravel() for frame in measured.frames]
        numbers += _numbers(np.concatenate(pictures), GREY)
    else:
        readings += [measured.altitude_m, measured.altitude_sigma_m]
        numbers += _numbers(np.concatenate([frame.u_px for frame in measured.frames]), ROW_PX)
        numbers += _numbers(np.concatenate([frame.v_px for frame in measured.frames]), ROW_PX)
        readings += [float(np.sum(frame.sigma_px)) for frame in measured.frames]
    for shot in measured.frames:
        readings += [shot.azimuth_deg, shot.tilt_deg, shot.roll_deg]
        readings += [shot.azimuth_sigma_deg, shot.tilt_sigma_deg, shot.roll_sigma_deg]
    readings += [measured.mast_height_m, measured.azimuth_bias_sigma_deg, measured.tilt_bias_sigma_deg]
    if measured.prior is not None:
        readings += [measured.prior.lat_deg, measured.prior.lon_deg, measured.prior.radius_m]
    if look.movement is not None:
        readings += [*look.movement.step_m, *np.ravel(look.movement.covariance_m2)]
    return [*numbers, *_numbers(_finite(readings), READING)]


def _finite(readings: Sequence[float | None]) -> list[float]:
    return [
        float(value) if value is not None and np.isfinite(value) else NO_READING + i
        for i, value in enumerate(readings)
    ]
