"""Daylight: sky radiance, illumination of the ground, and haze.

Radiances are linear RGB, relative to a white surface facing the sun. The models are fits to the look of photographs,
not radiometry.
"""

from dataclasses import dataclass

import numpy as np
from numba import prange
from numpy.typing import NDArray

from sim.jit import kernel
from sim.render.noise_texture import WAVELENGTH, noise_at
from sim.world.true_values import Air

Array = NDArray[np.float64]

KOSCHMIEDER = 3.912  # -ln(0.02): at the visibility a black ridge keeps 2 % of its contrast
EXTINCTION_TINT = np.array([0.80, 1.0, 1.35])  # air scatters blue more
CLOUD_BASE_M = 1800.0  # above the eye
CLOUD_COVER = {"clear": 0.0, "scattered": 0.35, "broken": 0.65, "overcast": 1.0}
SKY_STEP_DEG = 0.12
TONE = 2.1  # exposure: display = sqrt(1 - exp(-TONE radiance))


@dataclass(frozen=True)
class Daylight:
    """Light of one moment."""

    sun: Array  # (3,) direction to the sun in east, north, up
    sun_radiance: Array  # (3,) of a white surface facing the sun, sunlight only
    sky_radiance: Array  # (3,) of a level white surface, skylight only
    zenith: Array  # (3,) radiance of the clear sky overhead
    horizon: Array  # (3,) and low down
    extinction_per_m: Array  # (3,)
    cloud_cover: float


def daylight(air: Air) -> Daylight:
    """Light and haze of the day's weather."""
    azimuth, elevation = np.radians([air.sun_azimuth_deg, air.sun_elevation_deg])
    sun = np.array(
        [np.sin(azimuth) * np.cos(elevation), np.cos(azimuth) * np.cos(elevation), np.sin(elevation)]
    )
    air_mass = 1.0 / max(np.sin(elevation) + 0.08, 0.05)
    transmitted = np.exp(-np.array([0.06, 0.11, 0.22]) * air_mass) * 1.15
    day = np.clip((air.sun_elevation_deg + 6.0) / 20.0, 0.15, 1.0)
    cover = CLOUD_COVER[air.sky]
    grey = np.array([0.47, 0.49, 0.52]) * day
    open_share = np.clip(1.0 - cover, 0.0, 1.0) ** 0.5
    overcast = cover >= 1.0
    sun_share = 0.0 if overcast else 1.0 - 0.25 * cover
    return Daylight(
        sun=sun,
        sun_radiance=transmitted * sun_share * np.clip((air.sun_elevation_deg + 1.0) / 4.0, 0.0, 1.0),
        sky_radiance=open_share * np.array([0.16, 0.21, 0.30]) * day + (1.0 - open_share) * 0.75 * grey,
        zenith=grey * 1.05 if overcast else np.array([0.09, 0.20, 0.46]) * day,
        horizon=grey * 1.10 if overcast else np.array([0.62, 0.71, 0.82]) * day * (0.6 + 0.4 * transmitted),
        extinction_per_m=KOSCHMIEDER / (air.visibility_km * 1000.0) * EXTINCTION_TINT,
        cloud_cover=cover,
    )


def air_light(light: Daylight, azimuth_deg: Array) -> Array:
    """Radiance (n, 3) of an infinite depth of air near the horizon, by azimuth: far ridges fade into it."""
    azimuth = np.radians(azimuth_deg)
    level = np.column_stack([np.sin(azimuth), np.cos(azimuth), np.zeros_like(azimuth)])
    away = np.arccos(np.clip(level @ light.sun, -1.0, 1.0))
    glow = np.outer(np.exp(-away / 0.5), 0.35 * light.sun_radiance)
    radiance: Array = 0.93 * (light.horizon + glow)
    return radiance


def sky_picture(
    light: Daylight, texture: NDArray[np.float32], top_deg: float, bottom_deg: float
) -> NDArray[np.uint8]:
    """The sky all around (rows, columns, 3): blue, green, red.

    Rows go down from ``top_deg`` to ``bottom_deg`` at least, columns clockwise from north to north again,
    both in steps of SKY_STEP_DEG.
    """
    rows = int(np.ceil((top_deg - bottom_deg) / SKY_STEP_DEG)) + 1
    columns = round(360.0 / SKY_STEP_DEG)
    sky = np.empty((rows, columns + 1, 3), dtype=np.uint8)
    _paint_sky(
        sky[:, :-1],
        np.radians(top_deg - SKY_STEP_DEG * np.arange(rows)),
        np.radians(SKY_STEP_DEG * np.arange(columns)),
        texture,
        light.sun,
        light.sun_radiance,
        light.zenith,
        light.horizon,
        light.extinction_per_m,
        light.cloud_cover,
    )
    sky[:, -1] = sky[:, 0]
    return sky


@kernel(inline="always", error_model="numpy", fastmath=True)
def toned(radiance):  # type: ignore[no-untyped-def]
    """Display value 0..1 of a linear radiance."""
    return np.sqrt(1.0 - np.exp(-TONE * radiance))


@kernel(inline="always", error_model="numpy", fastmath=True)
def _smooth(low, high, x):  # type: ignore[no-untyped-def]
    t = min(max((x - low) / (high - low), 0.0), 1.0)
    return t * t * (3.0 - 2.0 * t)


@kernel(error_model="numpy", fastmath=True)
def _cloud_field(texture, x, y, octaves):  # type: ignore[no-untyped-def]
    """Fractal noise of unit variance, roughly, with billows of some kilometres."""
    total, amplitude, texels_per_m = 0.0, 1.0, WAVELENGTH / 4200.0
    for octave in range(octaves):
        value, _, _ = noise_at(texture, x * texels_per_m + 37.0 * octave, y * texels_per_m - 17.0 * octave)
        total += amplitude * value
        amplitude *= 0.56
        texels_per_m *= 2.13
    return total / 1.2


@kernel(parallel=True, error_model="numpy", fastmath=True)
def _paint_sky(  # type: ignore[no-untyped-def]
    sky, elevations, azimuths, texture, sun, sun_radiance, zenith, horizon, extinction_per_m, cover
):
    overcast = cover >= 1.0
    threshold = 1.1 - 2.2 * cover
    for i in prange(len(elevations)):
        elevation = elevations[i]
        sine = np.sin(max(elevation, 0.0))
        low = 0.55 * np.exp(-sine / 0.09) + 0.45 * np.exp(-sine / 0.35)
        for j in range(len(azimuths)):
            east, north = np.sin(azimuths[j]), np.cos(azimuths[j])
            towards = np.cos(elevation) * (east * sun[0] + north * sun[1]) + np.sin(elevation) * sun[2]
            away = np.arccos(min(max(towards, -1.0), 1.0))
            glow = 0.35 * np.exp(-away / 0.5) * (0.4 + 0.6 * low) + 0.9 * np.exp(-away / 0.09)
            if away < 0.0047:
                glow += 30.0
            density, shade = 0.0, 0.0
            fade = 0.0
            if cover > 0.0 and sine > 0.004:
                reach = CLOUD_BASE_M / (sine + 0.012)
                x, y = east * reach, north * reach
                fade = np.exp(-extinction_per_m[1] * 0.7 * reach)
                octaves = 6 if sine > 0.05 else 4
                field = _cloud_field(texture, x, y, octaves)
                if overcast:
                    density, shade = 1.0, 0.10 * field
                else:
                    density = _smooth(threshold, threshold + 0.75, field)
                    lit = _cloud_field(texture, x + 350.0 * sun[0], y + 350.0 * sun[1], octaves)
                    shade = 0.32 * min(max(field - lit, -1.0), 1.0) - 0.20 * _smooth(
                        threshold + 0.6, threshold + 2.4, field
                    )
            for c in range(3):
                radiance = zenith[c] * (1.0 - low) + horizon[c] * low + glow * sun_radiance[c]
                if density > 0.0:
                    bright = horizon[c] if overcast else 0.62 * sun_radiance[c] + 0.22 * horizon[c] + 0.08
                    bright *= 1.0 + shade
                    silver = 0.0 if overcast else 0.5 * np.exp(-away / 0.2) * sun_radiance[c]
                    clouded = density * fade
                    radiance = radiance * (1.0 - clouded) + clouded * (bright + silver)
                sky[i, j, 2 - c] = np.uint8(255.0 * toned(radiance) + 0.5)
