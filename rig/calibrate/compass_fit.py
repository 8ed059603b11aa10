"""Iron of the pan stage and of the vehicle from the field at many pan angles and headings of the vehicle.

With B the Earth's field in base axes and P the turn of the pan, a magnetometer on the pan stage measures

    S_stage @ P^T @ (S_vehicle @ B + h_vehicle) + h_stage

Turning the pan tells what is fixed to the stage, turning the vehicle what is fixed to the vehicle. Where the vehicle was not
turned, its iron stays unknown and shows in the heading's sigma. Horizontal strength and dip of the Earth's field come from the
World Magnetic Model: nothing else tells an error of scale. A turn of the whole compass about the vertical cannot be seen: it is
part of the boresight.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.calibrate.solve import solve
from rig.calibration import CalibrationError, Matrix, Triple
from rig.heading import VehicleIron
from rig.kinematics import Attitude, body_rotation

Vector = NDArray[np.float64]

LEAST_ANGLES = 4
LEAST_HEADINGS = 4
LEAST_TURN_DEG = 200.0
READING_SIGMA_UT = 0.05
EARTH_PRIOR_UT = 0.25  # the crust's part, which the model does not have
SOFT_PRIOR = 0.03
STAGE_PRIOR_UT = 100.0
VEHICLE_PRIOR_UT = 2.0  # of a vehicle that was not turned
WIDE_VEHICLE_PRIOR_UT = 50.0
RMS_LIMIT_UT = 0.25
SOFT_LIMIT = 0.3
SIGMA_LIMIT_DEG = 10.0
SLOPES_DEG = ((0.0, 0.0), (5.0, 0.0), (0.0, 5.0))  # at which the heading's sigma is to hold
STEP = 1e-4


@dataclass(frozen=True)
class EarthField:
    """By the World Magnetic Model: horizontal and downward strength, and how well the declination is known."""

    horizontal_ut: float
    down_ut: float
    declination_sigma_deg: float


@dataclass(frozen=True)
class VehicleStop:
    """One position of the vehicle: its slope, the pan angles (n,) and the field there (n, 3), uT, in stage axes."""

    pitch_deg: float
    roll_deg: float
    pan_deg: Vector
    field_ut: Vector


@dataclass(frozen=True)
class Iron:
    """What bends the field: hard (uT) and soft (matrix) iron of the pan stage and of the vehicle."""

    stage_hard_ut: Triple
    stage_soft: Matrix
    vehicle: VehicleIron


@dataclass(frozen=True)
class CompassFit:
    """The iron; magnetic headings of the vehicle; the field as found; and what is left (stops, pans, 3), uT."""

    iron: Iron
    headings_deg: Vector
    horizontal_ut: float
    down_ut: float
    heading_sigma_deg: float
    rms_ut: float
    residuals_ut: list[Vector]


def fit_compass(stops: Sequence[VehicleStop], earth: EarthField) -> CompassFit:
    """Fit the iron. ``CalibrationError`` where turns are too few, or what is left is no iron that stays where it is."""
    for stop in stops:
        if len(stop.pan_deg) < LEAST_ANGLES or np.ptp(stop.pan_deg) < LEAST_TURN_DEG:
            raise CalibrationError(
                f"compass: read at {len(stop.pan_deg)} pan angles through {np.ptp(stop.pan_deg):.0f} deg only; "
                f"take {LEAST_ANGLES} or more through {LEAST_TURN_DEG:g} deg"
            )
    turned = len(stops) >= LEAST_HEADINGS
    n = len(stops)
    headings = _first_headings(stops)
    vehicle_prior_ut = WIDE_VEHICLE_PRIOR_UT if turned else VEHICLE_PRIOR_UT
    prior_sigmas = np.concatenate(
        [
            np.full(6, SOFT_PRIOR),
            np.full(3, STAGE_PRIOR_UT),
            np.full(5, SOFT_PRIOR),
            np.full(2, vehicle_prior_ut),
            [EARTH_PRIOR_UT, EARTH_PRIOR_UT],
        ]
    )

    def left(unknowns: Vector) -> list[Vector]:
        model = _Model(unknowns[: len(prior_sigmas)], earth)
        return [
            stop.field_ut - model.measured(heading, stop)
            for heading, stop in zip(unknowns[len(prior_sigmas) :], stops, strict=True)
        ]

    def weighted(unknowns: Vector) -> Vector:
        residuals = [r.ravel() / READING_SIGMA_UT for r in left(unknowns)]
        return np.concatenate([*residuals, unknowns[: len(prior_sigmas)] / prior_sigmas])

    solved = solve(weighted, np.concatenate([np.zeros(len(prior_sigmas)), headings]))
    residuals = left(solved.unknowns)
    count = sum(r.size for r in residuals)
    total = sum(float((r**2).sum()) for r in residuals)
    rms_ut = float(np.sqrt(total / count))
    worse = max(1.0, total / READING_SIGMA_UT**2 / max(count - 14 - n, 1))
    iron_unknowns = solved.unknowns[: len(prior_sigmas)]
    covariance = solved.covariance[: len(prior_sigmas), : len(prior_sigmas)] * worse
    model = _Model(iron_unknowns, earth)
    sigma_deg = _heading_sigma_deg(iron_unknowns, covariance, earth)
    fit = CompassFit(
        model.iron(),
        np.degrees(solved.unknowns[len(prior_sigmas) :]) % 360.0,
        model.horizontal_ut,
        model.down_ut,
        float(np.hypot(sigma_deg, earth.declination_sigma_deg)),
        rms_ut,
        residuals,
    )
    _require_plausible(fit, turned)
    return fit


class _Model:
    """The forward model for one set of the unknowns, all zero without iron.

    Symmetric errors of the stage's matrix (6), the stage's iron (3), symmetric errors of the vehicle's matrix but the one of
    the vertical (5), its horizontal iron (2), and the Earth's field against the model's (2). A vertical part of the vehicle's
    iron is the same as the stage's.
    """

    def __init__(self, unknowns: Vector, earth: EarthField) -> None:
        self.stage = np.eye(3) + _symmetric(unknowns[:6])
        self.stage_ut = unknowns[6:9]
        self.vehicle = np.eye(3) + _symmetric(np.append(unknowns[9:14], 0.0))
        self.vehicle_ut = np.append(unknowns[14:16], 0.0)
        self.horizontal_ut = earth.horizontal_ut + float(unknowns[16])
        self.down_ut = earth.down_ut + float(unknowns[17])

    def measured(self, heading: float, stop: VehicleStop) -> Vector:
        """The field (n, 3) at the pan angles of a stop, with a magnetic heading in radians."""
        base = body_rotation(Attitude(float(np.degrees(heading)), stop.pitch_deg, stop.roll_deg))
        there = self.vehicle @ (base.T @ [0.0, self.horizontal_ut, -self.down_ut]) + self.vehicle_ut
        return np.asarray(_in_stage(there, stop.pan_deg) @ self.stage.T + self.stage_ut)

    def iron(self) -> Iron:
        """The same as what a configuration says."""
        vehicle = VehicleIron(_triple(self.vehicle_ut), _matrix(self.vehicle))
        return Iron(_triple(self.stage_ut), _matrix(self.stage), vehicle)


def _in_stage(base_ut: Vector, pan_deg: Vector) -> Vector:
    """A field (3,) of the base at pan angles (n,), in stage axes (n, 3)."""
    c, s = np.cos(np.radians(pan_deg)), np.sin(np.radians(pan_deg))
    x, y, z = base_ut
    return np.column_stack([c * x - s * y, s * x + c * y, np.full(len(c), z)])


def _first_headings(stops: Sequence[VehicleStop]) -> Vector:
    """Rough headings, radians: what turns with the pan is taken for the Earth's field."""
    found = []
    for stop in stops:
        c, s = np.cos(np.radians(stop.pan_deg)), np.sin(np.radians(stop.pan_deg))
        one, zero = np.ones_like(c), np.zeros_like(c)
        design = np.vstack([np.column_stack([c, -s, one, zero]), np.column_stack([s, c, zero, one])])
        (x, y, *_), *_ = np.linalg.lstsq(design, stop.field_ut[:, :2].T.ravel(), rcond=None)
        found.append(np.arctan2(-x, y))
    return np.array(found)


def _heading_sigma_deg(unknowns: Vector, covariance: Vector, earth: EarthField) -> float:
    """How far off headings are at all headings and on slopes, rms: the covariance carried through a capture's own steps.

    A capture finds the stage's horizontal iron again by turning the pan, so an error of that does not count.
    """
    pans_deg = np.array([-135.0, -45.0, 45.0, 135.0])
    headings = np.radians(np.arange(0.0, 360.0, 30.0))
    assumed = _Model(unknowns, earth).iron()

    def found(changed: Vector) -> Vector:
        truth = _Model(changed, earth)
        off = []
        for pitch_deg, roll_deg in SLOPES_DEG:
            level = body_rotation(Attitude(0.0, pitch_deg, roll_deg))
            for heading in headings:
                stop = VehicleStop(pitch_deg, roll_deg, pans_deg, np.empty((0, 3)))
                stage = np.linalg.solve(
                    np.array(assumed.stage_soft), (truth.measured(heading, stop) - assumed.stage_hard_ut).T
                ).T
                east, north, _ = level @ assumed.vehicle.removed(_in_base(stage, pans_deg))
                off.append(np.degrees(np.arctan2(-east, north)) - np.degrees(heading))
        return (np.array(off) + 180.0) % 360.0 - 180.0

    at = found(unknowns)
    steps = np.eye(len(unknowns)) * STEP
    jacobian = np.column_stack([(found(unknowns + step) - at) / STEP for step in steps])
    variances = np.einsum("ki,ij,kj->k", jacobian, covariance, jacobian)
    return float(np.sqrt(variances.mean()))


def _in_base(stage_ut: Vector, pan_deg: Vector) -> Vector:
    """The part (3,) of fields in stage axes (n, 3) that stays with the base; the pan angles are all round, evenly."""
    c, s = np.cos(np.radians(pan_deg)), np.sin(np.radians(pan_deg))
    x, y, z = stage_ut.T
    return np.array([(c * x + s * y).mean(), (-s * x + c * y).mean(), z.mean()])


def _require_plausible(fit: CompassFit, turned: bool) -> None:
    soft = max(
        float(np.abs(np.array(m) - np.eye(3)).max()) for m in (fit.iron.stage_soft, fit.iron.vehicle.soft)
    )
    if fit.rms_ut > RMS_LIMIT_UT:
        raise CalibrationError(
            f"compass: {fit.rms_ut:.2f} uT are left that no iron of stage and vehicle explains ({RMS_LIMIT_UT} are allowed); "
            "move away from fences, power lines and other vehicles, carry no iron, and calibrate again"
        )
    if soft > SOFT_LIMIT:
        raise CalibrationError(
            f"compass: the field is bent or weakened by {soft:.0%} against the World Magnetic Model; check [compass] axes and "
            "[place], and move the compass away from iron"
        )
    if fit.heading_sigma_deg > SIGMA_LIMIT_DEG:
        remedy = (
            "read more pan angles"
            if turned
            else f"turn the vehicle too, to {LEAST_HEADINGS} headings or more"
        )
        raise CalibrationError(
            f"compass: headings are known to {fit.heading_sigma_deg:.1f} deg only; {remedy}"
        )


def _symmetric(six: Vector) -> Vector:
    """xx, yy, xy, xz, yz, zz."""
    xx, yy, xy, xz, yz, zz = six
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _triple(values: Vector) -> Triple:
    x, y, z = (float(value) for value in values)
    return x, y, z


def _matrix(rows: Vector) -> Matrix:
    x, y, z = (_triple(row) for row in rows)
    return x, y, z
