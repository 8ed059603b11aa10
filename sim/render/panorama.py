"""The full panorama from one place, rendered once: the optical centre does not move while the head turns.

The picture is cylindrical: columns are true azimuths, rows elevation angles, equally spaced. Every column is drawn
along its own exact profile of the triangulated surface, front to back and bottom to top, so that occlusion is exact and
the skyline lies where ``Surface.horizon`` says, blended into its row by area. Well below every skyline is the
foreground, about half of the picture: there every second row and column is interpolated.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numba import prange
from numpy.typing import NDArray

from sim.jit import kernel
from sim.render.ground import ground_radiance, prepare_ground
from sim.render.noise_texture import noise_texture
from sim.render.sky import SKY_STEP_DEG, air_light, daylight, sky_picture, toned
from sim.world.lines_of_sight import (
    MAX_CROSSINGS,
    chunk_ceiling,
    piece_maximum,
    ray_polynomial,
    ray_position,
    tangent_bound,
    trace_chunk,
)
from sim.world.surface import track_of
from sim.world.truth import World

Array = NDArray[np.float64]

STEP_PX = 0.43  # slightly finer than the renderer's rays, to avoid aliasing
MIN_STEP_DEG = 0.02  # keeps it below 300 MB
TOP_DEG = 65.0
BOTTOM_DEG = -40.0
FOREGROUND_TOP_DEG = -3.0
FOREGROUND_GAP_DEG = 1.0  # at least, between the foreground and the lowest skyline
STRIPE = 16  # columns that one task draws: neighbours share cache lines of the image


@dataclass(frozen=True)
class Panorama:
    """The whole view from one place, in equal steps of azimuth and elevation angle.

    Attributes
    ----------
    image : array of uint8
        (rows, columns, 3): blue, green, red. Row 0 is at ``top_deg``, column 0 at true north; columns go clockwise.
    step_deg : float
        From one row or column to the next.
    top_deg : float
        Elevation angle of row 0.
    """

    image: NDArray[np.uint8]
    step_deg: float
    top_deg: float


def render_panorama(world: World) -> Panorama:
    """Draw everything that the world's camera can see, as finely as it can resolve.

    Parameters
    ----------
    world : World
        Its place, weather and camera.

    Returns
    -------
    Panorama
        All azimuths, and elevation angles from -40 to 65 degrees.

    Examples
    --------
    >>> import sim
    >>> world = sim.World.create(seed=7, scenario=small_camera)  # or any scenario
    >>> panorama = sim.render_panorama(world)
    >>> rows, columns, _ = panorama.image.shape
    >>> round(columns * panorama.step_deg), round(rows * panorama.step_deg)
    (360, 105)
    """
    finest_deg = max(float(np.degrees(STEP_PX / world.scenario.camera.fx_px)), MIN_STEP_DEG)
    columns = 2 * int(np.ceil(180.0 / finest_deg))
    step_deg = 360.0 / columns
    rows = int(np.ceil((TOP_DEG - BOTTOM_DEG) / step_deg)) + 1
    surface = world.surface
    light = daylight(world.air)
    ground = prepare_ground(
        surface, light, noise_texture(world.rng("ground texture")), world.scenario.weather.snow_line_m
    )
    sky = sky_picture(light, noise_texture(world.rng("clouds")), TOP_DEG, BOTTOM_DEG)
    to_sky = np.array([[step_deg / SKY_STEP_DEG, 0.0, 0.0], [0.0, step_deg / SKY_STEP_DEG, 0.0]])
    image = np.asarray(
        cv2.warpAffine(
            sky,
            to_sky,
            (columns, rows),
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_REPLICATE,
        ),
        dtype=np.uint8,
    )
    azimuths_deg = np.arange(columns, dtype=np.float64) * step_deg
    foreground = _foreground_row(surface.horizon(world.observer, azimuths_deg)[0], step_deg, rows)
    _draw(
        image,
        surface.kernel,
        track_of(world.observer),
        ground,
        air_light(light, azimuths_deg),
        light.extinction_per_m,
        np.radians(azimuths_deg),
        np.tan(np.radians(TOP_DEG - step_deg * np.arange(rows))),
        foreground,
        np.radians(step_deg),
        np.radians(TOP_DEG),
    )
    _fill_foreground(image, foreground)
    return Panorama(image, step_deg, TOP_DEG)


def _foreground_row(horizon_deg: Array, step_deg: float, rows: int) -> int:
    """First row of the foreground; none if the view is open somewhere."""
    if np.isnan(horizon_deg).any():
        return rows
    below_deg = min(FOREGROUND_TOP_DEG, float(horizon_deg.min()) - FOREGROUND_GAP_DEG)
    return min(int(np.ceil((TOP_DEG - below_deg) / step_deg)), rows)


@kernel(parallel=True, error_model="numpy")
def _draw(  # type: ignore[no-untyped-def]
    image, terrain, viewpoint, ground, air, extinction_per_m, azimuths, tangents, foreground, step, top
):
    """Draw the terrain of all columns over the sky, in the foreground every second row and column only."""
    rows, columns = image.shape[0], image.shape[1]
    for task in prange((columns + STRIPE - 1) // STRIPE):
        buffers = (np.empty(MAX_CROSSINGS + 1), np.empty(MAX_CROSSINGS), np.empty(MAX_CROSSINGS))
        for k in range(task * STRIPE, min((task + 1) * STRIPE, columns)):
            end = foreground if k % 2 else rows
            column = image[:, k]
            filled, tangent = _draw_terrain(
                column,
                terrain,
                viewpoint,
                ground,
                air[k],
                extinction_per_m,
                azimuths[k],
                tangents,
                foreground,
                end,
                step,
                buffers,
            )
            if filled < end:
                # The row that the skyline crosses is terrain by as much of it as lies below the skyline. Its
                # centre is sky where that is less than half, and terrain, whose sky is found one row up,
                # where it is more.
                skyline = (top - np.arctan(tangent)) / step
                i = int(np.floor(skyline + 0.5))
                share = i + 0.5 - skyline
                if i > 0:
                    for c in range(3):
                        behind = column[filled - 1, c]
                        column[i, c] = np.uint8(share * column[filled, c] + (1.0 - share) * behind + 0.5)


@kernel(error_model="numpy")
def _draw_terrain(  # type: ignore[no-untyped-def]
    column,
    terrain,
    viewpoint,
    ground,
    air,
    extinction_per_m,
    azimuth,
    tangents,
    foreground,
    end,
    step,
    buffers,
):
    """Fill one column with terrain from the row above ``end`` upwards.

    Returns the highest row that terrain fills at its centre (``end`` if none) and the skyline's tangent.
    """
    height_m, block_max_m, max_height_m, drop, chunk_m = terrain
    row, col, altitude_m, reach_m, track = viewpoint
    times, z0, z1 = buffers
    rows, cols = height_m.shape
    ray = ray_polynomial(track, azimuth)
    pixel = end - 1
    best = tangents[end] if end < len(tangents) else -np.inf
    d_row = d_col = near = 0.0
    while near < reach_m and pixel >= 0:
        if tangent_bound(max_height_m, altitude_m, drop, near, reach_m) < best:
            break
        far = near + chunk_m
        from_row, from_col = row + d_row, col + d_col
        d_row, d_col = ray_position(ray, far / reach_m)
        if from_row < 0.0 or from_col < 0.0 or from_row > rows - 1.0 or from_col > cols - 1.0:
            break
        by_row, by_col = row + d_row - from_row, col + d_col - from_col
        ceiling = chunk_ceiling(block_max_m, from_row + 0.5 * by_row, from_col + 0.5 * by_col)
        if tangent_bound(ceiling, altitude_m, drop, near, far) > best:
            count = trace_chunk(height_m, from_row, from_col, row + d_row, col + d_col, times, z0, z1)
            for n in range(count):
                if np.isnan(z0[n]):
                    continue
                s0, s1 = near + times[n] * chunk_m, near + times[n + 1] * chunk_m
                highest, _ = piece_maximum(s0, z0[n], s1, z1[n], altitude_m, drop)
                if highest <= best:
                    continue
                best = highest
                slope = (z1[n] - z0[n]) / (s1 - s0)
                rise = z0[n] - altitude_m - slope * s0
                bend = drop * 0.5 * (s0 + s1)
                through = np.exp(-extinction_per_m * s1)
                while pixel >= 0 and tangents[pixel] <= best:
                    if pixel > foreground and (pixel - foreground) % 2:
                        pixel -= 1
                        continue
                    closing = tangents[pixel] - slope + bend
                    s = min(max(rise / closing, s0), s1) if closing != 0.0 else s1
                    t = (s - near) / chunk_m
                    across_m = s * step
                    along_m = across_m * (1.0 + tangents[pixel] ** 2) / max(abs(closing), 0.02)
                    radiance = ground_radiance(
                        ground,
                        from_row + t * by_row,
                        from_col + t * by_col,
                        z0[n] + slope * (s - s0),
                        s,
                        max(across_m**0.4 * along_m**0.6, 1e-3),
                    )
                    for c in range(3):
                        seen = radiance[c] * through[c] + air[c] * (1.0 - through[c])
                        column[pixel, 2 - c] = np.uint8(255.0 * toned(seen) + 0.5)
                    pixel -= 1
        near = far
    return pixel + 1, best


def _fill_foreground(image: NDArray[np.uint8], foreground: int) -> None:
    """Interpolate the odd rows and columns that ``_draw`` omits."""
    part = image[foreground:]
    if len(part) < 3:
        part[:, 1::2] = part[:, 0::2]
        return
    part[1:-1:2, 0::2] = _mean(part[0:-2:2, 0::2], part[2::2, 0::2])
    if len(part) % 2 == 0:
        part[-1] = part[-2]
    part[:, 1::2] = _mean(part[:, 0::2], np.roll(part[:, 0::2], -1, axis=1))


def _mean(one: NDArray[np.uint8], other: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Mean of bytes without a wider type: the common bits and half of the others."""
    return (one & other) + ((one ^ other) >> 1)
