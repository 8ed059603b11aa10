"""Shading of the ground: grass, scrub, forest, rock and snow under sun, shadow and sky light.

Textures are fixed to the terrain: the same rock appears at the same place from any viewpoint.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.jit import kernel
from sim.render.noise_texture import WAVELENGTH, noise_at
from sim.render.sky import Daylight
from sim.world.surface import Surface

SHORTEST_WAVE_M = 0.12
LONGEST_WAVE_M = 1600.0
WAVE_RATIO = 0.27  # of one octave's length to the one before
SHADOW_SOFTNESS_M = 6.0
ROUGHNESS = 0.16  # slope that one octave of relief adds


class Ground(NamedTuple):
    """Input of the compiled shading, as a plain tuple of arrays and numbers."""

    slope_east: NDArray[np.float32]  # (rows, cols), metres of height a metre
    slope_north: NDArray[np.float32]
    lit: NDArray[np.float32]  # (rows, cols), share of the sun that arrives
    texture: NDArray[np.float32]
    south_m: float  # extent of a cell
    east_m: float
    low_m: float
    high_m: float
    snow_line_m: float
    sun: NDArray[np.float64]
    sun_radiance: NDArray[np.float64]
    sky_radiance: NDArray[np.float64]


def prepare_ground(
    surface: Surface, light: Daylight, texture: NDArray[np.float32], snow_line_m: float | None
) -> Ground:
    """Slopes at the lattice points, cast shadows, and the height range that controls vegetation."""
    height_m = surface.height_m
    south_m, east_m = surface.terrain.cell_size_m()
    slope_east, slope_north = np.zeros_like(height_m), np.zeros_like(height_m)
    slope_east[:, 1:-1] = (height_m[:, 2:] - height_m[:, :-2]) / np.float32(2.0 * east_m)
    slope_north[1:-1] = (height_m[:-2] - height_m[2:]) / np.float32(2.0 * south_m)
    low_m, high_m = np.nanquantile(height_m[::4, ::4], [0.02, 0.995])
    return Ground(
        slope_east=np.nan_to_num(slope_east),
        slope_north=np.nan_to_num(slope_north),
        lit=_cast_shadows(height_m, light.sun, south_m, east_m),
        texture=texture,
        south_m=south_m,
        east_m=east_m,
        low_m=float(low_m),
        high_m=float(max(high_m, low_m + 1.0)),
        snow_line_m=np.inf if snow_line_m is None else snow_line_m,
        sun=light.sun,
        sun_radiance=light.sun_radiance,
        sky_radiance=light.sky_radiance,
    )


def _cast_shadows(
    height_m: NDArray[np.float32], sun: NDArray[np.float64], south_m: float, east_m: float
) -> NDArray[np.float32]:
    """Share of the sun that reaches each lattice point (rows, cols).

    A sweep away from the sun, by rows or columns, whichever the sun is closer to: the shadow's upper edge at a point is
    the one of the neighbour towards the sun, lowered by the sun's slope. Interpolation between two neighbours softens
    edges with distance, like a penumbra.
    """
    level = float(np.hypot(sun[0], sun[1]))
    if level < 1e-6:
        return np.ones_like(height_m)
    to_sun = np.array([-sun[1] / south_m, sun[0] / east_m])  # rows, cols
    by_columns = abs(to_sun[1]) > abs(to_sun[0])
    z = np.nan_to_num(height_m.T if by_columns else height_m, nan=-1e4)
    main, side = (to_sun[1], to_sun[0]) if by_columns else (to_sun[0], to_sun[1])
    fall_m = np.float32(sun[2] / abs(main))
    across = np.arange(z.shape[1]) + side / abs(main)
    lower = np.clip(np.floor(across).astype(int), 0, z.shape[1] - 2)
    weight = np.clip(across - lower, 0.0, 1.0).astype(np.float32)
    shadow_m = np.empty_like(z)
    edge_m = np.full(z.shape[1], -1e4, dtype=np.float32)
    for i in range(len(z)) if main < 0.0 else range(len(z) - 1, -1, -1):
        shadow_m[i] = edge_m[lower] * (1.0 - weight) + edge_m[lower + 1] * weight - fall_m
        edge_m = np.maximum(shadow_m[i], z[i])
    lit = np.clip(0.5 + (z - shadow_m) / SHADOW_SOFTNESS_M, 0.0, 1.0).astype(np.float32)
    return np.ascontiguousarray(lit.T if by_columns else lit)


@kernel(inline="always", error_model="numpy", fastmath=True)
def _ramp(low, high, x):  # type: ignore[no-untyped-def]
    t = min(max((x - low) / (high - low), 0.0), 1.0)
    return t * t * (3.0 - 2.0 * t)


@kernel(inline="always", error_model="numpy", fastmath=True)
def _lattice_mean(values, i, j, fi, fj):  # type: ignore[no-untyped-def]
    upper = values[i, j] * (1.0 - fj) + values[i, j + 1] * fj
    lower = values[i + 1, j] * (1.0 - fj) + values[i + 1, j + 1] * fj
    return upper * (1.0 - fi) + lower * fi


@kernel(inline="always", error_model="numpy", fastmath=True)
def _relief(texture, x, y, footprint_m):  # type: ignore[no-untyped-def]
    """Noise at a place, of all wavelengths that a pixel resolves.

    Returns:
        Coarse noise (hundreds of metres: where what grows), patches (tens of metres), fine noise (below), and
        the slopes along x and y of the roughness.
    """
    coarse = patches = fine = slope_x = slope_y = 0.0
    texels_per_m = WAVELENGTH / LONGEST_WAVE_M
    shown = 0.35 * LONGEST_WAVE_M / footprint_m
    octave = 0
    while texels_per_m < WAVELENGTH / SHORTEST_WAVE_M:
        weight = _ramp(0.25, 0.6, shown)
        if weight <= 0.0:
            break
        value, along_x, along_y = noise_at(
            texture, x * texels_per_m + 37.0 * octave, y * texels_per_m - 91.0 * octave
        )
        value *= weight
        if octave < 3:
            coarse += value * (0.75 - 0.125 * octave)
        else:
            fine += 0.5 * value
        if octave >= 1:
            slope_x += weight * along_x
            slope_y += weight * along_y
            if octave <= 4:
                patches += 0.45 * value
        texels_per_m *= 1.0 / WAVE_RATIO
        shown *= WAVE_RATIO
        octave += 1
    return coarse, patches, fine, ROUGHNESS * slope_x, ROUGHNESS * slope_y


@kernel(error_model="numpy", fastmath=True)
def ground_radiance(ground, row, col, height_m, distance_m, footprint_m):  # type: ignore[no-untyped-def]
    """Linear RGB radiance of the ground at a lattice position.

    ``footprint_m`` is the size of a pixel on the ground: finer texture is omitted, which avoids aliasing on distant
    slopes.
    """
    i = min(max(int(row), 0), ground.lit.shape[0] - 2)
    j = min(max(int(col), 0), ground.lit.shape[1] - 2)
    fi, fj = row - i, col - j
    slope_east = _lattice_mean(ground.slope_east, i, j, fi, fj)
    slope_north = _lattice_mean(ground.slope_north, i, j, fi, fj)
    lit = _lattice_mean(ground.lit, i, j, fi, fj)
    coarse, patches, fine, bump_x, bump_y = _relief(
        ground.texture, col * ground.east_m, -row * ground.south_m, footprint_m
    )

    # Rock where it is steep; forest in patches, on slopes that face north and not too high; scrub and grass
    # elsewhere.
    steep = np.sqrt(slope_east * slope_east + slope_north * slope_north)
    level = (height_m - ground.low_m) / (ground.high_m - ground.low_m)
    alpine = max(level - 0.6, 0.0)
    rock = _ramp(0.62, 0.95, steep + 0.10 * coarse + 0.08 * patches + 0.25 * alpine)
    moist = 0.75 * coarse + 0.35 * patches - 0.8 * slope_north + 0.2 - 1.3 * alpine
    wooded = _ramp(-0.25, 0.35, moist) * (1.0 - rock) * _ramp(60.0, 220.0, distance_m)
    scrub = _ramp(-0.1, 1.1, 0.4 - 0.55 * patches - 0.35 * fine) * (1.0 - rock) * (1.0 - wooded)
    grass = 1.0 - rock - wooded - scrub
    snow = 0.0
    if height_m > ground.snow_line_m - 300.0:
        cling = 70.0 * coarse - 130.0 * max(steep - 0.7, 0.0)
        snow = _ramp(-60.0, 60.0, height_m - ground.snow_line_m + cling)

    mottle = max(1.0 + 0.12 * patches + 0.16 * fine, 0.45)
    crowns = wooded * max(1.0 + 0.30 * fine, 0.25)
    dry = 0.5 + 0.25 * coarse
    red = (grass * (0.235 + 0.05 * dry) + scrub * 0.105 + rock * 0.235) * mottle + 0.042 * crowns
    green = (grass * (0.205 + 0.02 * dry) + scrub * 0.115 + rock * 0.215) * mottle + 0.060 * crowns
    blue = (grass * 0.105 + scrub * 0.062 + rock * 0.190) * mottle + 0.033 * crowns
    red += snow * (0.80 - red)
    green += snow * (0.83 - green)
    blue += snow * (0.88 - blue)

    roughness = (0.6 + 1.6 * rock + 1.5 * wooded) * (1.0 - 0.8 * snow)
    normal_east, normal_north = -(slope_east + roughness * bump_x), -(slope_north + roughness * bump_y)
    scale = 1.0 / np.sqrt(1.0 + normal_east * normal_east + normal_north * normal_north)
    cosine = (normal_east * ground.sun[0] + normal_north * ground.sun[1] + ground.sun[2]) * scale
    facing = lit * max(cosine, 0.0)
    open_sky = 0.35 + 0.65 * scale
    return (
        red * (ground.sun_radiance[0] * facing + ground.sky_radiance[0] * open_sky),
        green * (ground.sun_radiance[1] * facing + ground.sky_radiance[1] * open_sky),
        blue * (ground.sun_radiance[2] * facing + ground.sky_radiance[2] * open_sky),
    )
