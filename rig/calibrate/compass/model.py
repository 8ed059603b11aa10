"""Forward model of a compass on the pan stage of a vehicle with iron.

With B the Earth's field in base axes and P the pan rotation, the compass measures

    S_stage @ P^T @ (S_vehicle @ B + h_vehicle) + h_stage
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.attitude.heading import VehicleIron
from rig.attitude.kinematics import Attitude, body_rotation
from rig.config.calibration_files import Matrix, Triple

Vector = NDArray[np.float64]

IRON_UNKNOWNS = 16
EARTH = slice(16, 18)
"""The part of the unknowns that is the Earth's field minus the model's (horizontal, down)."""


@dataclass(frozen=True)
class EarthField:
    """The World Magnetic Model's horizontal and downward strength, and the sigma of its declination."""

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
    """Hard (uT) and soft (matrix) iron of the pan stage and of the vehicle."""

    stage_hard_ut: Triple
    stage_soft: Matrix
    vehicle: VehicleIron


class CompassModel:
    """The forward model for one vector of unknowns; all zero means no iron.

    Unknowns: symmetric part of the stage's matrix (6), hard iron of the stage (3), symmetric part of the vehicle's
    matrix without the vertical one (5), horizontal hard iron of the vehicle (2), and the Earth's field minus the
    model's (2). A vertical part of the vehicle's hard iron is equivalent to the stage's.
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
        return np.asarray(in_stage(there, stop.pan_deg) @ self.stage.T + self.stage_ut)

    def iron(self) -> Iron:
        """The iron as configuration values."""
        vehicle = VehicleIron(_triple(self.vehicle_ut), _matrix(self.vehicle))
        return Iron(_triple(self.stage_ut), _matrix(self.stage), vehicle)


def in_stage(base_ut: Vector, pan_deg: Vector) -> Vector:
    """A field (3,) of the base at pan angles (n,), in stage axes (n, 3)."""
    c, s = np.cos(np.radians(pan_deg)), np.sin(np.radians(pan_deg))
    x, y, z = base_ut
    return np.column_stack([c * x - s * y, s * x + c * y, np.full(len(c), z)])


def in_base(stage_ut: Vector, pan_deg: Vector) -> Vector:
    """The part (3,) of fields in stage axes (n, 3) that is fixed to the base; the pan angles must cover a full turn
    evenly.
    """
    c, s = np.cos(np.radians(pan_deg)), np.sin(np.radians(pan_deg))
    x, y, z = stage_ut.T
    return np.array([(c * x + s * y).mean(), (-s * x + c * y).mean(), z.mean()])


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
