"""Depth panorama: distance and brightness of the terrain in every direction of a view."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from localizer.dem.horizon import Terrain
from localizer.predict.views import Standpoint, View, along

Floats = NDArray[np.float64]

FIRST_CELLS = 0.1
NEAR_SHARE, FAR_SHARE = 0.05, 0.004
"""Spacing of the samples along a ray, as shares of their distance: at most the first, near the second far away."""
FINEST_CELLS, COARSEST_CELLS = 0.4, 4.0
"""Least and largest far spacing of the samples, in cells."""
COLUMN_DEG = 0.1
ROWS = 420


@dataclass(frozen=True)
class Panorama:
    """``distance_m``, ``brightness`` (rows, columns): NaN in the sky. Row 0 is at ``top_deg``, column 0 leftmost."""

    offset_deg: Floats
    """(columns,) azimuths from the view's middle."""
    top_deg: float
    bottom_deg: float
    distance_m: Floats
    brightness: Floats
    """Hill shading with light from the north-west, 0 to 1."""

    def at(self, offset_deg: Floats, elevation_deg: Floats) -> tuple[Floats, Floats]:
        """Distance and brightness in directions, the nearest pixel's; those of the nearest border outside."""
        rows, columns = self.distance_m.shape
        row = (self.top_deg - elevation_deg) / (self.top_deg - self.bottom_deg) * (rows - 1)
        span_deg = self.offset_deg[-1] - self.offset_deg[0]
        column = (offset_deg - self.offset_deg[0]) / span_deg * (columns - 1)
        i = np.clip(np.round(row), 0, rows - 1).astype(int)
        j = np.clip(np.round(column), 0, columns - 1).astype(int)
        return self.distance_m[i, j], self.brightness[i, j]


def panorama(terrain: Terrain, place: Standpoint, seen: View, bottom_deg: float, top_deg: float) -> Panorama:
    """The terrain of a view between two elevations.

    Rays are sampled, which is finer than any pixel of a picture but not exact: draw the skyline itself from the view.
    """
    columns = max(2, int(np.ceil(seen.width_deg / COLUMN_DEG)) + 1)
    offset_deg = np.linspace(seen.offset_deg[0], seen.offset_deg[-1], columns)
    distance_m = _samples_m(terrain)
    row, col = along(terrain, place, seen.azimuth_deg + offset_deg[:, None], distance_m[None, :])
    z_m = terrain.dem.ground_m(row, col)
    tangent = (z_m - place.altitude_m) / distance_m - terrain.drop_per_m2 * distance_m
    highest_yet = np.maximum.accumulate(np.where(np.isnan(tangent), -np.inf, tangent), axis=1)
    elevation_deg = np.linspace(top_deg, bottom_deg, ROWS)
    skyline_deg = np.interp(offset_deg, seen.offset_deg, seen.elevation_deg)
    out_m, brightness = np.full((2, ROWS, columns), np.nan)
    for j in range(columns):
        hit = np.searchsorted(highest_yet[j], np.tan(np.radians(elevation_deg)))
        # terrain between the samples counts as the highest sample
        last = int(np.argmax(highest_yet[j]))
        below = elevation_deg <= skyline_deg[j]
        chosen = np.minimum(hit, last)[below]
        out_m[below, j] = distance_m[chosen]
        brightness[below, j] = _brightness(terrain, row[j, chosen], col[j, chosen])
    return Panorama(offset_deg, top_deg, bottom_deg, out_m, brightness)


def _samples_m(terrain: Terrain) -> Floats:
    """Distances from FIRST_CELLS to across the whole DEM."""
    dem, cell_m = terrain.dem, terrain.cell_m
    farthest_m = float(np.hypot(dem.rows * dem.spacing_ns_m, dem.cols * dem.spacing_ew_m))
    out = [FIRST_CELLS * cell_m]
    while out[-1] < farthest_m:
        here_m = out[-1]
        far_step_m = np.clip(FAR_SHARE * here_m, FINEST_CELLS * cell_m, COARSEST_CELLS * cell_m)
        out.append(here_m + min(NEAR_SHARE * here_m, float(far_step_m)))
    return np.array(out)


def _brightness(terrain: Terrain, row: Floats, col: Floats) -> Floats:
    """As ``relief.hillshade``, at single places and over two cells."""
    dem = terrain.dem
    to_east = (dem.ground_m(row, col + 1.0) - dem.ground_m(row, col - 1.0)) / (2.0 * dem.spacing_ew_m)
    to_north = (dem.ground_m(row - 1.0, col) - dem.ground_m(row + 1.0, col)) / (2.0 * dem.spacing_ns_m)
    shade = (np.sqrt(0.5) + 0.5 * to_east - 0.5 * to_north) / np.sqrt(1.0 + to_east**2 + to_north**2)
    return np.asarray(np.clip(np.nan_to_num(shade, nan=np.sqrt(0.5)), 0.0, 1.0))
