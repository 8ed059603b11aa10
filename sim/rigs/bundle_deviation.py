"""Errors of a bundle's readings against the truth that its frames were rendered from."""

import threading
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from localizer import Bundle, Frame, camera_to_world, load_bundle, pixel_rays
from sim.errors import SimulationError
from sim.world.mechanics import Rotation
from sim.world.truth import World

GRID = (9, 7)  # pixels at which directions are compared
MARGIN = 0.08


@dataclass(frozen=True)
class BundleDeviation:
    """Largest errors over the frames of a bundle, degrees, with the common azimuth error separate; altitude in metres.

    Directions are compared at pixels: lens, boresight and readings together. ``claimed_*`` are the bundle's own sigmas,
    ``frames`` azimuth, tilt and roll error of each frame by its label.
    """

    tilt_deg: float
    roll_deg: float
    relative_azimuth_deg: float
    azimuth_bias_deg: float
    altitude_m: float
    claimed_tilt_deg: float
    claimed_azimuth_deg: float
    claimed_altitude_m: float
    frames: dict[str, tuple[float, float, float]]


class CameraLog:
    """The camera's true attitude over time. Written by the camera's thread, read afterwards."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._seen: list[tuple[datetime, Rotation]] = []

    def note(self, rotation: Rotation) -> None:
        """Record the attitude of a picture taken now."""
        with self._lock:
            self._seen.append((datetime.now(UTC), rotation.copy()))

    def at(self, time: datetime) -> Rotation:
        """Camera axes in the world (3, 3) of the last picture before ``time``."""
        with self._lock:
            earlier = [rotation for when, rotation in self._seen if when <= time]
        if not earlier:
            raise SimulationError(f"no picture was taken before {time}")
        return earlier[-1]


def bundle_deviation(directory: Path, world: World, log: CameraLog) -> BundleDeviation:
    """Compare a bundle with the truth of its world."""
    bundle = load_bundle(directory)
    off = np.array([_off_deg(bundle, frame, world, log) for frame in bundle.frames])
    azimuth = (off[:, 0] + 180.0) % 360.0 - 180.0
    bias_deg = float(azimuth.mean())
    altitude = bundle.altitude
    return BundleDeviation(
        _largest(off[:, 1]),
        _largest(off[:, 2]),
        _largest(azimuth - bias_deg),
        bias_deg,
        altitude.value_m - world.place.altitude_m if altitude else float("nan"),
        bundle.tilt_bias_sigma_deg,
        bundle.azimuth_bias_sigma_deg,
        altitude.sigma_m if altitude else float("nan"),
        {
            frame.label: (float(a), float(t), float(r))
            for frame, (a, t, r) in zip(bundle.frames, np.column_stack([azimuth, off[:, 1:]]), strict=True)
        },
    )


def _off_deg(bundle: Bundle, frame: Frame, world: World, log: CameraLog) -> NDArray[np.float64]:
    """Azimuth, tilt and roll (3,) of the bundle's directions minus the true ones, best fit over all pixels."""
    optics, camera = world.scenario.camera, bundle.camera
    u, v = np.meshgrid(
        np.linspace(MARGIN, 1.0 - MARGIN, GRID[0]) * camera.width_px,
        np.linspace(MARGIN, 1.0 - MARGIN, GRID[1]) * camera.height_px,
    )
    true_rays = pixel_rays(optics, u.ravel(), v.ravel())
    said_rays = pixel_rays(camera, u.ravel(), v.ravel())
    # The rotation (Kabsch) between the bundle's lens and the true one counts as part of the attitude.
    left, _, right = np.linalg.svd(true_rays.T @ said_rays)
    turn = left @ np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))]) @ right
    true = log.at(_time(frame)) @ turn
    said = camera_to_world(frame.azimuth_deg, frame.tilt_deg, frame.roll_deg)
    return np.asarray(_angles_deg(said) - _angles_deg(true))


def _angles_deg(rotation: Rotation) -> NDArray[np.float64]:
    """Azimuth, tilt and roll (3,) of camera axes in the world."""
    right, down, forward = rotation.T
    azimuth = np.arctan2(forward[0], forward[1])
    level_right = np.array([np.cos(azimuth), -np.sin(azimuth), 0.0])
    roll = np.arctan2(-down @ level_right, right @ level_right)
    return np.asarray(np.degrees(np.array([azimuth, np.arcsin(forward[2]), roll])))


def _time(frame: Frame) -> datetime:
    """Arrival of the last picture of a frame: the head was stationary before and since."""
    raw = (frame.model_extra or {})["raw"]
    return datetime.fromisoformat(raw["frame_times"][-1])


def _largest(off_deg: NDArray[np.float64]) -> float:
    return float(off_deg[np.argmax(np.abs(off_deg))])
