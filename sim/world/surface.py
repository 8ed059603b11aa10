"""The terrain as a triangulated surface, with heights, slopes, horizons and profiles.

Every cell of the lattice is split by its north-west to south-east diagonal. A line of sight follows a geodesic of the
WGS84 ellipsoid at a true azimuth. Its track through the lattice is cut into chunks a few cells long that count as
straight (their sagitta is millimetres), and each crossing with a row line, a column line or a diagonal is computed
exactly. Between crossings the height is linear in distance, so the polyline is the surface itself, not a sampling.

The apparent drop at distance x is (1 - k) x**2 / (2 R).
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from pyproj import Geod

from sim.errors import SimulationError
from sim.world.lines_of_sight import (
    AZIMUTHS_PER_TASK,
    BLOCK_CELLS,
    CHUNK_CELLS,
    MAX_CROSSINGS,
    TRACK_DEGREE,
    horizons,
    many_horizons,
    profile_along,
    triangle_at,
)
from sim.world.terrain import Terrain

EARTH_RADIUS_M = 6371008.8
REFRACTION = 0.13
GEOD = Geod(ellps="WGS84")

MAX_CHUNK_M = 200.0  # a sagitta of 1 mm or so

TRACK_TOLERANCE_CELLS = 1e-4
_POWERS = [(i, n - i) for n in range(1, TRACK_DEGREE + 1) for i in range(n + 1)]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Observer:
    """An observer above the terrain, with the lattice around it.

    ``track`` holds, for rows and columns, the coefficients of a polynomial in (east, north) / reach_m, east
    and north being distance times sine and cosine of the true azimuth of the geodesic: an azimuthal
    equidistant map, so that along one azimuth the lattice position is a polynomial in distance.
    """

    row: float
    col: float
    altitude_m: float
    reach_m: float
    track: Array  # (2, len(_POWERS))


class Surface:
    """The triangulated terrain."""

    def __init__(self, terrain: Terrain, refraction: float = REFRACTION) -> None:
        self.terrain = terrain
        self.height_m: NDArray[np.float32] = np.ascontiguousarray(terrain.height_m)
        self.block_max_m = _block_maxima(self.height_m)
        self.max_height_m = float(np.nanmax(self.height_m))
        self.drop_per_m2 = (1.0 - refraction) / (2.0 * EARTH_RADIUS_M)
        cell = min(terrain.cell_size_m())
        self.chunk_m = min(CHUNK_CELLS * cell, MAX_CHUNK_M)
        if not cell > 0.0 or CHUNK_CELLS * 3 + 2 > MAX_CROSSINGS:
            raise SimulationError(f"DEM {terrain.name}: its cells have no extent; name another file")

    @property
    def kernel(self) -> tuple[NDArray[np.float32], NDArray[np.float32], float, float, float]:
        """The surface as input of the compiled functions."""
        return self.height_m, self.block_max_m, self.max_height_m, self.drop_per_m2, self.chunk_m

    def height(self, row: float, col: float) -> float:
        """Height of the triangle at a lattice position, metres; NaN in a void or outside."""
        z, _, _ = triangle_at(self.height_m, row, col)
        return float(z)

    def gradient(self, row: float, col: float) -> tuple[float, float]:
        """Slope of the triangle there: metres of height per row and per column."""
        _, per_row, per_col = triangle_at(self.height_m, row, col)
        return float(per_row), float(per_col)

    def slope_deg(self, row: float, col: float) -> float:
        """Steepness of the triangle there; NaN in a void or outside."""
        south_m, east_m = self.terrain.cell_size_m()
        per_row, per_col = self.gradient(row, col)
        return float(np.degrees(np.arctan(np.hypot(per_row / south_m, per_col / east_m))))

    def observer(self, row: float, col: float, altitude_m: float) -> Observer:
        """An observer at a lattice position, ``altitude_m`` above the DEM's datum.

        Raises:
            SimulationError: the lattice around it is too strange for the polynomial that tracks follow.
        """
        rows, cols = self.height_m.shape
        lon, lat = self.terrain.lonlat_deg(row, col)
        corner_lon, corner_lat = self.terrain.lonlat_deg(
            np.array([0.0, 0.0, rows - 1.0, rows - 1.0]), np.array([0.0, cols - 1.0, 0.0, cols - 1.0])
        )
        _, _, corner_m = GEOD.inv(np.full(4, lon), np.full(4, lat), corner_lon, corner_lat)
        reach_m = 1.02 * float(np.max(corner_m)) + self.chunk_m
        fit_at, solve, check_at, check = _track_fit()
        lon_deg, lat_deg = float(lon), float(lat)
        track = solve @ self._lattice_offsets(row, col, lon_deg, lat_deg, fit_at * reach_m)
        seen = self._lattice_offsets(row, col, lon_deg, lat_deg, check_at * reach_m)
        error_cells = float(np.abs(check @ track - seen).max())
        if not error_cells < TRACK_TOLERANCE_CELLS:
            raise SimulationError(
                f"DEM {self.terrain.name}: its grid strays {error_cells:.2g} cells from the track fitted;"
                " cut it to a smaller area"
            )
        return Observer(row, col, altitude_m, reach_m, np.ascontiguousarray(track.T))

    def _lattice_offsets(self, row: float, col: float, lon: float, lat: float, east_north_m: Array) -> Array:
        east, north = east_north_m.T
        count = len(east)
        azimuth = np.degrees(np.arctan2(east, north))
        lons, lats, _ = GEOD.fwd(np.full(count, lon), np.full(count, lat), azimuth, np.hypot(east, north))
        rows, cols = self.terrain.row_col(lons, lats)
        return np.column_stack([rows - row, cols - col])

    def lattice(self, observer: Observer, azimuth_deg: Array, distance_m: Array) -> tuple[Array, Array]:
        """Lattice rows and columns at true azimuths and distances from an observer."""
        azimuth = np.radians(azimuth_deg)
        where = (
            np.column_stack([distance_m * np.sin(azimuth), distance_m * np.cos(azimuth)]) / observer.reach_m
        )
        offset = _monomials(where) @ observer.track.T
        return observer.row + offset[:, 0], observer.col + offset[:, 1]

    def horizon(self, observer: Observer, azimuth_deg: Array) -> tuple[Array, Array]:
        """Elevation angle of the horizon, degrees, and its distance, metres; NaN without terrain."""
        azimuth = np.ascontiguousarray(np.radians(azimuth_deg), dtype=np.float64)
        tangent, distance_m = np.empty_like(azimuth), np.empty_like(azimuth)
        # For few azimuths the overhead of threads exceeds their gain.
        fill = horizons if len(azimuth) <= 2 * AZIMUTHS_PER_TASK else many_horizons
        fill(self.kernel, track_of(observer), azimuth, tangent, distance_m)
        return np.degrees(np.arctan(tangent)), distance_m

    def profile(self, observer: Observer, azimuth_deg: float) -> tuple[Array, Array]:
        """The surface along one true azimuth, from the observer to the edge of the DEM.

        Returns:
            Distances, metres, rising, and heights above the datum, metres; linear in between. A void is a NaN
            height between the two points where it begins and ends.
        """
        azimuth = float(np.radians(azimuth_deg))
        distance_m, height_m = profile_along(self.height_m, self.chunk_m, track_of(observer), azimuth)
        return distance_m, height_m


def track_of(observer: Observer) -> tuple[float, float, float, float, Array]:
    """An observer as input of the compiled functions: row, col, altitude_m, reach_m, track."""
    return observer.row, observer.col, observer.altitude_m, observer.reach_m, observer.track


def _disc(rings: int, spokes: int) -> Array:
    """Points (n, 2) that cover the unit disc, denser at its rim, where polynomial fits are worst."""
    radius = np.sin(0.5 * np.pi * (np.arange(rings) + 1) / rings)
    angle = 2.0 * np.pi * (np.arange(spokes) + 0.3) / spokes
    return np.column_stack([np.outer(radius, np.sin(angle)).ravel(), np.outer(radius, np.cos(angle)).ravel()])


@cache
def _track_fit() -> tuple[Array, Array, Array, Array]:
    """Fit points of the track's polynomial, the least-squares solution there, check points, and the monomials there."""
    fit_at, check_at = _disc(15, 40), _disc(6, 17)
    solve = np.asarray(np.linalg.pinv(_monomials(fit_at)), dtype=np.float64)
    return fit_at, solve, check_at, _monomials(check_at)


def _monomials(east_north: Array) -> Array:
    east, north = east_north.T
    return np.column_stack([east**i * north**j for i, j in _POWERS])


def _block_maxima(height_m: NDArray[np.float32]) -> NDArray[np.float32]:
    """Highest point of each block and its eight neighbours: a chunk centred in the block stays below it."""
    rows, cols = height_m.shape
    padded_rows, padded_cols = (-(-n // BLOCK_CELLS) * BLOCK_CELLS for n in (rows, cols))
    padded = np.full((padded_rows, padded_cols), -np.inf, dtype=np.float32)
    padded[:rows, :cols] = np.where(np.isnan(height_m), -np.inf, height_m)
    blocks = padded.reshape(padded_rows // BLOCK_CELLS, BLOCK_CELLS, padded_cols // BLOCK_CELLS, BLOCK_CELLS)
    rim = np.pad(blocks.max(axis=(1, 3)), 1, constant_values=-np.inf)
    return np.ascontiguousarray(np.lib.stride_tricks.sliding_window_view(rim, (3, 3)).max(axis=(2, 3)))
