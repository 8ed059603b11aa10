"""Heading of the base, from a magnetometer or a compass talker on the pan stage, read at several pan angles.

Turning the pan separates what turns with the compass (hard iron of the pan stage, deviation of a talker) from the
Earth's field. Iron fixed to the vehicle cannot be separated; ``azimuth_bias_sigma_deg`` covers it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.attitude.accelerometer import Triple
from rig.attitude.declination import Declination
from rig.attitude.kinematics import body_rotation, pan_stage_rotation
from rig.attitude.level import BaseLevel
from rig.errors import DeviceError

Vector = NDArray[np.float64]

PLAUSIBLE_FIELD_UT = (15.0, 100.0)  # the Earth's is 22 to 67; iron nearby bends and scales it
MIN_HORIZONTAL_UT = 2.0  # below it, near the magnetic poles, a compass points nowhere
TALKER_MISFIT_LIMIT_DEG = 20.0
ANGLES_FOR_DEVIATION = 4
SAME_PAN_DEG = 0.2
"""Readings within this angle share the pan encoder's error (two ticks): they count as one."""


@dataclass(frozen=True)
class FieldAtPan:
    """Mean field (3,) at one pan angle, uT, in the axes of the pan stage (x right, y forward, z up), and the noise of
    the mean.
    """

    pan_deg: float
    mean_ut: Vector
    noise_ut: float


@dataclass(frozen=True)
class VehicleIron:
    """Iron of the vehicle: the field in base axes is ``soft`` @ B + ``hard_ut`` for an Earth's field B."""

    hard_ut: Triple = (0.0, 0.0, 0.0)
    soft: tuple[Triple, Triple, Triple] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))

    def removed(self, field_ut: Vector) -> Vector:
        """The Earth's field (3,) from the field measured in the base."""
        return np.asarray(np.linalg.solve(np.array(self.soft), field_ut - np.array(self.hard_ut)))


NO_IRON = VehicleIron()


@dataclass(frozen=True)
class HeadingsAtPan:
    """Headings of the pan stage at one pan angle, as sent by a talker, degrees."""

    pan_deg: float
    headings_deg: tuple[float, ...]


@dataclass(frozen=True)
class CompassHeading:
    """Heading of the base from the compass's own north, and its consistency.

    ``misfit_deg`` is the rms residual of the readings at the pan angles from the common solution.
    """

    heading_deg: float
    scatter_deg: float
    misfit_deg: float


@dataclass(frozen=True)
class MagnetometerHeading(CompassHeading):
    """Heading from a magnetometer, with the horizontal field of the pan stage and the Earth's field, uT."""

    stage_field_ut: tuple[float, float]
    horizontal_ut: float
    down_ut: float


@dataclass(frozen=True)
class TrueHeading:
    """Heading of the base from true north; ``declination`` is None if the compass gives true headings."""

    heading_deg: float
    sigma_deg: float
    declination: Declination | None


def heading_from_field(
    fields: Sequence[FieldAtPan], level: BaseLevel, vehicle: VehicleIron = NO_IRON
) -> MagnetometerHeading:
    """Heading from a magnetometer on the pan stage, tilt-compensated by the base's level.

    In stage axes the field is Rz(pan) B + c, with B the Earth's field in base axes and c that of the pan stage. Both
    are linear, so one least-squares solution gives the x and y of both. The vertical part of c stays unknown and enters
    multiplied by the slope of the base. The ``vehicle``'s iron is then removed from B. ``DeviceError`` if the field
    cannot be the Earth's.
    """
    means = np.array([field.mean_ut for field in fields])
    measured = means[:, :2].ravel()
    design = np.vstack([_stage_rows(field.pan_deg) for field in fields])
    solution, *_ = np.linalg.lstsq(design, measured, rcond=None)
    pans = distinct_pans([field.pan_deg for field in fields])
    misfit_ut = _deviation(measured - design @ solution, 2 * pans - 4)
    noise_ut = max(field.noise_ut for field in fields)
    variances = np.diag(np.linalg.inv(design.T @ design)) * max(misfit_ut, noise_ut) ** 2

    in_base = vehicle.removed(np.array([solution[0], solution[1], means[:, 2].mean()]))
    east, north, up = (float(v) for v in body_rotation(level.attitude(0.0)) @ in_base)
    horizontal_ut = math.hypot(east, north)
    total_ut = math.hypot(horizontal_ut, up)
    if not PLAUSIBLE_FIELD_UT[0] <= total_ut <= PLAUSIBLE_FIELD_UT[1] or horizontal_ut < MIN_HORIZONTAL_UT:
        raise DeviceError(
            "compass",
            f"measures {total_ut:.1f} uT, {horizontal_ut:.1f} of it horizontal: not the Earth's field",
            "check [compass] axes and hard_iron_ut, and what iron or magnets are near",
        )
    by_noise_deg = math.degrees(math.sqrt(variances[:2].mean()) / horizontal_ut)
    # A level error rotates part of the vertical field into the horizontal plane.
    by_level_deg = level.sigma_deg * abs(up) / horizontal_ut
    return MagnetometerHeading(
        # In axes that are level and have the base's heading, magnetic north lies at minus that heading.
        math.degrees(math.atan2(-east, north)) % 360.0,
        math.hypot(by_noise_deg, by_level_deg),
        math.degrees(misfit_ut / horizontal_ut),
        (float(solution[2]), float(solution[3])),
        horizontal_ut,
        -up,
    )


def heading_from_talker(readings: Sequence[HeadingsAtPan], level: BaseLevel) -> CompassHeading:
    """Heading from a tilt-compensated compass that sends the heading of its lubber line.

    With four or more pan angles the deviation (sine and cosine of the heading) is solved for; with fewer the headings
    are averaged. ``DeviceError`` if the headings do not follow the pan.
    """
    stage_deg = np.array([circular_mean_deg(reading.headings_deg) for reading in readings])
    ahead_deg = np.array([_azimuth_ahead_deg(level, reading.pan_deg) for reading in readings])
    middle_deg = circular_mean_deg(stage_deg - ahead_deg)
    off_deg = _wrapped(stage_deg - ahead_deg - middle_deg)
    if np.abs(off_deg).max() > TALKER_MISFIT_LIMIT_DEG:
        raise DeviceError(
            "compass",
            f"its headings do not turn with the pan ({np.abs(off_deg).max():.0f} deg off)",
            "check that it sits on the pan stage and is calibrated, and [pan_tilt.pan] direction",
        )
    pans = distinct_pans([reading.pan_deg for reading in readings])
    columns = [np.ones(len(off_deg))]
    if pans >= ANGLES_FOR_DEVIATION:
        columns += [np.sin(np.radians(stage_deg)), np.cos(np.radians(stage_deg))]
    design = np.column_stack(columns)
    solution, *_ = np.linalg.lstsq(design, off_deg, rcond=None)
    misfit_deg = _deviation(off_deg - design @ solution, pans - len(columns))
    noise_deg = max(_noise_of_mean_deg(reading.headings_deg) for reading in readings)
    variance = float(np.linalg.inv(design.T @ design)[0, 0]) * max(misfit_deg, noise_deg) ** 2
    return CompassHeading((middle_deg + float(solution[0])) % 360.0, math.sqrt(variance), misfit_deg)


def true_heading(
    heading: CompassHeading, bias_sigma_deg: float, declination: Declination | None
) -> TrueHeading:
    """True heading; its sigma combines the configured sigma of the compass and the observed scatter."""
    to_true_deg = declination.declination_deg if declination else 0.0
    sigma_deg = min(math.hypot(bias_sigma_deg, heading.scatter_deg), 180.0)
    return TrueHeading((heading.heading_deg + to_true_deg) % 360.0, sigma_deg, declination)


def distinct_pans(pans_deg: Sequence[float]) -> int:
    """Number of distinct angles (more than ``SAME_PAN_DEG`` above the one before)."""
    return 1 + int(np.count_nonzero(np.diff(np.sort(pans_deg)) > SAME_PAN_DEG))


def circular_mean_deg(angles_deg: Sequence[float] | Vector) -> float:
    """Mean direction, 0 to 360."""
    angles = np.radians(np.asarray(angles_deg, float))
    return math.degrees(math.atan2(np.sin(angles).mean(), np.cos(angles).mean())) % 360.0


def _stage_rows(pan_deg: float) -> Vector:
    """Rows of x and y in stage axes for the unknowns Bx, By (base axes), cx, cy (stage axes)."""
    c, s = math.cos(math.radians(pan_deg)), math.sin(math.radians(pan_deg))
    return np.array([[c, -s, 1.0, 0.0], [s, c, 0.0, 1.0]])


def _azimuth_ahead_deg(level: BaseLevel, pan_deg: float) -> float:
    """Azimuth of the pan stage's y axis if the base's heading is 0; add the base's heading to it."""
    ahead = pan_stage_rotation(level.attitude(0.0), pan_deg)[:, 1]
    return math.degrees(math.atan2(ahead[0], ahead[1]))


def _noise_of_mean_deg(headings_deg: tuple[float, ...]) -> float:
    off_deg = _wrapped(np.asarray(headings_deg) - circular_mean_deg(headings_deg))
    return float(off_deg.std()) / math.sqrt(len(headings_deg))


def _deviation(residuals: Vector, freedom: int) -> float:
    """Standard deviation of residuals for a number of degrees of freedom."""
    return math.sqrt(float(residuals @ residuals) / max(freedom, 1))


def _wrapped(angles_deg: Vector) -> Vector:
    """Angles in [-180, 180)."""
    return np.asarray((angles_deg + 180.0) % 360.0 - 180.0)
