"""Pixels to directions in the world and back, with the contract's axes and signs.

The camera frame is OpenCV's (x right, y down, z forward; pixel centres at whole numbers); the world is east, north, up.
"""

from typing import Protocol

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]


class Intrinsics(Protocol):
    """What a camera model must state: focal lengths and principal point in px, and OpenCV's k1, k2, p1, p2, k3."""

    @property
    def fx_px(self) -> float: ...
    @property
    def fy_px(self) -> float: ...
    @property
    def cx_px(self) -> float: ...
    @property
    def cy_px(self) -> float: ...
    @property
    def distortion(self) -> tuple[float, float, float, float, float]: ...


def camera_to_world(azimuth_deg: float, tilt_deg: float, roll_deg: float) -> Floats:
    """Rotation (3, 3) whose columns are the camera's axes x, y, z in east, north, up (contract, "camera to world")."""
    a, t, r = np.radians([azimuth_deg, tilt_deg, roll_deg])
    sin_a, cos_a, sin_t, cos_t, sin_r, cos_r = (
        np.sin(a),
        np.cos(a),
        np.sin(t),
        np.cos(t),
        np.sin(r),
        np.cos(r),
    )
    forward = np.array([sin_a * cos_t, cos_a * cos_t, sin_t])
    level_right = np.array([cos_a, -sin_a, 0.0])
    level_down = np.array([sin_a * sin_t, cos_a * sin_t, -cos_t])  # forward x level_right
    x = level_right * cos_r + level_down * sin_r
    y = -level_right * sin_r + level_down * cos_r
    return np.stack([x, y, forward], axis=1)


def pixel_rays(camera: Intrinsics, u_px: ArrayLike, v_px: ArrayLike) -> Floats:
    """Unit vectors (n, 3) in the camera frame of the pixels (u, v), lens distortion removed."""
    points = np.stack(np.broadcast_arrays(np.asarray(u_px, float), np.asarray(v_px, float)), axis=-1).reshape(
        -1, 1, 2
    )
    matrix = _matrix(camera)
    # OpenCV's default five iterations leave a tenth of a pixel at the corners of a wide lens.
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-10)
    normal = cv2.undistortPoints(points, matrix, np.asarray(camera.distortion), criteria=criteria)
    rays = np.column_stack([np.asarray(normal, float).reshape(-1, 2), np.ones(len(points))])
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))


def project(
    camera: Intrinsics, rotation: Floats, azimuth_deg: ArrayLike, elevation_deg: ArrayLike
) -> tuple[Floats, Floats]:
    """Pixels (u, v) at which a camera with this camera-to-world rotation sees the directions; NaN behind the camera."""
    world = direction_vectors(np.asarray(azimuth_deg, float), np.asarray(elevation_deg, float))
    in_camera = world @ rotation
    ahead = in_camera[:, 2] > 0.05
    u = np.full(len(world), np.nan)
    v = np.full(len(world), np.nan)
    if ahead.any():
        pixels, _ = cv2.projectPoints(
            in_camera[ahead].reshape(-1, 1, 3),
            np.zeros(3),
            np.zeros(3),
            _matrix(camera),
            np.asarray(camera.distortion),
        )
        u[ahead], v[ahead] = np.asarray(pixels, float).reshape(-1, 2).T
    return u, v


def invertible_share(camera: Intrinsics, width_px: int, height_px: int) -> float:
    """Share of a picture's pixels whose rays, seen through the lens model, come back to them within a pixel."""
    u, v = (grid.ravel() for grid in np.meshgrid(*(np.linspace(0, n - 1, 9) for n in (width_px, height_px))))
    with np.errstate(all="ignore"):  # where the model is not invertible, the result below is not finite
        rays = pixel_rays(camera, u, v)
        back, _ = cv2.projectPoints(
            rays.reshape(-1, 1, 3), np.zeros(3), np.zeros(3), _matrix(camera), np.asarray(camera.distortion)
        )
        off_px = np.linalg.norm(np.asarray(back).reshape(-1, 2) - np.column_stack([u, v]), axis=1)
    return float(np.mean(np.isfinite(off_px) & (off_px < 1.0)))


def direction_vectors(azimuth_deg: Floats, elevation_deg: Floats) -> Floats:
    """Unit vectors (n, 3), east, north, up, of azimuths clockwise from north and elevations above the horizontal."""
    a, e = np.radians(azimuth_deg).ravel(), np.radians(elevation_deg).ravel()
    return np.column_stack([np.sin(a) * np.cos(e), np.cos(a) * np.cos(e), np.sin(e)])


def azimuth_elevation_deg(vectors: Floats) -> tuple[Floats, Floats]:
    """Azimuth (0 to 360) and elevation in degrees of vectors (n, 3) in east, north, up."""
    azimuth = np.degrees(np.arctan2(vectors[:, 0], vectors[:, 1])) % 360.0
    elevation = np.degrees(np.arctan2(vectors[:, 2], np.hypot(vectors[:, 0], vectors[:, 1])))
    return azimuth, elevation


def _matrix(camera: Intrinsics) -> Floats:
    return np.array([[camera.fx_px, 0.0, camera.cx_px], [0.0, camera.fy_px, camera.cy_px], [0.0, 0.0, 1.0]])
