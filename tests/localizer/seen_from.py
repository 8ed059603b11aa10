"""What a rig observes from a place: contours of the very surface that is searched, and readings with errors."""

from dataclasses import dataclass

import numpy as np

from localizer.camera import camera_to_world, project
from localizer.dem.horizon import Terrain, horizon
from localizer.observation import FrameObservation, Observation

PLACE = (536.9, 389.1)


@dataclass(frozen=True)
class Lens:
    width_px: int = 640
    height_px: int = 480
    fx_px: float = 492.8
    fy_px: float = 492.8
    cx_px: float = 319.5
    cy_px: float = 239.5
    distortion: tuple[float, float, float, float, float] = (-0.06, 0.012, 0.0, 0.0, 0.0)


def observe(
    terrain: Terrain,
    place: tuple[float, float] = PLACE,
    *,
    azimuths: tuple[float, ...] = (0.3, 89.5, 180.2, 270.6),
    azimuth_bias_deg: float = 0.7,
    altitude_error_m: float = 3.0,
    noise_px: float = 0.3,
    seed: int = 1,
) -> Observation:
    """Contours seen from a place by a rig whose readings are wrong by the biases given."""
    rng = np.random.default_rng(seed)
    eye = float(terrain.dem.ground_m(*place)) + 2.0
    frames = []
    for number, azimuth in enumerate(azimuths):
        rays = azimuth + np.arange(-45.0, 45.0, 0.05)
        elevation, _ = horizon(terrain, *place, eye, rays)
        tilt, roll = float(np.median(elevation)), float(rng.normal(0.0, 1.0))
        u, v = project(Lens(), camera_to_world(azimuth, tilt, roll), rays, elevation[0])
        columns = np.arange(640.0)
        rows = np.interp(columns, u, v) + rng.normal(0.0, noise_px, 640)
        inside = (rows > 0.0) & (rows < 479.0)
        frames.append(
            FrameObservation(
                label=f"frame {number}",
                camera=Lens(),
                azimuth_deg=azimuth + azimuth_bias_deg + float(rng.normal(0.0, 0.1)),
                azimuth_sigma_deg=0.1,
                tilt_deg=tilt + float(rng.normal(0.0, 0.01)),
                tilt_sigma_deg=0.01,
                roll_deg=roll + float(rng.normal(0.0, 0.02)),
                roll_sigma_deg=0.02,
                u_px=columns[inside],
                v_px=rows[inside],
                sigma_px=np.full(int(inside.sum()), max(noise_px, 0.1)),
            )
        )
    return Observation(tuple(frames), 2.0, eye + altitude_error_m, 5.0, 1.0, 0.02)
