"""Camera frames: the panorama resampled through lens and sensor models."""

import cv2
import numpy as np
from numba import prange
from numpy.typing import NDArray

from sim.jit import kernel
from sim.render.panorama import Panorama
from sim.world.mechanics import Rotation
from sim.world.scenario import CameraOptics
from sim.world.truth import World

SUPERSAMPLING = 2  # rays a pixel side
MID_GREY = 128.0
READ_NOISE_SHARE = 0.3  # of a mid-grey pixel's variance; the rest is shot noise and grows with the light


class Sensor:
    """Model of lens and sensor: blur, vignetting, exposure, noise."""

    def __init__(self, optics: CameraOptics) -> None:
        self.optics = optics
        self.rays = _rays(optics)
        """Through every pixel, SUPERSAMPLING a side: (rows, columns, 3) in the camera frame, z = 1."""
        self._shading = _vignette(optics)

    def image(self, fine: NDArray[np.uint8]) -> NDArray[np.float32]:
        """The noise-free picture, 0..255, from the light along ``rays`` (rows, columns, 3)."""
        size = (self.optics.width_px, self.optics.height_px)
        picture = np.asarray(cv2.resize(fine, size, interpolation=cv2.INTER_AREA), dtype=np.float32)
        if self.optics.blur_px > 0.0:
            picture = np.asarray(cv2.GaussianBlur(picture, (0, 0), self.optics.blur_px), dtype=np.float32)
        return np.asarray(picture * self._shading)

    def expose(self, clean: NDArray[np.float32], rng: np.random.Generator | None) -> NDArray[np.uint8]:
        """The final picture, with noise if a generator is given."""
        if rng is None or self.optics.noise == 0.0:
            return np.asarray(np.clip(np.rint(clean), 0.0, 255.0), dtype=np.uint8)
        normal = rng.standard_normal(clean.shape, dtype=np.float32)
        frame = np.empty(clean.shape, dtype=np.uint8)
        _expose(clean, normal, np.float32(self.optics.noise), frame)
        return frame


class Renderer:
    """Renders frames from a world's panorama. Single-threaded: it caches the last view."""

    def __init__(self, world: World, panorama: Panorama) -> None:
        self.panorama = panorama
        self._sensor = Sensor(world.scenario.camera)
        self._last: tuple[Rotation, NDArray[np.float32]] | None = None

    def frame(self, rotation: Rotation, rng: np.random.Generator | None) -> NDArray[np.uint8]:
        """One picture, blue, green, red (height, width, 3).

        Args:
            rotation: camera axes (columns) in east, north, up (3, 3).
            rng: of the sensor's noise; without one there is none.
        """
        return self._sensor.expose(self._clean(rotation), rng)

    def _clean(self, rotation: Rotation) -> NDArray[np.float32]:
        """The picture before the sensor's noise, 0..255; cached for a stationary head."""
        if self._last is not None and np.array_equal(self._last[0], rotation):
            return self._last[1]
        columns = self.panorama.image.shape[1]
        rays = self._sensor.rays
        map_x, map_y = np.empty(rays.shape[:2], np.float32), np.empty(rays.shape[:2], np.float32)
        _panorama_position(
            rays,
            rotation.astype(np.float32),
            np.float32(1.0 / np.radians(self.panorama.step_deg)),
            np.float32(np.radians(self.panorama.top_deg)),
            np.float32(columns),
            np.float32(self.panorama.image.shape[0] - 1),
            map_x,
            map_y,
        )
        fine = cv2.remap(self.panorama.image, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
        clean = self._sensor.image(np.asarray(fine, np.uint8))
        self._last = (rotation.copy(), clean)
        return clean


def _rays(optics: CameraOptics) -> NDArray[np.float32]:
    """Directions (rows, columns, 3) of the rays through every pixel, in the camera frame, z = 1."""
    fine = (np.arange(optics.width_px * SUPERSAMPLING) + 0.5) / SUPERSAMPLING - 0.5
    finer = (np.arange(optics.height_px * SUPERSAMPLING) + 0.5) / SUPERSAMPLING - 0.5
    u, v = np.meshgrid(fine, finer)
    matrix = np.array([[optics.fx_px, 0.0, optics.cx_px], [0.0, optics.fy_px, optics.cy_px], [0.0, 0.0, 1.0]])
    until = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-9)
    pixels = np.column_stack([u.ravel(), v.ravel()])[:, None, :]
    ideal = cv2.undistortPoints(pixels, matrix, np.array(optics.distortion), criteria=until)
    rays = np.ones((*u.shape, 3), dtype=np.float32)
    rays[..., :2] = ideal.reshape(*u.shape, 2)
    return rays


def _vignette(optics: CameraOptics) -> NDArray[np.float32]:
    """Gain (rows, columns, 1) of display values: exposure, and light lost towards the corners.

    Display values go with the square root of the light.
    """
    u, v = np.meshgrid(np.arange(optics.width_px) - optics.cx_px, np.arange(optics.height_px) - optics.cy_px)
    radius2 = (u / optics.fx_px) ** 2 + (v / optics.fy_px) ** 2
    corner = optics.vignetting * radius2 / radius2.max()
    gain: NDArray[np.float32] = np.sqrt(optics.exposure * (1.0 - corner)).astype(np.float32)
    return gain[..., None]


@kernel(inline="always", error_model="numpy", fastmath=True)
def _arctangent(y, x):  # type: ignore[no-untyped-def]
    """Arctangent of y / x in all quadrants, to 4e-6 rad, in arithmetic that vector instructions do."""
    ax, ay = abs(x), abs(y)
    small, large = min(ax, ay), max(ax, ay)
    t = small / large
    q = t * t
    series = np.float32(-0.01172120)
    series = series * q + np.float32(0.05265332)
    series = series * q + np.float32(-0.11643287)
    series = series * q + np.float32(0.19354346)
    series = series * q + np.float32(-0.33262347)
    series = series * q + np.float32(0.99997726)
    angle = series * t
    angle = np.float32(0.5 * np.pi) - angle if ay > ax else angle
    angle = np.float32(np.pi) - angle if x < np.float32(0.0) else angle
    return -angle if y < np.float32(0.0) else angle


@kernel(parallel=True, error_model="numpy", fastmath=True)
def _panorama_position(  # type: ignore[no-untyped-def]
    rays, rotation, steps_per_rad, top, columns, last_row, map_x, map_y
):
    """Panorama position of each ray: column (0 <= x < columns) and row, clipped to the picture."""
    for i in prange(rays.shape[0]):
        for j in range(rays.shape[1]):
            x, y = rays[i, j, 0], rays[i, j, 1]
            east = rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2]
            north = rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2]
            up = rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2]
            column = _arctangent(east, north) * steps_per_rad
            map_x[i, j] = column + columns if column < np.float32(0.0) else column
            level = np.sqrt(east * east + north * north)
            row = (top - _arctangent(up, level)) * steps_per_rad
            map_y[i, j] = min(max(row, np.float32(0.0)), last_row)


@kernel(parallel=True, error_model="numpy", fastmath=True)
def _expose(clean, normal, noise, frame):  # type: ignore[no-untyped-def]
    """Add noise of the read-out and of the photons, and round."""
    read, shot = np.float32(READ_NOISE_SHARE), np.float32((1.0 - READ_NOISE_SHARE) / MID_GREY)
    half, white = np.float32(0.5), np.float32(255.0)
    for i in prange(clean.shape[0]):
        for j in range(clean.shape[1]):
            for c in range(3):
                value = clean[i, j, c]
                value += normal[i, j, c] * noise * np.sqrt(read + shot * value) + half
                frame[i, j, c] = np.uint8(min(max(value, np.float32(0.0)), white))
