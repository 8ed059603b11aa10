"""Kinematics of the truth: base, pan, tilt and boresight to the camera's rotation.

Frames: world is east, north, up; base, pan stage and head are x right, y forward, z up; the camera is
OpenCV's (x right, y down, z forward). A rotation named ``a_in_b`` has a's axes as its columns, given in b.
Pan is clockwise-positive seen from above, tilt up-positive.
"""

import threading
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Rotation = NDArray[np.float64]


def camera_in_world(azimuth_deg: float, tilt_deg: float, roll_deg: float) -> Rotation:
    """Camera axes in east, north, up (3, 3): looks at a true azimuth, tilted up, rolled clockwise."""
    a, t, r = np.radians([azimuth_deg, tilt_deg, roll_deg])
    forward = np.array([np.sin(a) * np.cos(t), np.cos(a) * np.cos(t), np.sin(t)])
    level_right = np.array([np.cos(a), -np.sin(a), 0.0])
    level_down = np.cross(forward, level_right)
    right = level_right * np.cos(r) + level_down * np.sin(r)
    down = -level_right * np.sin(r) + level_down * np.cos(r)
    return np.column_stack([right, down, forward])


def body_in_world(heading_deg: float, pitch_deg: float, roll_deg: float) -> Rotation:
    """Axes right, forward, up of a body in east, north, up (3, 3); nose-up pitch, clockwise roll."""
    right, down, forward = camera_in_world(heading_deg, pitch_deg, roll_deg).T
    return np.column_stack([right, forward, -down])


def pan_stage_in_base(pan_deg: float) -> Rotation:
    """Axes of the pan stage in the base (3, 3): pan turns y towards x."""
    p = np.radians(pan_deg)
    return np.array([[np.cos(p), np.sin(p), 0.0], [-np.sin(p), np.cos(p), 0.0], [0.0, 0.0, 1.0]])


def head_in_pan_stage(tilt_deg: float) -> Rotation:
    """Axes of the head in the pan stage (3, 3): tilt turns y towards z."""
    t = np.radians(tilt_deg)
    return np.array([[1.0, 0.0, 0.0], [0.0, np.cos(t), -np.sin(t)], [0.0, np.sin(t), np.cos(t)]])


@dataclass(frozen=True)
class Attitude:
    """Attitude of the base in the world, degrees; or of the camera in the head (azimuth, tilt, roll)."""

    heading_deg: float
    pitch_deg: float
    roll_deg: float


def turned_about_axes(angles_deg: tuple[float, float, float]) -> Rotation:
    """Axes of a body (3, 3) rotated about x, then about its new y, then about its new z."""
    x, y, z = np.radians(angles_deg)
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, np.cos(x), -np.sin(x)], [0.0, np.sin(x), np.cos(x)]])
    about_y = np.array([[np.cos(y), 0.0, np.sin(y)], [0.0, 1.0, 0.0], [-np.sin(y), 0.0, np.cos(y)]])
    about_z = np.array([[np.cos(z), -np.sin(z), 0.0], [np.sin(z), np.cos(z), 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(about_x @ about_y @ about_z)


def body_attitude(rotation: Rotation) -> Attitude:
    """The inverse of ``body_in_world``, for a body that does not point straight up or down."""
    right, forward, up = rotation.T
    heading = np.arctan2(forward[0], forward[1])
    level_right = np.array([np.cos(heading), -np.sin(heading), 0.0])
    roll = np.arctan2(up @ level_right, right @ level_right)
    return Attitude(
        float(np.degrees(heading)) % 360.0, float(np.degrees(np.arcsin(forward[2]))), float(np.degrees(roll))
    )


@dataclass
class Mechanics:
    """The kinematic chain from the ground to the camera. The vehicle may turn on the spot, which changes ``base``."""

    base: Attitude
    boresight: Attitude

    def turn_vehicle(self, by_deg: float) -> None:
        """Turn the base to the right about its own vertical axis, as a vehicle turns on a slope."""
        base = body_in_world(self.base.heading_deg, self.base.pitch_deg, self.base.roll_deg)
        self.base = body_attitude(base @ pan_stage_in_base(by_deg))

    def pan_stage_in_world(self, pan_deg: float) -> Rotation:
        """Axes of the pan stage in east, north, up (3, 3)."""
        base = body_in_world(self.base.heading_deg, self.base.pitch_deg, self.base.roll_deg)
        return base @ pan_stage_in_base(pan_deg)

    def head_in_world(self, pan_deg: float, tilt_deg: float) -> Rotation:
        """Axes of the head in east, north, up (3, 3)."""
        return self.pan_stage_in_world(pan_deg) @ head_in_pan_stage(tilt_deg)

    def camera_in_world(self, pan_deg: float, tilt_deg: float) -> Rotation:
        """Camera axes in east, north, up (3, 3), with the camera mounted slightly off (boresight)."""
        b = self.boresight
        return self.head_in_world(pan_deg, tilt_deg) @ camera_in_world(b.heading_deg, b.pitch_deg, b.roll_deg)


@dataclass(frozen=True)
class JointState:
    """True joint angles at one time."""

    pan_deg: float
    tilt_deg: float
    moving: bool
    holding: bool = False  # with torque


class Head:
    """The true joint angles now: written by the servos, read by camera and sensors, from any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._state = JointState(0.0, 0.0, False)

    def set(self, pan_deg: float, tilt_deg: float, moving: bool, holding: bool = False) -> None:
        """Replace the whole state atomically."""
        with self._lock:
            self._state = JointState(pan_deg, tilt_deg, moving, holding)

    def state(self) -> JointState:
        """The whole state, consistent."""
        with self._lock:
            return self._state

    @property
    def pan_deg(self) -> float:
        """Pan of the stage against the base, clockwise-positive."""
        return self.state().pan_deg

    @property
    def tilt_deg(self) -> float:
        """Tilt of the head against the pan stage, up-positive."""
        return self.state().tilt_deg

    @property
    def moving(self) -> bool:
        """Whether a motor is drawing current to move."""
        return self.state().moving
