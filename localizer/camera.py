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
    """Make the rotation from camera axes to east, north, up.

    Parameters
    ----------
    azimuth_deg : float
        True azimuth of the optical axis.
    tilt_deg : float
        Angle of the optical axis above the horizontal.
    roll_deg : float
        Positive when the camera is turned clockwise, seen from behind it.

    Returns
    -------
    ndarray of float, shape (3, 3)
        Its columns are the camera's axes x (right), y (down), z (forward).

    Examples
    --------
    >>> localizer.camera_to_world(90.0, 0.0, 0.0).round() + 0.0
    array([[ 0.,  0.,  1.],
           [-1.,  0.,  0.],
           [ 0., -1.,  0.]])
    """
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
    """Compute the rays of pixels, lens distortion removed.

    Parameters
    ----------
    camera : Camera
        Any object with ``fx_px``, ``fy_px``, ``cx_px``, ``cy_px`` and ``distortion``, as OpenCV has them.
    u_px, v_px : array_like of float
        Column and row of n pixels, centres at whole numbers.

    Returns
    -------
    ndarray of float, shape (n, 3)
        Unit vectors in the camera frame: x right, y down, z forward.

    Examples
    --------
    >>> camera = localizer.load_bundle("bundles/first").camera
    >>> rays = localizer.pixel_rays(camera, [camera.cx_px], [camera.cy_px])
    >>> (rays @ localizer.camera_to_world(90.0, 0.0, 0.0).T).round(6)  # east, north, up
    array([[1., 0., 0.]])
    """
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
    """Project directions into a camera's picture.

    Parameters
    ----------
    camera : Camera
        Any object with ``fx_px``, ``fy_px``, ``cx_px``, ``cy_px`` and ``distortion``, as OpenCV has them.
    rotation : ndarray of float, shape (3, 3)
        Camera to world, see `camera_to_world`.
    azimuth_deg, elevation_deg : array_like of float, shape (n,)
        Directions: true azimuth and angle above the horizontal.

    Returns
    -------
    u_px, v_px : ndarray of float, shape (n,)
        Column and row, distorted pixels; also beyond the picture's edge. NaN for directions behind the camera.

    Examples
    --------
    >>> camera = localizer.load_bundle("bundles/first").camera
    >>> rotation = localizer.camera_to_world(90.0, 5.0, 0.0)
    >>> u_px, v_px = localizer.project(camera, rotation, [90.0, 270.0], [5.0, 0.0])
    >>> u_px.round(1), v_px.round(1)
    (array([319.5,   nan]), array([239.5,   nan]))
    """
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
    """Compute the directions of vectors.

    Parameters
    ----------
    vectors : ndarray of float, shape (n, 3)
        In east, north, up, of any length.

    Returns
    -------
    azimuth_deg : ndarray of float, shape (n,)
        Clockwise from north, 0 to 360.
    elevation_deg : ndarray of float, shape (n,)
        Above the horizontal.

    Examples
    --------
    >>> import numpy as np
    >>> localizer.azimuth_elevation_deg(np.array([[1.0, 0.0, 0.0], [0.0, 2.0, 2.0]]))
    (array([90.,  0.]), array([ 0., 45.]))
    """
    azimuth = np.degrees(np.arctan2(vectors[:, 0], vectors[:, 1])) % 360.0
    elevation = np.degrees(np.arctan2(vectors[:, 2], np.hypot(vectors[:, 0], vectors[:, 1])))
    return azimuth, elevation


def _matrix(camera: Intrinsics) -> Floats:
    return np.array([[camera.fx_px, 0.0, camera.cx_px], [0.0, camera.fy_px, camera.cy_px], [0.0, 0.0, 1.0]])
