"""Kinematic model of the head: from base attitude, pan and tilt to the camera's rotation, and back.

World axes are east, north, up. Base, pan stage and head have x right, y forward, z up; the camera has
OpenCV's axes (x right, y down, z along the optical axis). A rotation matrix has the body's axes as its
columns. Pan is positive clockwise seen from above, tilt is positive up:

    head in world = base in world @ Rz(-pan) @ Rx(tilt)
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from localizer.camera import camera_to_world
from rig.config.keep_out import require_allowed
from rig.config.model import RigConfig
from rig.config.sections import KeepOut
from rig.errors import GoalError

Rotation = NDArray[np.float64]


@dataclass(frozen=True)
class Attitude:
    """Azimuth (heading) clockwise from north, tilt (pitch) up and roll clockwise from behind, degrees."""

    azimuth_deg: float
    tilt_deg: float
    roll_deg: float


@dataclass(frozen=True)
class JointAngles:
    """Pan and tilt of the head."""

    pan_deg: float
    tilt_deg: float


@dataclass(frozen=True)
class Head:
    """The head's constants: joint ranges, keep-out zones, and the camera's orientation in head axes (``boresight``)."""

    pan_range_deg: tuple[float, float]
    tilt_range_deg: tuple[float, float]
    boresight: Attitude
    keep_out: tuple[KeepOut, ...] = ()

    @classmethod
    def from_config(cls, config: RigConfig) -> "Head":
        """The head that a configuration describes."""
        pan, tilt, camera = config.pan_tilt.pan, config.pan_tilt.tilt, config.camera
        return cls(
            (pan.min_deg, pan.max_deg),
            (tilt.min_deg, tilt.max_deg),
            Attitude(camera.boresight_azimuth_deg, camera.boresight_tilt_deg, camera.boresight_roll_deg),
            config.pan_tilt.keep_out,
        )


def body_rotation(attitude: Attitude) -> Rotation:
    """Axes x right, y forward, z up of a body (base or head) in east, north, up."""
    right, down, forward = camera_to_world(attitude.azimuth_deg, attitude.tilt_deg, attitude.roll_deg).T
    return np.column_stack([right, forward, -down])


def body_attitude(rotation: Rotation) -> Attitude:
    """The inverse of ``body_rotation``. Straight up or down, where azimuth and roll are one, roll is 0."""
    right, forward, up = rotation.T
    return camera_attitude(np.column_stack([right, -up, forward]))


def camera_attitude(rotation: Rotation) -> Attitude:
    """Azimuth, tilt and roll of a camera-to-world rotation (contract, "camera to world")."""
    right, down, forward = rotation.T
    tilt = np.arctan2(forward[2], np.hypot(forward[0], forward[1]))
    if np.hypot(forward[0], forward[1]) < 1e-9:
        azimuth = np.arctan2(-right[1], right[0])
    else:
        azimuth = np.arctan2(forward[0], forward[1])
    level_right = np.array([np.cos(azimuth), -np.sin(azimuth), 0.0])
    roll = np.arctan2(-down @ level_right, right @ level_right)
    return Attitude(float(np.degrees(azimuth)) % 360.0, float(np.degrees(tilt)), float(np.degrees(roll)))


def pan_stage_rotation(base: Attitude, pan_deg: float) -> Rotation:
    """Axes of the pan stage in the world: it turns with pan, not with tilt."""
    p = np.radians(pan_deg)
    pan = np.array([[np.cos(p), np.sin(p), 0.0], [-np.sin(p), np.cos(p), 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(body_rotation(base) @ pan)


def head_rotation(base: Attitude, joints: JointAngles) -> Rotation:
    """Axes of the head in the world."""
    t = np.radians(joints.tilt_deg)
    tilt = np.array([[1.0, 0.0, 0.0], [0.0, np.cos(t), -np.sin(t)], [0.0, np.sin(t), np.cos(t)]])
    return np.asarray(pan_stage_rotation(base, joints.pan_deg) @ tilt)


def camera_rotation(head_in_world: Rotation, boresight: Attitude) -> Rotation:
    """Camera to world, for a camera mounted in the head with this ``boresight``."""
    return np.asarray(head_in_world @ _camera_in_head(boresight))


def camera_pointing(base: Attitude, joints: JointAngles, boresight: Attitude) -> Attitude:
    """Camera attitude from the joint angles alone."""
    return camera_attitude(camera_rotation(head_rotation(base, joints), boresight))


def measured_pointing(
    base: Attitude, joints: JointAngles, head_tilt_deg: float, head_roll_deg: float, boresight: Attitude
) -> Attitude:
    """Camera attitude: azimuth from base and joints, tilt and roll from the inclinometer in the head.

    The inclinometer also measures what the joints do not: gear backlash, bending of the mast, settling of the vehicle.
    """
    azimuth_deg = body_attitude(head_rotation(base, joints)).azimuth_deg
    head = body_rotation(Attitude(azimuth_deg, head_tilt_deg, head_roll_deg))
    return camera_attitude(camera_rotation(head, boresight))


def joints_for(azimuth_deg: float, tilt_deg: float, base: Attitude, head: Head) -> JointAngles:
    """Joint angles at which the optical axis has this true azimuth and tilt.

    ``GoalError`` if the head cannot reach it: outside the limits, in a keep-out zone, or without a solution (close to
    the pan axis, for a camera with a large boresight).
    """
    goal = f"azimuth {azimuth_deg % 360.0:.1f}, tilt {tilt_deg:.1f} deg"
    wanted = body_rotation(base).T @ camera_to_world(azimuth_deg, tilt_deg, 0.0)[:, 2]
    axis = _camera_in_head(head.boresight)[:, 2]
    # Rx(tilt) brings the axis to the wanted elevation in the y-z plane, then Rz(-pan) to the wanted azimuth.
    reach = np.hypot(axis[1], axis[2])
    if abs(wanted[2]) > reach:
        raise GoalError(f"{goal}: too close to the pan axis for this head; ask for a lower tilt")
    tilt = np.arcsin(wanted[2] / reach) - np.arctan2(axis[2], axis[1])
    forward = axis[1] * np.cos(tilt) - axis[2] * np.sin(tilt)
    pan = np.degrees(np.arctan2(wanted[0], wanted[1]) - np.arctan2(axis[0], forward))
    joints = JointAngles(
        _within(float(pan), head.pan_range_deg, "pan", goal),
        _within(float(np.degrees(tilt)), head.tilt_range_deg, "tilt", goal),
    )
    require_allowed((joints.pan_deg, joints.tilt_deg), head.keep_out)
    return joints


def wrapped_deg(angle_deg: float) -> float:
    """The angle in [-180, 180)."""
    return (angle_deg + 180.0) % 360.0 - 180.0


def _within(angle_deg: float, range_deg: tuple[float, float], joint: str, goal: str) -> float:
    low, high = range_deg
    near = wrapped_deg(angle_deg)
    for candidate in (near, near + 360.0, near - 360.0):
        if low <= candidate <= high:
            return candidate
    raise GoalError(
        f"{goal}: needs {joint} {near:.1f} deg, beyond the limits {low:g} to {high:g} of [pan_tilt.{joint}]; "
        "turn the vehicle or ask for another direction"
    )


def _camera_in_head(boresight: Attitude) -> Rotation:
    # The contract's camera to world, with head axes (right, forward, up) in place of east, north, up.
    return camera_to_world(boresight.azimuth_deg, boresight.tilt_deg, boresight.roll_deg)
