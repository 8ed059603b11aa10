"""The exact skyline row of every image column, without an image.

A column of a tilted, rolled or distorted camera crosses azimuths, so the row where it leaves the terrain solves
elevation(u, v) = horizon(azimuth(u, v)); the secant method needs about three evaluations of the horizon.
"""

import numpy as np
from numba import prange
from numpy.typing import NDArray

from sim.jit import kernel
from sim.world.lines_of_sight import MAX_CROSSINGS, horizon_tangent
from sim.world.scenario import CameraOptics
from sim.world.surface import Observer, Surface, track_of

Array = NDArray[np.float64]

STEP_TOLERANCE_PX = 1e-3  # of the last step: what remains is much smaller
SECANT_STEPS = 16
BISECTION_STEPS = 40
GUESS_MARGIN = 0.005  # tangent: some pixels
COLUMNS_PER_TASK = 32  # neighbours start from each other's row


def skyline_contour(
    surface: Surface, observer: Observer, optics: CameraOptics, rotation: Array, columns_px: Array
) -> Array:
    """Where the sky begins in image columns.

    Args:
        surface: the terrain.
        observer: the camera's optical centre.
        optics: intrinsics, distortion and size of the image.
        rotation: camera axes (columns) in east, north, up (3, 3).
        columns_px: image columns (n,), any real numbers; pixel centres are at whole ones.

    Returns:
        The row (n,) of the boundary, px, in the distorted image: terrain is below it, an edge between the
        pixels of rows 99 and 100 is 99.5. NaN where the skyline leaves the image or there is no terrain.
    """
    intrinsics = np.array([optics.fx_px, optics.fy_px, optics.cx_px, optics.cy_px, *optics.distortion])
    rows: Array = _rows(
        surface.kernel,
        track_of(observer),
        intrinsics,
        float(optics.height_px),
        np.ascontiguousarray(rotation, dtype=np.float64),
        np.ascontiguousarray(columns_px, dtype=np.float64),
    )
    return rows


@kernel()
def undistorted(intrinsics, u, v):  # type: ignore[no-untyped-def]
    """Ideal image coordinates (x, y) at z = 1 of a pixel: OpenCV's model inverted by Newton's method."""
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = intrinsics
    x_seen, y_seen = (u - cx) / fx, (v - cy) / fy
    x, y = x_seen, y_seen
    for _ in range(30):
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        radial_rate = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3))  # d radial / dx = radial_rate x
        error_x = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x) - x_seen
        error_y = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y - y_seen
        xx = radial + x * x * radial_rate + 2.0 * p1 * y + 6.0 * p2 * x
        yy = radial + y * y * radial_rate + 6.0 * p1 * y + 2.0 * p2 * x
        xy = x * y * radial_rate + 2.0 * p1 * x + 2.0 * p2 * y
        determinant = xx * yy - xy * xy
        step_x = (yy * error_x - xy * error_y) / determinant
        step_y = (xx * error_y - xy * error_x) / determinant
        x -= step_x
        y -= step_y
        if abs(step_x) + abs(step_y) < 1e-12:
            break
    return x, y


@kernel()
def _above_horizon(terrain, viewpoint, intrinsics, rotation, u, v, guess, buffers):  # type: ignore[no-untyped-def]
    """Tangent of the line of sight through (u, v) minus that of the horizon, and the horizon's own.

    ``guess`` is an expected tangent of the horizon; it affects the run time, not the result.
    """
    x, y = undistorted(intrinsics, u, v)
    east = rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2]
    north = rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2]
    up = rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2]
    height_m, block_max_m, max_height_m, drop, chunk_m = terrain
    times, z0, z1 = buffers
    azimuth = np.arctan2(east, north)
    tangent = np.nan
    for floor in (guess - GUESS_MARGIN, -np.inf):
        tangent, _ = horizon_tangent(
            height_m, block_max_m, max_height_m, drop, chunk_m, viewpoint, azimuth, floor, times, z0, z1
        )
        if not np.isnan(tangent):
            break
    return up / np.hypot(east, north) - tangent, tangent


@kernel()
def _row(terrain, viewpoint, intrinsics, height_px, rotation, u, start, guess, buffers):  # type: ignore[no-untyped-def]
    """The row of column u and the horizon's tangent there; the search starts at a row and a tangent."""
    top, bottom = -0.5, height_px - 0.5
    lowest, highest = top - 0.25 * height_px, bottom + 0.25 * height_px
    v0 = start
    g0, tangent = _above_horizon(terrain, viewpoint, intrinsics, rotation, u, v0, guess, buffers)
    v1 = min(max(v0 + g0 * intrinsics[1], lowest), highest)
    for _ in range(SECANT_STEPS):
        if abs(v1 - v0) < STEP_TOLERANCE_PX:
            return (v1 if top <= v1 <= bottom else np.nan), tangent
        g1, tangent = _above_horizon(terrain, viewpoint, intrinsics, rotation, u, v1, tangent, buffers)
        rate = (g1 - g0) / (v1 - v0)
        if not rate < 0.0:
            break
        v0, g0 = v1, g1
        v1 = min(max(v0 - g0 / rate, lowest), highest)
    above, below = top, bottom
    if not _above_horizon(terrain, viewpoint, intrinsics, rotation, u, above, -np.inf, buffers)[0] > 0.0:
        return np.nan, np.nan
    if not _above_horizon(terrain, viewpoint, intrinsics, rotation, u, below, -np.inf, buffers)[0] < 0.0:
        return np.nan, np.nan
    for _ in range(BISECTION_STEPS):
        middle = 0.5 * (above + below)
        g1, tangent = _above_horizon(terrain, viewpoint, intrinsics, rotation, u, middle, -np.inf, buffers)
        if g1 > 0.0:
            above = middle
        else:
            below = middle
    return 0.5 * (above + below), tangent


@kernel(parallel=True)
def _rows(terrain, viewpoint, intrinsics, height_px, rotation, columns_px):  # type: ignore[no-untyped-def]
    count = len(columns_px)
    rows = np.empty(count)
    for task in prange((count + COLUMNS_PER_TASK - 1) // COLUMNS_PER_TASK):
        buffers = (np.empty(MAX_CROSSINGS + 1), np.empty(MAX_CROSSINGS), np.empty(MAX_CROSSINGS))
        start, guess = intrinsics[3], -np.inf
        for k in range(task * COLUMNS_PER_TASK, min((task + 1) * COLUMNS_PER_TASK, count)):
            rows[k], tangent = _row(
                terrain, viewpoint, intrinsics, height_px, rotation, columns_px[k], start, guess, buffers
            )
            if not np.isnan(rows[k]):
                start, guess = rows[k], tangent
    return rows
