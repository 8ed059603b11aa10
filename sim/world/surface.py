"""The terrain as triangles, and what straight lines of sight over it meet.

Every cell of the lattice is split by its north-west to south-east diagonal. A line of sight from an observer
follows a geodesic of the WGS84 ellipsoid at a true azimuth; its track through the lattice is cut into chunks
a few cells long that count as straight (their sagitta is millimetres), and every crossing with a row line, a
column line or a diagonal is met exactly. Between crossings the height is linear in distance, so the polyline
is the surface, not a sampling of it.

The apparent drop at distance x is (1 - k) x**2 / (2 R).
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray
from pyproj import Geod

from sim.errors import SimulationError
from sim.world.terrain import Terrain

EARTH_RADIUS_M = 6371008.8
REFRACTION = 0.13
GEOD = Geod(ellps="WGS84")

CHUNK_CELLS = 8  # length of a straight chunk of track, in the cell's shorter side
MAX_CHUNK_M = 200.0  # a sagitta of 1 mm or so
BLOCK_CELLS = 16  # side of the blocks whose maxima tell invisible chunks; at least a chunk's length
MAX_CROSSINGS = 96  # in one chunk, of three families of lines, with room for slanting lattices
AZIMUTHS_PER_TASK = 64

TRACK_DEGREE = 8  # of the polynomial from metres east and north of the observer to the lattice
TRACK_TOLERANCE_CELLS = 1e-4
_POWERS = [(i, n - i) for n in range(1, TRACK_DEGREE + 1) for i in range(n + 1)]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Observer:
    """An eye above the terrain, with the lattice as it lies around it.

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
        """The surface as the compiled functions take it."""
        return self.height_m, self.block_max_m, self.max_height_m, self.drop_per_m2, self.chunk_m

    def height(self, row: float, col: float) -> float:
        """Height of the triangle at a lattice position, metres; NaN in a void or outside."""
        z, _, _ = _triangle(self.height_m, row, col)
        return float(z)

    def gradient(self, row: float, col: float) -> tuple[float, float]:
        """Slope of the triangle there: metres of height per row and per column."""
        _, per_row, per_col = _triangle(self.height_m, row, col)
        return float(per_row), float(per_col)

    def slope_deg(self, row: float, col: float) -> float:
        """Steepness of the triangle there; NaN in a void or outside."""
        south_m, east_m = self.terrain.cell_size_m()
        per_row, per_col = self.gradient(row, col)
        return float(np.degrees(np.arctan(np.hypot(per_row / south_m, per_col / east_m))))

    def observer(self, row: float, col: float, altitude_m: float) -> Observer:
        """An eye at a lattice position, ``altitude_m`` above the DEM's datum.

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
        # Threads that must wait for each other cost more than a few azimuths are worth.
        fill = _horizons if len(azimuth) <= 2 * AZIMUTHS_PER_TASK else _many_horizons
        fill(self.kernel, track_of(observer), azimuth, tangent, distance_m)
        return np.degrees(np.arctan(tangent)), distance_m

    def profile(self, observer: Observer, azimuth_deg: float) -> tuple[Array, Array]:
        """The surface along one true azimuth, from the observer to the edge of the DEM.

        Returns:
            Distances, metres, rising, and heights above the datum, metres; linear in between. A void is a NaN
            height between the two points where it begins and ends.
        """
        azimuth = float(np.radians(azimuth_deg))
        distance_m, height_m = _profile(self.height_m, self.chunk_m, track_of(observer), azimuth)
        return distance_m, height_m


def track_of(observer: Observer) -> tuple[float, float, float, float, Array]:
    """An observer as the compiled functions take it: row, col, altitude_m, reach_m, track."""
    return observer.row, observer.col, observer.altitude_m, observer.reach_m, observer.track


def _disc(rings: int, spokes: int) -> Array:
    """Points (n, 2) that cover the unit disc, denser at its rim, where a polynomial strays first."""
    radius = np.sin(0.5 * np.pi * (np.arange(rings) + 1) / rings)
    angle = 2.0 * np.pi * (np.arange(spokes) + 0.3) / spokes
    return np.column_stack([np.outer(radius, np.sin(angle)).ravel(), np.outer(radius, np.cos(angle)).ravel()])


@cache
def _track_fit() -> tuple[Array, Array, Array, Array]:
    """Where the track's polynomial is fitted, the least-squares solution there, where it is checked, its terms there."""
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


@njit(cache=True)
def _triangle(height_m, row, col):  # type: ignore[no-untyped-def]
    """Height and its change per row and per column of the triangle at (row, col); NaN where there is none."""
    rows, cols = height_m.shape
    i, j = int(np.floor(row)), int(np.floor(col))
    if i == rows - 1 and row == i:
        i -= 1
    if j == cols - 1 and col == j:
        j -= 1
    if i < 0 or j < 0 or i >= rows - 1 or j >= cols - 1:
        return np.nan, np.nan, np.nan
    z00, z11 = np.float64(height_m[i, j]), np.float64(height_m[i + 1, j + 1])
    if row - i >= col - j:
        z10 = np.float64(height_m[i + 1, j])
        per_row, per_col = z10 - z00, z11 - z10
    else:
        z01 = np.float64(height_m[i, j + 1])
        per_row, per_col = z11 - z01, z01 - z00
    return z00 + (row - i) * per_row + (col - j) * per_col, per_row, per_col


@njit(cache=True)
def ray_polynomial(track, azimuth):  # type: ignore[no-untyped-def]
    """Coefficients (2, TRACK_DEGREE + 1) of row and column offsets in distance / reach on one azimuth."""
    sines, cosines = np.ones(TRACK_DEGREE + 1), np.ones(TRACK_DEGREE + 1)
    for n in range(TRACK_DEGREE):
        sines[n + 1] = sines[n] * np.sin(azimuth)
        cosines[n + 1] = cosines[n] * np.cos(azimuth)
    ray = np.zeros((2, TRACK_DEGREE + 1))
    term = 0
    for n in range(1, TRACK_DEGREE + 1):
        for i in range(n + 1):
            weight = sines[i] * cosines[n - i]
            ray[0, n] += track[0, term] * weight
            ray[1, n] += track[1, term] * weight
            term += 1
    return ray


@njit(cache=True, inline="always")
def ray_position(ray, x):  # type: ignore[no-untyped-def]
    """Row and column offsets at ``x`` = distance / reach."""
    row = col = 0.0
    for n in range(TRACK_DEGREE, 0, -1):
        row = (row + ray[0, n]) * x
        col = (col + ray[1, n]) * x
    return row, col


@njit(cache=True, inline="always")
def _first_crossing(at, step):  # type: ignore[no-untyped-def]
    """When a coordinate next meets a whole number, in steps, and the time between such meetings."""
    if step > 0.0:
        return (np.floor(at) + 1.0 - at) / step, 1.0 / step
    if step < 0.0:
        return (np.ceil(at) - 1.0 - at) / step, -1.0 / step
    return np.inf, np.inf


@njit(cache=True)
def trace_chunk(height_m, row0, col0, row1, col1, times, z0, z1):  # type: ignore[no-untyped-def]
    """Cut a straight track into the triangles it crosses.

    Fills ``times`` (n + 1 fractions of the track from 0 to 1) and, for each of the n pieces, the heights
    ``z0`` and ``z1`` at its two ends, both on the triangle that the piece lies in (NaN in a void and outside
    the lattice). Returns n.
    """
    d_row, d_col = row1 - row0, col1 - col0
    next_row, every_row = _first_crossing(row0, d_row)
    next_col, every_col = _first_crossing(col0, d_col)
    next_diagonal, every_diagonal = _first_crossing(row0 - col0, d_row - d_col)
    count = 0
    t = 0.0
    times[0] = 0.0
    while t < 1.0:
        end = min(next_row, next_col, next_diagonal, 1.0)
        if next_row <= end:
            next_row += every_row
        if next_col <= end:
            next_col += every_col
        if next_diagonal <= end:
            next_diagonal += every_diagonal
        if end - t < 1e-12:
            t = max(t, end)
            continue
        middle = 0.5 * (t + end)
        z, per_row, per_col = _triangle(height_m, row0 + middle * d_row, col0 + middle * d_col)
        half = 0.5 * (end - t) * (d_row * per_row + d_col * per_col)
        z0[count], z1[count] = z - half, z + half
        count += 1
        times[count] = end
        t = end
        if count >= MAX_CROSSINGS:
            break
    return count


@njit(cache=True, inline="always")
def chunk_ceiling(block_max_m, row, col):  # type: ignore[no-untyped-def]
    """Upper bound of the heights along a chunk whose middle lies at (row, col)."""
    i = min(max(int(row) // BLOCK_CELLS, 0), block_max_m.shape[0] - 1)
    j = min(max(int(col) // BLOCK_CELLS, 0), block_max_m.shape[1] - 1)
    return block_max_m[i, j]


@njit(cache=True, inline="always")
def tangent_bound(height_m, altitude_m, drop, near_m, far_m):  # type: ignore[no-untyped-def]
    """Upper bound of the tangent under which anything up to ``height_m`` appears between two distances."""
    rise = height_m - altitude_m
    if rise <= 0.0:
        return rise / far_m - drop * near_m
    if near_m <= 0.0:
        return np.inf
    return rise / near_m - drop * near_m


@njit(cache=True, inline="always")
def piece_maximum(s0, z0, s1, z1, altitude_m, drop):  # type: ignore[no-untyped-def]
    """Largest tangent along one linear piece of surface, and its distance."""
    best, at = (z1 - altitude_m) / s1 - drop * s1, s1
    if s0 > 0.0:
        first = (z0 - altitude_m) / s0 - drop * s0
        if first > best:
            best, at = first, s0
    # Between the ends the tangent is a / s + slope - drop s: with a < 0 it has a maximum, a sphere's own
    # horizon.
    slope = (z1 - z0) / (s1 - s0)
    a = z0 - altitude_m - slope * s0
    if a < 0.0 and drop > 0.0:
        top = np.sqrt(-a / drop)
        if s0 < top < s1:
            tangent = a / top + slope - drop * top
            if tangent > best:
                best, at = tangent, top
    return best, at


@njit(cache=True)
def horizon_tangent(  # type: ignore[no-untyped-def]
    height_m, block_max_m, max_height_m, drop, chunk_m, viewpoint, azimuth, floor, times, z0, z1
):
    """Tangent of the horizon's elevation along one azimuth, and its distance, m.

    NaN where no terrain appears above the tangent ``floor``: a floor just below a good guess saves the look
    at most of the terrain, minus infinity asks for all of it.
    """
    row, col, altitude_m, reach_m, track = viewpoint
    rows, cols = height_m.shape
    ray = ray_polynomial(track, azimuth)
    best, at = floor, np.nan
    d_row, d_col = 0.0, 0.0
    near = 0.0
    while near < reach_m:
        if tangent_bound(max_height_m, altitude_m, drop, near, reach_m) < best:
            break
        far = near + chunk_m
        from_row, from_col = row + d_row, col + d_col
        d_row, d_col = ray_position(ray, far / reach_m)
        if from_row < 0.0 or from_col < 0.0 or from_row > rows - 1.0 or from_col > cols - 1.0:
            break
        middle_row, middle_col = 0.5 * (from_row + row + d_row), 0.5 * (from_col + col + d_col)
        ceiling = chunk_ceiling(block_max_m, middle_row, middle_col)
        if tangent_bound(ceiling, altitude_m, drop, near, far) > best:
            count = trace_chunk(height_m, from_row, from_col, row + d_row, col + d_col, times, z0, z1)
            for n in range(count):
                if np.isnan(z0[n]):
                    continue
                tangent, s = piece_maximum(
                    near + times[n] * chunk_m, z0[n], near + times[n + 1] * chunk_m, z1[n], altitude_m, drop
                )
                if tangent > best:
                    best, at = tangent, s
        near = far
    return (np.nan if np.isnan(at) else best), at


@njit(cache=True)
def _horizons(terrain, viewpoint, azimuths, tangents, distances):  # type: ignore[no-untyped-def]
    """Fill the tangents and distances of the horizon at some azimuths."""
    height_m, block_max_m, max_height_m, drop, chunk_m = terrain
    times, z0, z1 = np.empty(MAX_CROSSINGS + 1), np.empty(MAX_CROSSINGS), np.empty(MAX_CROSSINGS)
    for k in range(len(azimuths)):
        tangents[k], distances[k] = horizon_tangent(
            height_m, block_max_m, max_height_m, drop, chunk_m, viewpoint, azimuths[k], -np.inf, times, z0, z1
        )


@njit(cache=True, parallel=True)
def _many_horizons(terrain, viewpoint, azimuths, tangents, distances):  # type: ignore[no-untyped-def]
    for task in prange((len(azimuths) + AZIMUTHS_PER_TASK - 1) // AZIMUTHS_PER_TASK):
        part = slice(task * AZIMUTHS_PER_TASK, (task + 1) * AZIMUTHS_PER_TASK)
        _horizons(terrain, viewpoint, azimuths[part], tangents[part], distances[part])


@njit(cache=True)
def _profile(height_m, chunk_m, viewpoint, azimuth):  # type: ignore[no-untyped-def]
    row, col, _, reach_m, track = viewpoint
    rows, cols = height_m.shape
    ray = ray_polynomial(track, azimuth)
    times, z0, z1 = np.empty(MAX_CROSSINGS + 1), np.empty(MAX_CROSSINGS), np.empty(MAX_CROSSINGS)
    distance, height = [0.0], [_triangle(height_m, row, col)[0]]
    d_row, d_col = 0.0, 0.0
    near = 0.0
    while near < reach_m:
        from_row, from_col = row + d_row, col + d_col
        if from_row < 0.0 or from_col < 0.0 or from_row > rows - 1.0 or from_col > cols - 1.0:
            break
        d_row, d_col = ray_position(ray, (near + chunk_m) / reach_m)
        count = trace_chunk(height_m, from_row, from_col, row + d_row, col + d_col, times, z0, z1)
        for n in range(count):
            start, end = near + times[n] * chunk_m, near + times[n + 1] * chunk_m
            if np.isnan(z0[n]):
                if not np.isnan(height[-1]):
                    distance.append(0.5 * (start + end))
                    height.append(np.nan)
            else:
                if np.isnan(height[-1]):
                    distance.append(start)
                    height.append(z0[n])
                distance.append(end)
                height.append(z1[n])
        near += chunk_m
    if np.isnan(height[-1]):  # the edge of the DEM is no void
        distance.pop()
        height.pop()
    return np.array(distance), np.array(height)
