"""A camera oriented so that a skyline lies in the middle of its image."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from localizer.bundle import FILE_NAME, Camera
from localizer.camera import azimuth_elevation_deg, camera_to_world, pixel_rays, project
from localizer.documents import DocumentError, read_json
from localizer.errors import SkyfixError
from localizer.os_errors import why_not_read
from localizer.predict.views import View

Floats = NDArray[np.float64]

TILT_RANGE_DEG = (-30.0, 60.0)
"""Range of tilts of a pan-tilt head; no skyline needs more."""
HEADROOM_DEG = 2.0
"""Margin above and below the skyline for the sides of the image."""


@dataclass(frozen=True)
class Pointed:
    """A level camera in one direction."""

    camera: Camera
    azimuth_deg: float
    tilt_deg: float

    @property
    def rotation(self) -> Floats:
        """Camera to world."""
        return camera_to_world(self.azimuth_deg, self.tilt_deg, 0.0)

    def pixels(self, azimuth_deg: Floats, elevation_deg: Floats) -> tuple[Floats, Floats]:
        """u, v of directions."""
        return project(self.camera, self.rotation, azimuth_deg, elevation_deg)

    def directions_deg(self, u_px: Floats, v_px: Floats) -> tuple[Floats, Floats]:
        """Azimuth and elevation of pixels (n,)."""
        return azimuth_elevation_deg(pixel_rays(self.camera, u_px, v_px) @ self.rotation.T)


def load_camera(path: Path) -> Camera:
    """The camera of a bundle (its folder or its bundle.json), or of a JSON file with nothing but a camera.

    Raises ``SkyfixError``.
    """
    file = path / FILE_NAME if path.is_dir() else path
    try:
        fields = read_json(file)
    except OSError as error:
        raise SkyfixError(f"--camera: {file}: {why_not_read(error, file)}") from None
    except DocumentError as error:
        raise SkyfixError(
            f"--camera: {file}: is not JSON that can be used ({error}); name a bundle or its {FILE_NAME}"
        ) from None
    if isinstance(fields, dict) and "camera" in fields:
        fields = fields["camera"]
    try:
        return Camera.model_validate_json(json.dumps(fields))
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        field = ".".join(["camera", *(str(part) for part in first["loc"])])
        raise SkyfixError(f"--camera: {file}: {field}: {first['msg']}") from None


def width_deg(camera: Camera) -> float:
    """Angle between the outermost columns in the middle row."""
    rays = pixel_rays(camera, np.array([-0.5, camera.width_px - 0.5]), np.full(2, camera.cy_px))
    left, right = np.degrees(np.arctan2(rays[:, 0], rays[:, 2]))
    return float(right - left)


def pointed_at(camera: Camera, seen: View) -> Pointed:
    """The tilt that centres the skyline's range of elevations."""
    middle_deg = 0.5 * sum(seen.range_deg)
    return Pointed(camera, seen.azimuth_deg, float(np.clip(middle_deg, *TILT_RANGE_DEG)))


def whole_width_deg(pointed: Pointed, seen: View) -> float:
    """Width of a view that reaches both sides of the image at the skyline's elevations; it grows with the tilt."""
    camera = pointed.camera
    v_px = np.linspace(-0.5, camera.height_px - 0.5, 200)
    u_px = np.repeat([-0.5, camera.width_px - 0.5], len(v_px))
    azimuth_deg, elevation_deg = pointed.directions_deg(u_px, np.tile(v_px, 2))
    lowest_deg, highest_deg = seen.range_deg
    beside = (elevation_deg > lowest_deg - HEADROOM_DEG) & (elevation_deg < highest_deg + HEADROOM_DEG)
    offset_deg = np.abs((azimuth_deg - pointed.azimuth_deg + 180.0) % 360.0 - 180.0)
    return max(seen.width_deg, 2.0 * float(offset_deg[beside].max(initial=0.0)))


def notes(pointed: Pointed, seen: View) -> list[str]:
    """A note on the part of the skyline outside the image."""
    u_px, v_px = pointed.pixels(seen.azimuths_deg, seen.elevation_deg)
    across = (u_px > -0.5) & (u_px < pointed.camera.width_px - 0.5)
    missed = across & ~((v_px > -0.5) & (v_px < pointed.camera.height_px - 0.5))
    share = float(missed.sum() / max(across.sum(), 1))
    if share == 0.0:
        return []
    return [f"{share:.0%} of the skyline lies above or below the picture, tilted {pointed.tilt_deg:+.1f}°"]
