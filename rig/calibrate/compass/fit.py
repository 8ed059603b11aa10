"""Fit of hard and soft iron of pan stage and vehicle, from the field at many pan angles and vehicle headings.

Turning the pan determines iron fixed to the stage, turning the vehicle iron fixed to the vehicle. If the vehicle was
not turned, its iron stays unknown and increases the heading's sigma. Horizontal strength and dip come from the World
Magnetic Model: nothing else determines a scale error. A rotation of the whole compass about the vertical is not
observable; it is part of the boresight.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.attitude.kinematics import Attitude, body_rotation
from rig.calibrate.compass.earth_field import MAX_DIP_SIGMA_DEG, MeasuredField, check_field
from rig.calibrate.compass.model import (
    EARTH,
    IRON_UNKNOWNS,
    CompassModel,
    EarthField,
    Iron,
    VehicleStop,
    in_base,
)
from rig.calibrate.least_squares import solve
from rig.config.calibration_files import CalibrationError

Vector = NDArray[np.float64]

MIN_ANGLES = 4
MIN_HEADINGS = 4
MIN_TURN_DEG = 200.0
READING_SIGMA_UT = 0.05
EARTH_PRIOR_UT = 0.25  # the crustal field, which the model lacks
WIDE_EARTH_PRIOR_UT = 20.0  # if the field is to be measured instead of taken from the model
SOFT_PRIOR = 0.03
STAGE_PRIOR_UT = 100.0
VEHICLE_PRIOR_UT = 2.0  # of a vehicle that was not turned
WIDE_VEHICLE_PRIOR_UT = 50.0
RMS_LIMIT_UT = 0.25
SOFT_LIMIT = 0.3
SIGMA_LIMIT_DEG = 10.0
SLOPES_DEG = ((0.0, 0.0), (5.0, 0.0), (0.0, 5.0))  # slopes over which the heading's sigma is evaluated
STEP = 1e-4


@dataclass(frozen=True)
class CompassFit:
    """Iron, magnetic headings of the vehicle, and residuals (stops, pans, 3), uT.

    ``field`` is the Earth's field measured without the model, ``warnings`` what is suspicious about it.
    """

    iron: Iron
    headings_deg: Vector
    field: MeasuredField
    warnings: list[str]
    heading_sigma_deg: float
    rms_ut: float
    residuals_ut: list[Vector]


def fit_compass(stops: Sequence[VehicleStop], earth: EarthField) -> CompassFit:
    """Fit the iron.

    ``CalibrationError`` if the turns are too few, the residuals are not those of fixed iron, or the Earth's field
    contradicts the World Magnetic Model.
    """
    for stop in stops:
        if len(stop.pan_deg) < MIN_ANGLES or np.ptp(stop.pan_deg) < MIN_TURN_DEG:
            raise CalibrationError(
                f"compass: read at {len(stop.pan_deg)} pan angles through {np.ptp(stop.pan_deg):.0f} deg only; "
                f"take {MIN_ANGLES} or more through {MIN_TURN_DEG:g} deg"
            )
    turned = len(stops) >= MIN_HEADINGS
    vehicle_prior_ut = WIDE_VEHICLE_PRIOR_UT if turned else VEHICLE_PRIOR_UT
    found = _fit(stops, earth, vehicle_prior_ut, EARTH_PRIOR_UT)
    iron = CompassModel(found.unknowns, earth).iron()
    _require_explained(found.rms_ut)
    asked = _fit(stops, earth, vehicle_prior_ut, WIDE_EARTH_PRIOR_UT)
    field = _measured_field(asked, earth, iron.stage_hard_ut[2])
    warnings = check_field(field, earth)
    sigma_deg = float(
        np.hypot(_heading_sigma_deg(found.unknowns, found.covariance, earth), earth.declination_sigma_deg)
    )
    _require_plausible(iron, sigma_deg, turned)
    headings_deg = np.degrees(found.headings) % 360.0
    return CompassFit(iron, headings_deg, field, warnings, sigma_deg, found.rms_ut, found.residuals_ut)


@dataclass(frozen=True)
class _Fitted:
    """The unknowns of ``CompassModel`` with covariance, headings in radians, and residuals."""

    unknowns: Vector
    covariance: Vector
    headings: Vector
    residuals_ut: list[Vector]
    rms_ut: float


def _fit(
    stops: Sequence[VehicleStop], earth: EarthField, vehicle_prior_ut: float, earth_prior_ut: float
) -> _Fitted:
    prior_sigmas = np.concatenate(
        [
            np.full(6, SOFT_PRIOR),
            np.full(3, STAGE_PRIOR_UT),
            np.full(5, SOFT_PRIOR),
            np.full(2, vehicle_prior_ut),
            np.full(2, earth_prior_ut),
        ]
    )
    n = len(prior_sigmas)

    def residuals_at(unknowns: Vector) -> list[Vector]:
        model = CompassModel(unknowns[:n], earth)
        return [
            stop.field_ut - model.measured(heading, stop)
            for heading, stop in zip(unknowns[n:], stops, strict=True)
        ]

    def weighted(unknowns: Vector) -> Vector:
        residuals = [r.ravel() / READING_SIGMA_UT for r in residuals_at(unknowns)]
        return np.concatenate([*residuals, unknowns[:n] / prior_sigmas])

    solved = solve(weighted, np.concatenate([np.zeros(n), _initial_headings(stops)]))
    residuals = residuals_at(solved.unknowns)
    count = sum(r.size for r in residuals)
    total = sum(float((r**2).sum()) for r in residuals)
    worse = max(1.0, total / READING_SIGMA_UT**2 / max(count - IRON_UNKNOWNS - len(stops), 1))
    return _Fitted(
        solved.unknowns[:n],
        solved.covariance[:n, :n] * worse,
        solved.unknowns[n:],
        residuals,
        float(np.sqrt(total / count)),
    )


def _measured_field(fitted: _Fitted, earth: EarthField, vertical_iron_ut: float) -> MeasuredField:
    """The field determined by the turns alone. If they do not determine the dip, the horizontal part for the model's
    dip.

    On a slope part of the vertical field is measured as horizontal.
    """
    model = CompassModel(fitted.unknowns, earth)
    horizontal_ut, down_ut = model.horizontal_ut, model.down_ut
    (horizontal_2, both), (_, down_2) = fitted.covariance[EARTH, EARTH]
    strength_2 = horizontal_ut**2 + down_ut**2
    dip_variance = (
        down_ut**2 * horizontal_2 - 2.0 * horizontal_ut * down_ut * both + horizontal_ut**2 * down_2
    )
    dip_sigma_deg = float(np.degrees(np.sqrt(dip_variance) / strength_2))
    dip_deg = float(np.degrees(np.arctan2(down_ut, horizontal_ut)))
    if dip_sigma_deg > MAX_DIP_SIGMA_DEG:
        horizontal_ut -= both / down_2 * (down_ut - earth.down_ut)
        horizontal_2 -= both**2 / down_2
    return MeasuredField(
        float(horizontal_ut), float(np.sqrt(horizontal_2)), dip_deg, dip_sigma_deg, vertical_iron_ut
    )


def _initial_headings(stops: Sequence[VehicleStop]) -> Vector:
    """Approximate headings, radians: what rotates with the pan is taken for the Earth's field."""
    found = []
    for stop in stops:
        c, s = np.cos(np.radians(stop.pan_deg)), np.sin(np.radians(stop.pan_deg))
        one, zero = np.ones_like(c), np.zeros_like(c)
        design = np.vstack([np.column_stack([c, -s, one, zero]), np.column_stack([s, c, zero, one])])
        (x, y, *_), *_ = np.linalg.lstsq(design, stop.field_ut[:, :2].T.ravel(), rcond=None)
        found.append(np.arctan2(-x, y))
    return np.array(found)


def _heading_sigma_deg(unknowns: Vector, covariance: Vector, earth: EarthField) -> float:
    """Rms heading error over all headings and slopes: the covariance propagated through a capture's own computation.

    A capture re-estimates the stage's horizontal iron by turning the pan, so its error does not count.
    """
    pans_deg = np.array([-135.0, -45.0, 45.0, 135.0])
    headings = np.radians(np.arange(0.0, 360.0, 30.0))
    assumed = CompassModel(unknowns, earth).iron()

    def found(changed: Vector) -> Vector:
        truth = CompassModel(changed, earth)
        off = []
        for pitch_deg, roll_deg in SLOPES_DEG:
            level = body_rotation(Attitude(0.0, pitch_deg, roll_deg))
            for heading in headings:
                stop = VehicleStop(pitch_deg, roll_deg, pans_deg, np.empty((0, 3)))
                stage = np.linalg.solve(
                    np.array(assumed.stage_soft), (truth.measured(heading, stop) - assumed.stage_hard_ut).T
                ).T
                east, north, _ = level @ assumed.vehicle.removed(in_base(stage, pans_deg))
                off.append(np.degrees(np.arctan2(-east, north)) - np.degrees(heading))
        return (np.array(off) + 180.0) % 360.0 - 180.0

    at = found(unknowns)
    steps = np.eye(len(unknowns)) * STEP
    jacobian = np.column_stack([(found(unknowns + step) - at) / STEP for step in steps])
    variances = np.einsum("ki,ij,kj->k", jacobian, covariance, jacobian)
    return float(np.sqrt(variances.mean()))


def _require_explained(rms_ut: float) -> None:
    if rms_ut > RMS_LIMIT_UT:
        raise CalibrationError(
            f"compass: {rms_ut:.2f} uT are left that no iron of stage and vehicle explains ({RMS_LIMIT_UT} are allowed); "
            "move away from fences, power lines and other vehicles, carry no iron, and calibrate again"
        )


def _require_plausible(iron: Iron, heading_sigma_deg: float, turned: bool) -> None:
    soft = max(float(np.abs(np.array(m) - np.eye(3)).max()) for m in (iron.stage_soft, iron.vehicle.soft))
    if soft > SOFT_LIMIT:
        raise CalibrationError(
            f"compass: iron of the rig bends the field by {soft:.0%} ({SOFT_LIMIT:.0%} is allowed); check [compass] axes, and "
            "move the compass away from iron"
        )
    if heading_sigma_deg > SIGMA_LIMIT_DEG:
        remedy = (
            "read more pan angles" if turned else f"turn the vehicle too, to {MIN_HEADINGS} headings or more"
        )
        raise CalibrationError(f"compass: headings are known to {heading_sigma_deg:.1f} deg only; {remedy}")
