"""Observed skyline points of the calibration, frame by frame."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from localizer.camera import azimuth_elevation_deg, camera_to_world
from rig.attitude.kinematics import Attitude, body_rotation

Vector = NDArray[np.float64]


@dataclass(frozen=True)
class SkylineFrame:
    """One frame: the head's attitude from joints, heading and inclinometer, and the skyline's rays (n, 3) in the camera
    with sigmas.

    ``share`` is the share of columns with a skyline. The azimuth sigma belongs to the pan ``stop``, which frames may
    share; the tilt sigma is the frame's own.
    """

    label: str
    head: Attitude
    rays: Vector
    sigma_deg: Vector
    share: float
    azimuth_sigma_deg: float
    tilt_sigma_deg: float
    stop: int


class Points:
    """The points of all frames, concatenated."""

    def __init__(self, frames: Sequence[SkylineFrame]) -> None:
        self.frame = np.concatenate([np.full(len(f.rays), i) for i, f in enumerate(frames)])
        self.stop = np.concatenate([np.full(len(f.rays), f.stop) for f in frames])
        self.sigma_deg = np.concatenate([f.sigma_deg for f in frames])
        self._rays = [f.rays for f in frames]
        self._heads = [body_rotation(f.head) for f in frames]

    def seen(self, boresight: Attitude, turn_deg: Vector) -> tuple[Vector, Vector]:
        """Azimuth (plus ``turn_deg``) and elevation of all points for a camera with this boresight."""
        camera = camera_to_world(boresight.azimuth_deg, boresight.tilt_deg, boresight.roll_deg)
        world = np.concatenate([r @ (h @ camera).T for r, h in zip(self._rays, self._heads, strict=True)])
        azimuth, elevation = azimuth_elevation_deg(world)
        return azimuth + turn_deg, elevation

    @property
    def across(self) -> Vector:
        """Angle of each point to the right of the optical axis, radians: the lever arm of a roll."""
        rays = np.concatenate(self._rays)
        return np.asarray(np.arctan2(rays[:, 0], rays[:, 2]))
