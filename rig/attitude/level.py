"""From accelerometer readings to tilt and roll of the head, and to the attitude of the base.

A stationary accelerometer measures +1 g along the axis that points up. In the head frame (x right, y forward, z up):
tilt = asin(y), roll = atan2(-x, z).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from rig.attitude.accelerometer import NO_CORRECTION, AccelerometerCorrection
from rig.attitude.kinematics import Attitude, JointAngles, body_attitude, head_rotation
from rig.errors import DeviceError

Vector = NDArray[np.float64]

# Enough groups for a median that is robust against a gust or a slammed door, few enough that each averages
# well.
MEDIAN_GROUPS = 9
MEDIAN_EFFICIENCY = 1.2533  # standard error of a median in those of a mean, for normal errors
PLAUSIBLE_G = (0.9, 1.1)
MISFIT_LIMIT_DEG = 0.5
ITERATIONS = 6
DERIVATIVE_STEP_DEG = 1e-4


class Acceleration(Protocol):
    """One sample in chip axes, g; ``z_g`` is None for a two-axis chip."""

    @property
    def x_g(self) -> float: ...
    @property
    def y_g(self) -> float: ...
    @property
    def z_g(self) -> float | None: ...
    @property
    def temperature_c(self) -> float: ...


@dataclass(frozen=True)
class HeadLevel:
    """Tilt and roll of the head from the inclinometer, averaged over some seconds.

    ``mean_g`` is the uncorrected average in head axes; tilt and roll are corrected. The noise is that of the average,
    from the scatter.
    """

    mean_g: tuple[float, float, float]
    tilt_deg: float
    roll_deg: float
    tilt_noise_deg: float
    roll_noise_deg: float
    samples: int
    temperature_c: float | None = None


@dataclass(frozen=True)
class LevelReading:
    """Tilt and roll read at one position of the joints."""

    joints: JointAngles
    level: HeadLevel


@dataclass(frozen=True)
class LevelSigmas:
    """Prior sigmas: noise of a reading, zero error of the inclinometer, and tilt joint."""

    tilt_deg: float
    roll_deg: float
    zero_deg: float
    joint_deg: float


@dataclass(frozen=True)
class BaseLevel:
    """Attitude of the base, and the zero error of the inclinometer (to be subtracted from its readings).

    ``residual_deg`` is the rms residual of the roll readings, which no joint error affects.
    """

    pitch_deg: float
    roll_deg: float
    tilt_zero_deg: float
    tilt_zero_sigma_deg: float
    roll_zero_deg: float
    roll_zero_sigma_deg: float
    sigma_deg: float
    residual_deg: float

    def attitude(self, heading_deg: float) -> Attitude:
        """Attitude of the base for a given heading."""
        return Attitude(heading_deg, self.pitch_deg, self.roll_deg)


def in_axes(chip: Vector, axes: Sequence[str]) -> Vector:
    """Chip vectors (..., 3) in the frame whose x, y, z are these signed chip axes: ``["+y", "-x", "+z"]``."""
    columns = ["xyz".index(axis[1]) for axis in axes]
    signs = np.array([-1.0 if axis[0] == "-" else 1.0 for axis in axes])
    return np.asarray(chip[..., columns] * signs)


def head_level(
    samples: Sequence[Acceleration],
    axes: Sequence[str],
    device: str,
    correction: AccelerometerCorrection = NO_CORRECTION,
) -> HeadLevel:
    """Average of accelerometer samples, robust against a few taken while the mast was shaken.

    For a two-axis chip z follows from a length of 1 g. ``DeviceError`` if that cannot be gravity, or if a temperature
    drift is configured and the temperature (NaN) is unknown.
    """
    chip = np.array([[s.x_g, s.y_g, np.nan if s.z_g is None else s.z_g] for s in samples], float)
    told_c = [s.temperature_c for s in samples if math.isfinite(s.temperature_c)]
    temperature_c = float(np.mean(told_c)) if told_c else math.nan
    if not told_c and any(correction.drift_mg_c):
        raise DeviceError(
            device,
            "does not tell its temperature, and [inclinometer] drift_mg_c needs it",
            "power-cycle it; replace it if that does not help",
        )
    measured = in_axes(chip, axes)
    head = correction.up_in_head(measured, temperature_c)
    uncorrected = NO_CORRECTION.up_in_head(measured, temperature_c)
    if np.isnan(head).any() or np.isnan(uncorrected).any():
        raise _not_gravity(device, float(np.hypot(measured[:, 0], measured[:, 1]).max()))
    means = _means(head)
    vector = np.median(means, axis=0)
    size = float(np.linalg.norm(vector))
    if not PLAUSIBLE_G[0] <= size <= PLAUSIBLE_G[1]:
        raise _not_gravity(device, size)
    tilts, rolls = tilt_roll_deg(means)
    x_g, y_g, z_g = (float(v) for v in np.median(_means(uncorrected), axis=0))
    tilt_deg, roll_deg = tilt_roll_deg(vector)
    noise_of = MEDIAN_EFFICIENCY / np.sqrt(len(means))
    return HeadLevel(
        (x_g, y_g, z_g),
        float(tilt_deg),
        float(roll_deg),
        float(tilts.std(ddof=1) * noise_of) if len(means) > 1 else np.inf,
        float(rolls.std(ddof=1) * noise_of) if len(means) > 1 else np.inf,
        len(head),
        temperature_c if math.isfinite(temperature_c) else None,
    )


def _means(vectors: Vector) -> Vector:
    return np.array(
        [group.mean(axis=0) for group in np.array_split(vectors, min(MEDIAN_GROUPS, len(vectors)))]
    )


def tilt_roll_deg(up: Vector) -> tuple[Vector, Vector]:
    """Tilt and roll of a head in whose axes up is ``up`` (..., 3), of any length."""
    x, y, z = up[..., 0], up[..., 1], up[..., 2]
    return np.degrees(np.arcsin(y / np.linalg.norm(up, axis=-1))), np.degrees(np.arctan2(-x, z))


def base_level(readings: Sequence[LevelReading], sigmas: LevelSigmas) -> BaseLevel:
    """Attitude of the base and zero error of the inclinometer from readings at several pan angles.

    Turning the pan rotates the base's slope in head axes, while the zero error stays fixed to the head: this separates
    them. A zero error in tilt cannot be separated from an error of the tilt joint (zero tick, backlash): the two share
    it according to their sigmas. A zero error in roll is measured directly. ``DeviceError`` if no single attitude fits
    the readings. (Least squares.)
    """
    measured = np.array([[r.level.tilt_deg, r.level.roll_deg] for r in readings])
    reading_sigmas = np.array([np.hypot(sigmas.tilt_deg, sigmas.joint_deg), sigmas.roll_deg])
    prior_sigmas = np.array([sigmas.zero_deg, sigmas.zero_deg, sigmas.joint_deg])

    def predicted(pitch_deg: float, roll_deg: float, joint_deg: float) -> Vector:
        base = Attitude(0.0, pitch_deg, roll_deg)
        joints = [JointAngles(r.joints.pan_deg, r.joints.tilt_deg + joint_deg) for r in readings]
        heads = [body_attitude(head_rotation(base, each)) for each in joints]
        return np.array([[head.tilt_deg, head.roll_deg] for head in heads])

    def misfit(unknowns: Vector) -> Vector:
        pitch_deg, roll_deg, tilt_zero_deg, roll_zero_deg, joint_deg = unknowns
        zero_deg = np.array([tilt_zero_deg, roll_zero_deg])
        expected = predicted(pitch_deg, roll_deg, joint_deg) + zero_deg
        return np.hstack([((measured - expected) / reading_sigmas).ravel(), unknowns[2:] / prior_sigmas])

    solution, covariance = _least_squares(misfit, np.zeros(5))
    pitch_deg, roll_deg, tilt_zero_deg, roll_zero_deg, joint_deg = (float(v) for v in solution)
    deviations = np.sqrt(np.diag(covariance))
    off = measured - predicted(pitch_deg, roll_deg, joint_deg) - [tilt_zero_deg, roll_zero_deg]
    if np.abs(off).max() > max(MISFIT_LIMIT_DEG, 5.0 * reading_sigmas.max()):
        raise DeviceError(
            "inclinometer",
            f"its readings at {len(readings)} pan angles fit no one attitude of the vehicle "
            f"({np.abs(off).max():.1f} deg apart)",
            "measure while the vehicle stands still; if it does, check [inclinometer] axes and "
            "[pan_tilt.pan] zero_tick, direction",
        )
    return BaseLevel(
        pitch_deg,
        roll_deg,
        tilt_zero_deg,
        float(deviations[2]),
        roll_zero_deg,
        float(deviations[3]),
        float(np.hypot(*deviations[:2])),
        float(np.sqrt(np.mean(off[:, 1] ** 2))),
    )


def _least_squares(misfit: Callable[[Vector], Vector], start: Vector) -> tuple[Vector, Vector]:
    """Minimum of the sum of squares of ``misfit`` and the covariance there (Gauss-Newton).

    For nearly linear problems, such as angles of a few degrees.
    """
    at = start
    for _ in range(ITERATIONS):
        here = misfit(at)
        steps = np.eye(len(at)) * DERIVATIVE_STEP_DEG
        jacobian = np.column_stack([(misfit(at + step) - here) / DERIVATIVE_STEP_DEG for step in steps])
        at = at - np.linalg.lstsq(jacobian, here, rcond=None)[0]
    return at, np.asarray(np.linalg.inv(jacobian.T @ jacobian), float)


def _not_gravity(device: str, size_g: float) -> DeviceError:
    return DeviceError(
        device,
        f"measures {size_g:.3f} g where gravity is 1 g",
        "keep the vehicle still, and check the chip's range and [inclinometer] chip, axes",
    )
