"""What the camera sees of the skyline at a known place, frame by frame and point by point."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from localizer.camera import azimuth_elevation_deg, camera_to_world
from rig.attitude.kinematics import Attitude, body_rotation

Vector = NDArray[np.float64]


@dataclass(frozen=True)
class SkylineFrame:
    """One frame: the head as joints, heading and inclinometer say, and the skyline's rays (n, 3) in the camera with sigmas.

    ``share`` is the part of the columns that showed it. The sigma of azimuth is of the pan's ``stop``, which frames may share;
    that of tilt is this frame's own.
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
    """The points of all frames, one after the other."""

    def __init__(self, frames: Sequence[SkylineFrame]) -> None:
        self.frame = np.concatenate([np.full(len(f.rays), i) for i, f in enumerate(frames)])
        self.stop = np.concatenate([np.full(len(f.rays), f.stop) for f in frames])
        self.sigma_deg = np.concatenate([f.sigma_deg for f in frames])
        self._rays = [f.rays for f in frames]
        self._heads = [body_rotation(f.head) for f in frames]

    def seen(self, boresight: Attitude, turn_deg: Vector) -> tuple[Vector, Vector]:
        """Azimuth (turned further by ``turn_deg``) and elevation of all points, for a camera that sits so in the head."""
        camera = camera_to_world(boresight.azimuth_deg, boresight.tilt_deg, boresight.roll_deg)
        world = np.concatenate([r @ (h @ camera).T for r, h in zip(self._rays, self._heads, strict=True)])
        azimuth, elevation = azimuth_elevation_deg(world)
        return azimuth + turn_deg, elevation

    @property
    def across(self) -> Vector:
        """How far right of the optical axis each point lies, as an angle in radians: what a roll lifts."""
        rays = np.concatenate(self._rays)
        return np.asarray(np.arctan2(rays[:, 0], rays[:, 2]))
