"""Fit of the accelerometer's errors from readings at many pan and tilt angles (a generalised two-position test).

The sensor's error is fixed to the head, the base's slope is not. Turning the pan separates zero error and slope,
tilting separates zero error and mounting, and the length of gravity determines the scale. A zero error of the tilt
joint cannot be separated from a tilted chip: on average the head is assumed to be where the tilt servo says.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from rig.attitude.accelerometer import AccelerometerCorrection, Triple
from rig.attitude.kinematics import JointAngles
from rig.attitude.level import tilt_roll_deg
from rig.calibrate.least_squares import solve
from rig.config.calibration_files import CalibrationError

Vector = NDArray[np.float64]

MIN_ANGLES = 6
APART_DEG = 10.0
MIN_SPAN_DEG = 180.0
RMS_LIMIT_DEG = 0.02
MOUNTING_LIMIT_DEG = 20.0
SCALE_LIMIT = 0.15
SIGMA_LIMIT_DEG = 0.1
READING_SIGMA_G = 5e-5  # 0.003 deg: noise that averaging does not remove
SCALE_PRIOR = 0.03  # the data sheets' tolerance
ZERO_PRIOR_G = 0.1
EVALUATION_TILTS_DEG = (-10.0, 0.0, 10.0, 20.0)  # at which the sigma is to hold
STEP = 1e-6
USUAL_TEMPERATURE_C = 20.0


@dataclass(frozen=True)
class TiltReading:
    """Uncorrected reading of the chip (3,), g, in head axes, with the joints; z is NaN for a two-axis chip."""

    joints: JointAngles
    measured_g: Triple
    temperature_c: float | None


@dataclass(frozen=True)
class InclinometerFit:
    """The correction, the base's slope, and the quality of the fit.

    ``residuals_deg`` (n, 3) are the residuals of each reading as angles; ``pan_deg``, ``tilt_deg`` (n,) its joint
    angles.
    """

    correction: AccelerometerCorrection
    tilt_sigma_deg: float
    roll_sigma_deg: float
    base_pitch_deg: float
    base_roll_deg: float
    rms_deg: float
    residuals_deg: Vector
    pan_deg: Vector
    tilt_deg: Vector


def fit_inclinometer(
    readings: Sequence[TiltReading], joint_sigma_deg: float, drift_mg_c: Triple = (0.0, 0.0, 0.0)
) -> InclinometerFit:
    """Fit zero, scale and mounting. ``CalibrationError`` if the readings are too few or fit no rigid head.

    ``joint_sigma_deg`` is the sigma of a joint angle. ``drift_mg_c`` is the known temperature drift.
    """
    _require_turn([reading.joints.pan_deg for reading in readings])
    pan = np.radians([reading.joints.pan_deg for reading in readings])
    tilt = np.radians([reading.joints.tilt_deg for reading in readings])
    measured = np.array([reading.measured_g for reading in readings])
    temperatures = [r.temperature_c for r in readings if r.temperature_c is not None]
    at_c = float(np.mean(temperatures)) if temperatures else None
    seen = ~np.isnan(measured)
    n = len(readings)
    joint_sigma = np.radians(joint_sigma_deg)

    def misfit_g(unknowns: Vector) -> Vector:
        pitch, roll = unknowns[:2]
        zero, scale, turn = unknowns[2:5], 1.0 + unknowns[5:8], unknowns[8:11]
        up = _up_in_head(pitch, roll, pan + unknowns[11 : 11 + n], tilt + unknowns[11 + n :])
        # The mounting rotates measurements into head axes, so the model of a measurement uses its inverse.
        seen_by_chip = up @ Rotation.from_rotvec(turn).as_matrix()
        return np.asarray((measured - (seen_by_chip * scale + zero))[seen])

    def weighted(unknowns: Vector) -> Vector:
        priors = [unknowns[2:5] / ZERO_PRIOR_G, unknowns[5:8] / SCALE_PRIOR, unknowns[11:] / joint_sigma]
        return np.concatenate([misfit_g(unknowns) / READING_SIGMA_G, *priors])

    solution = solve(weighted, np.zeros(11 + 2 * n))
    found = solution.unknowns
    residuals = np.full(measured.shape, np.nan)
    residuals[seen] = np.degrees(misfit_g(found))
    rms_deg = float(np.sqrt(np.nanmean(residuals**2)))
    freedom = max(int(seen.sum()) - 11 - n, 1)
    worse = max(1.0, float(np.sum((misfit_g(found) / READING_SIGMA_G) ** 2)) / freedom)
    covariance = solution.covariance[2:11, 2:11] * worse
    tilt_sigma_deg, roll_sigma_deg = _sigmas_deg(found[2:11], covariance, bool(seen.all()))
    fit = InclinometerFit(
        _correction(found[2:11], at_c, drift_mg_c),
        tilt_sigma_deg,
        roll_sigma_deg,
        float(np.degrees(found[0])),
        float(np.degrees(found[1])),
        rms_deg,
        residuals,
        np.degrees(pan),
        np.degrees(tilt),
    )
    _require_plausible(fit)
    return fit


def _up_in_head(pitch: float, roll: float, pan: Vector, tilt: Vector) -> Vector:
    """Up (n, 3) in head axes for a base with this slope (heading does not matter)."""
    # Up in the base: sin(pitch) forward, and the rest leans to the left for a roll to the right.
    up = np.array([-np.cos(pitch) * np.sin(roll), np.sin(pitch), np.cos(pitch) * np.cos(roll)])
    x = np.cos(pan) * up[0] - np.sin(pan) * up[1]
    ahead = np.sin(pan) * up[0] + np.cos(pan) * up[1]
    y = np.cos(tilt) * ahead + np.sin(tilt) * up[2]
    z = -np.sin(tilt) * ahead + np.cos(tilt) * up[2]
    return np.column_stack([x, y, z])


def _sigmas_deg(nine: Vector, covariance: Vector, three_axes: bool) -> tuple[float, float]:
    """Sigmas of corrected tilt and roll at the tilts of use: the covariance propagated."""
    tilts = np.radians(EVALUATION_TILTS_DEG)
    up = np.column_stack([np.zeros_like(tilts), np.sin(tilts), np.cos(tilts)])
    measured = up @ Rotation.from_rotvec(nine[6:9]).as_matrix() * (1.0 + nine[3:6]) + nine[:3]
    if not three_axes:
        measured[:, 2] = np.nan

    def read(parameters: Vector) -> Vector:
        return np.array(tilt_roll_deg(_correction(parameters, None).up_in_head(measured, np.nan)))

    at = read(nine)
    steps = np.eye(9) * STEP
    jacobian = np.stack([(read(nine + step) - at) / STEP for step in steps], axis=-1)  # (2, tilts, 9)
    variances = np.einsum("...i,ij,...j->...", jacobian, covariance, jacobian)
    tilt_sigma, roll_sigma = np.sqrt(variances.max(axis=1))
    return float(tilt_sigma), float(roll_sigma)


def _correction(
    nine: Vector, at_c: float | None, drift_mg_c: Triple = (0.0, 0.0, 0.0)
) -> AccelerometerCorrection:
    """The correction from the unknowns: zero in g, scale error, mounting in radians."""
    return AccelerometerCorrection(
        _triple(nine[:3] * 1000.0),
        _triple(1.0 + nine[3:6]),
        _triple(np.degrees(nine[6:9])),
        drift_mg_c,
        USUAL_TEMPERATURE_C if at_c is None else at_c,
    )


def _require_turn(pans_deg: Sequence[float]) -> None:
    angles = np.sort(pans_deg)
    distinct = 1 + int(np.sum(np.diff(angles) > APART_DEG))
    if distinct < MIN_ANGLES:
        raise CalibrationError(
            f"inclinometer: {distinct} pan angles are too few to tell its error from the slope; "
            f"read it at {MIN_ANGLES} or more, {APART_DEG:g} deg apart"
        )
    if angles[-1] - angles[0] < MIN_SPAN_DEG:
        raise CalibrationError(
            f"inclinometer: the pan turned through {angles[-1] - angles[0]:.0f} deg only; "
            f"turn it through {MIN_SPAN_DEG:g} or more"
        )


def _require_plausible(fit: InclinometerFit) -> None:
    mounting_angle_deg = float(np.linalg.norm(fit.correction.mounting_deg))
    off_scale = float(np.abs(np.array(fit.correction.scale) - 1.0).max())
    if fit.rms_deg > RMS_LIMIT_DEG:
        raise CalibrationError(
            f"inclinometer: its readings fit no rigid head: {fit.rms_deg:.3f} deg are left, {RMS_LIMIT_DEG} are "
            "allowed; let nobody board the vehicle, shelter it from the wind, and calibrate again"
        )
    if mounting_angle_deg > MOUNTING_LIMIT_DEG:
        raise CalibrationError(
            f"inclinometer: the chip seems to sit {mounting_angle_deg:.0f} deg askew; check [inclinometer] axes and "
            "[pan_tilt.tilt] zero_tick, direction"
        )
    if off_scale > SCALE_LIMIT:
        raise CalibrationError(
            f"inclinometer: its scale seems to be {off_scale:.0%} off; it is broken, or of another kind than configured"
        )
    if fit.tilt_sigma_deg > SIGMA_LIMIT_DEG:
        raise CalibrationError(
            f"inclinometer: its zero is known to {fit.tilt_sigma_deg:.2f} deg only; read it at more pan and tilt angles"
        )


def _triple(values: Vector) -> Triple:
    x, y, z = (float(value) for value in values)
    return x, y, z
