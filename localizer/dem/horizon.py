"""The horizon that a digital elevation model has around a place.

The surface is bilinear between the DEM's cell centres, the Earth is curved and its air refracts (contract, "heights over a
curved Earth"). Along a ray the surface is a quadratic between two grid lines, so that the horizon is exact: the largest
tangent at the crossings of grid lines, and the maximum within each stretch between them.

Rays are geodesics. How one runs through the lattice of the DEM is known to second order in the distance
(``geodesy.GeodesicExpansion``), which covers meridian convergence, map scale and geographic grids alike.
"""

from dataclasses import dataclass, replace

import cv2
import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

from localizer.dem.geodesy import GeodesicExpansion, geodesic_end, geodesic_expansion
from localizer.dem.lattice import Dem
from localizer.jit import kernel

EARTH_RADIUS_M = 6371008.8
REFRACTION = 0.13
VOID_M = -20000.0
"""Elevation that stands for a void: so low that it is never on a horizon."""

BLOCKS = (4, 16, 64, 256)
"""Sizes, in cells, of the blocks of the maximum pyramid, by which a ray skips blocks below its line of sight."""

GUESS_MARGIN_M = 0.01
"""Margin on a guessed horizon, larger than the numerical difference between two computations of a height on a ray."""

LARGEST_ROUGHNESS = 5.0
"""Larger roughness counts as this."""
NEAR_CELLS = 2.0
"""A DEM does not resolve terrain nearer than this. Such terrain can occlude the horizon behind it, never lower it."""
DEM_EDGE_CELLS = 3
"""Cells within this distance of the end of the DEM, or of a void, are its edge. A horizon there is unreliable: terrain beyond
may be higher, and cells at the edge are often interpolated."""
LEAST_DECLARED_ERROR_M = 0.1
"""Least error assumed of a DEM of a real place, whatever is declared."""
EXACT_ERROR_M = 0.02
"""Error of an exact DEM: rounding of its values and interpolation."""
LARGEST_ERROR_FACTOR = 4.0
"""Largest plausible error of a DEM over its nominal error."""

Floats = NDArray[np.float64]
Heights = NDArray[np.float32]


@dataclass(frozen=True)
class Terrain:
    """A DEM with what ray casting needs, computed once.

    ``height_m`` (rows, cols) has voids filled with VOID_M; ``cell_ceiling_m`` is the highest corner of each cell.
    ``row_blocks`` has, for each size in BLOCKS one after the other, a flattened matrix: at (i, j) the highest cell that a ray
    can meet while its row runs through block i, having entered it in the columns of block j, the neighbours of j included.
    ``col_blocks`` likewise, rows and columns exchanged. ``geodesics``: how geodesics run through the lattice.
    ``half_cell_relief_m`` (rows, cols): height difference over half a cell. ``dem_edge`` (rows, cols): whether a cell lies
    within DEM_EDGE_CELLS of the end of the DEM or of a void. ``drop_per_m2``: (1 - k) / (2 R). ``roughness`` (rows, cols):
    root mean square second difference around a cell over its mean in the DEM, ``mean_second_difference_m``. The error of a
    DEM grows with it.
    """

    dem: Dem
    geodesics: GeodesicExpansion
    height_m: Heights
    cell_ceiling_m: Heights
    half_cell_relief_m: Heights
    dem_edge: NDArray[np.bool_]
    row_blocks: Heights
    col_blocks: Heights
    highest_m: float
    drop_per_m2: float
    roughness: Heights
    mean_second_difference_m: float

    @property
    def nominal_error_m(self) -> float:
        """Standard deviation of the elevations before it is estimated from residuals.

        It is the declared error, else it grows with cell size and roughness.
        """
        if self.exact:
            return EXACT_ERROR_M
        if self.dem.error_m is not None:
            return max(self.dem.error_m, LEAST_DECLARED_ERROR_M)
        return self._default_error_m

    @property
    def largest_error_m(self) -> float:
        """Largest plausible error at any place. A declared error that is too small does not reduce it below the default's."""
        by_nominal_m = LARGEST_ERROR_FACTOR * self.nominal_error_m
        return by_nominal_m if self.exact else max(by_nominal_m, self._default_error_m)

    @property
    def _default_error_m(self) -> float:
        return max(3.0, 0.05 * self.cell_m, 0.5 * self.mean_second_difference_m)

    @property
    def exact(self) -> bool:
        """Whether the DEM is declared exact (``error_m`` 0).

        Its surface is then the terrain, also between the cells and near the camera.
        """
        return self.dem.error_m == 0.0

    def with_error_model(self) -> "Terrain":
        """The terrain with the default DEM error model, whatever error was declared."""
        return replace(self, dem=replace(self.dem, error_m=None))

    @property
    def near_m(self) -> float:
        """Terrain nearer than this is not resolved; it can only occlude the horizon. 0 for an exact DEM."""
        return 0.0 if self.exact else NEAR_CELLS * self.cell_m

    def roughness_at(self, row: Floats, col: Floats) -> Floats:
        """Roughness (n,) of the cells nearest to lattice positions (n,)."""
        return np.asarray(self.roughness[self._nearest(row, col)], np.float64)

    def is_dem_edge(self, row: Floats, col: Floats) -> NDArray[np.bool_]:
        """Whether lattice positions (n,) lie on the DEM edge or beyond it."""
        return np.asarray(self.dem_edge[self._nearest(row, col)])

    def above_neighbours_m(self, row: float, col: float) -> float:
        """By how much the cell nearest to a lattice position rises above the mean of its four neighbours; 0 if it does not."""
        rows, cols = self.height_m.shape
        i, j = (int(index[0]) for index in self._nearest(np.array([row]), np.array([col])))
        if not (0 < i < rows - 1 and 0 < j < cols - 1):
            return 0.0
        around_m = self.dem.z_m[[i - 1, i + 1, i, i], [j, j, j - 1, j + 1]]
        rise_m = float(self.dem.z_m[i, j]) - float(around_m.mean())
        return max(rise_m, 0.0) if np.isfinite(rise_m) else 0.0

    def _nearest(self, row: Floats, col: Floats) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        rows, cols = self.height_m.shape
        return (
            np.clip(np.rint(row), 0, rows - 1).astype(np.int64),
            np.clip(np.rint(col), 0, cols - 1).astype(np.int64),
        )

    @property
    def cell_m(self) -> float:
        """Mean spacing of the cells in metres."""
        return float(np.sqrt(abs(self.dem.spacing_ns_m * self.dem.spacing_ew_m)))


def prepare_terrain(dem: Dem, refraction: float = REFRACTION) -> Terrain:
    """Prepare a DEM for ray casting."""
    height = np.where(np.isfinite(dem.z_m), dem.z_m, VOID_M).astype(np.float32)
    bend_m = _second_differences_m(dem.z_m)
    mean_second_difference_m = float(bend_m.mean())
    return Terrain(
        dem=dem,
        geodesics=geodesic_expansion(dem),
        height_m=np.ascontiguousarray(height),
        cell_ceiling_m=_cell_ceilings(height),
        half_cell_relief_m=half_cell_relief_m(height),
        dem_edge=_dem_edge(dem.z_m),
        row_blocks=_block_maxima(height),
        col_blocks=_block_maxima(np.ascontiguousarray(height.T)),
        highest_m=float(height.max()),
        drop_per_m2=(1.0 - refraction) / (2.0 * EARTH_RADIUS_M),
        roughness=np.minimum(bend_m / max(mean_second_difference_m, 1e-3), LARGEST_ROUGHNESS),
        mean_second_difference_m=mean_second_difference_m,
    )


def at_dem_edge(
    terrain: Terrain, row: float, col: float, azimuth_rad: Floats, distance_m: Floats
) -> NDArray[np.bool_]:
    """Whether the horizon (n,), at these distances from a place, lies at the DEM edge or (NaN) beyond it."""
    reach_m = np.nan_to_num(distance_m)
    coefficients = terrain.geodesics.at(row, col)[0]
    there = geodesic_end(coefficients, row, col, reach_m * np.sin(azimuth_rad), reach_m * np.cos(azimuth_rad))
    return np.asarray(np.isnan(distance_m) | terrain.is_dem_edge(*there))


def half_cell_relief_m(height_m: Heights) -> Heights:
    """Height difference over half a cell: half the largest difference from a neighbour, (rows, cols)."""
    ground = np.where(height_m > VOID_M, height_m, np.nan)
    steps = np.zeros_like(ground)
    for axis in (0, 1):
        difference = np.abs(np.diff(ground, axis=axis))
        difference = np.where(np.isfinite(difference), difference, 0.0)
        before = np.pad(difference, [(1, 0) if a == axis else (0, 0) for a in (0, 1)])
        after = np.pad(difference, [(0, 1) if a == axis else (0, 0) for a in (0, 1)])
        steps = np.maximum(steps, np.maximum(before, after))
    return np.asarray(0.5 * steps, np.float32)


def _dem_edge(z_m: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Cells within DEM_EDGE_CELLS of a void or of the end of the DEM."""
    void = np.pad(~np.isfinite(z_m), DEM_EDGE_CELLS, constant_values=True).astype(np.uint8)
    near = cv2.dilate(void, np.ones((2 * DEM_EDGE_CELLS + 1,) * 2, np.uint8))
    return np.ascontiguousarray(
        near[DEM_EDGE_CELLS:-DEM_EDGE_CELLS, DEM_EDGE_CELLS:-DEM_EDGE_CELLS].astype(bool)
    )


def _second_differences_m(z_m: NDArray[np.float32]) -> Heights:
    """Root mean square second difference around each cell; its mean over the DEM where a neighbour is void."""
    z = z_m.astype(np.float32)
    square = np.full(z.shape, np.nan, np.float32)
    down = z[:-2, 1:-1] - 2.0 * z[1:-1, 1:-1] + z[2:, 1:-1]
    across = z[1:-1, :-2] - 2.0 * z[1:-1, 1:-1] + z[1:-1, 2:]
    square[1:-1, 1:-1] = down**2 + across**2
    known = np.isfinite(square)
    square[~known] = square[known].mean() if known.any() else 0.0
    return np.asarray(np.sqrt(np.maximum(cv2.blur(square, (3, 3)), 0.0)), np.float32)


def horizon(
    terrain: Terrain, row: ArrayLike, col: ArrayLike, altitude_m: ArrayLike, azimuth_deg: ArrayLike
) -> tuple[Floats, Floats]:
    """Elevation angle of the horizon in degrees and its distance in metres, each (n, m).

    ``row``, ``col``, ``altitude_m``: (n,) observers, anywhere between the cells or outside the grid; the altitude is the
    eye's, above the DEM's datum. ``azimuth_deg``: true, (m,) for all or (n, m) for each. Where a ray meets no terrain the
    angle is -90 and the distance NaN.
    """
    rows, cols, altitudes = (np.atleast_1d(np.asarray(a, float)) for a in (row, col, altitude_m))
    rows, cols, altitudes = np.broadcast_arrays(rows, cols, altitudes)
    azimuth = np.radians(
        np.broadcast_to(
            np.atleast_1d(np.asarray(azimuth_deg, float)),
            (len(rows), np.shape(azimuth_deg)[-1]) if np.ndim(azimuth_deg) else (len(rows), 1),
        )
    )
    tangent, distance = horizon_tangents(
        terrain,
        np.ascontiguousarray(rows),
        np.ascontiguousarray(cols),
        np.ascontiguousarray(altitudes),
        azimuth,
    )
    return np.degrees(np.arctan(tangent)), distance


def horizon_tangents(
    terrain: Terrain, row: Floats, col: Floats, altitude_m: Floats, azimuth_rad: Floats
) -> tuple[Floats, Floats]:
    """As ``horizon`` for contiguous arrays (n,) and azimuths (n, m) in radians; tangents instead of angles."""
    return _horizons(
        terrain.height_m,
        terrain.cell_ceiling_m,
        terrain.row_blocks,
        terrain.col_blocks,
        terrain.highest_m,
        terrain.drop_per_m2,
        terrain.geodesics.at(row, col),
        row,
        col,
        altitude_m,
        np.ascontiguousarray(azimuth_rad),
    )


def _cell_ceilings(height: Heights) -> Heights:
    """The highest corner of the cell between (i, j) and (i + 1, j + 1), at (i, j); the last row and column are padded."""
    out = np.full_like(height, VOID_M)
    down = np.maximum(height[:-1], height[1:])
    out[:-1, :-1] = np.maximum(down[:, :-1], down[:, 1:])
    return out


def horizon_around(
    terrain: Terrain,
    row: float,
    col: float,
    altitude_m: float,
    azimuth_rad: Floats,
    guess_m: Floats | None = None,
    beyond_m: float = 0.0,
) -> tuple[Floats, Floats]:
    """Tangents and distances (m,) of the horizon of one observer in the directions (m,).

    ``guess_m``: distances (m,) at which the horizon is likely, say because it was there from nearby; NaN elsewhere. They save
    time and do not change the result. ``beyond_m``: nearer terrain is ignored. Runs on one thread: for the few rays of a fit,
    more threads cost more than they save.
    """
    return _horizon_around(
        terrain.height_m,
        terrain.cell_ceiling_m,
        terrain.row_blocks,
        terrain.col_blocks,
        terrain.highest_m,
        terrain.drop_per_m2,
        terrain.geodesics.at(np.array([row]), np.array([col]))[0],
        row,
        col,
        altitude_m,
        azimuth_rad,
        np.full(len(azimuth_rad), np.nan) if guess_m is None else guess_m,
        beyond_m,
    )


def _block_maxima(height: Heights) -> Heights:
    """For each size in BLOCKS the maxima over so many rows (and the row before and after) by three blocks of columns, flat."""
    return np.concatenate([_dilated_maxima(height, size).ravel() for size in BLOCKS])


def _dilated_maxima(height: Heights, size: int) -> Heights:
    rows, cols = height.shape
    down, across = -(-rows // size), -(-cols // size)
    bands = np.array(
        [height[max(i * size - 1, 0) : (i + 1) * size + 1].max(axis=0) for i in range(down)], np.float32
    )
    firsts = [max((j - 1) * size - 1, 0) for j in range(across)]
    return np.column_stack(
        [bands[:, first : (j + 2) * size + 1].max(axis=1) for j, first in enumerate(firsts)]
    )


@kernel(inline=True)
def _interior_maximum(
    z0: float, z1: float, twist: float, s0: float, ds: float, eye: float, drop: float
) -> tuple[float, float]:
    """Largest tangent inside a segment and its distance; -inf if one of the ends is higher.

    The height at t in 0..1 is z0 + t (z1 - z0) + twist (t^2 - t), the distance s0 + t ds: the tangent's derivative vanishes
    at the root of a quadratic equation.
    """
    alpha = z0 - eye - drop * s0 * s0
    gamma = twist - drop * ds * ds
    beta = z1 - z0 - twist - 2.0 * drop * s0 * ds
    inside = s0 * s0 - ds * (beta * s0 - alpha * ds) / gamma
    if inside <= 0.0:
        return -np.inf, np.nan
    t = (np.sqrt(inside) - s0) / ds
    if t <= 0.0 or t >= 1.0:
        return -np.inf, np.nan
    s = s0 + t * ds
    return (alpha + (beta + gamma * t) * t) / s, s


@kernel(inline=True)
def _first_line(start: float, a1: float, a2: float, s1: float, s2: float, step: int, beyond: float) -> float:
    """Distance of the first grid line that a ray meets beyond a distance; 0 for all of the ray."""
    if beyond <= 0.0:
        return 0.0
    at = start + (a1 + a2 * beyond) * beyond
    offset = (np.floor(at) + 1.0 if step > 0 else np.ceil(at) - 1.0) - start
    return float((s1 + s2 * offset) * offset)


@kernel()
def ray_horizon(
    height: Heights,
    cell_ceilings: Heights,
    row_blocks: Heights,
    col_blocks: Heights,
    highest: float,
    drop: float,
    coefficients: Floats,
    row: float,
    col: float,
    eye: float,
    azimuth: float,
    guess: float,
    beyond: float,
) -> tuple[float, float]:
    """Tangent and distance of the horizon along one ray; (-inf, NaN) where it meets no terrain.

    ``guess``: a distance at which the horizon may be, or NaN; it changes the time taken, not the answer. ``beyond``: terrain
    nearer than this is ignored, up to the first grid line behind it.

    The ray is followed along the lattice axis on which it moves faster (``major``), from one grid line to the next. A block
    of grid lines is skipped, the largest first, if its highest cell lies below the line of sight to the horizon found so far.
    """
    east, north = np.sin(azimuth), np.cos(azimuth)
    row_1 = coefficients[0, 0] * east + coefficients[0, 1] * north
    row_2 = (
        coefficients[0, 2] * east * east
        + coefficients[0, 3] * east * north
        + coefficients[0, 4] * north * north
    )
    col_1 = coefficients[1, 0] * east + coefficients[1, 1] * north
    col_2 = (
        coefficients[1, 2] * east * east
        + coefficients[1, 3] * east * north
        + coefficients[1, 4] * north * north
    )
    along_rows = abs(row_1) > abs(col_1)
    if along_rows:
        start, a1, a2, minor_start, b1, b2 = row, row_1, row_2, col, col_1, col_2
        last, minor_last = height.shape[0] - 1, height.shape[1] - 1
    else:
        start, a1, a2, minor_start, b1, b2 = col, col_1, col_2, row, row_1, row_2
        last, minor_last = height.shape[1] - 1, height.shape[0] - 1
    flat, ceilings = height.ravel(), cell_ceilings.ravel()
    blocks = row_blocks if along_rows else col_blocks
    by_major, by_minor = (height.shape[1], 1) if along_rows else (1, height.shape[1])
    step = 1 if a1 > 0.0 else -1
    # The inverse series: distance as a function of the major coordinate.
    s1, s2 = 1.0 / a1, -a2 / (a1 * a1 * a1)

    first_of_block = 0 if step > 0 else 3  # the first line of a smallest block, modulo its size
    best, best_s = -np.inf, np.nan
    if guess > _first_line(start, a1, a2, s1, s2, step, beyond):
        x0, y0 = start + (a1 + a2 * guess) * guess, minor_start + (b1 + b2 * guess) * guess
        if 0.0 <= x0 < last and 0.0 <= y0 < minor_last:
            i, j = int(x0), int(y0)
            at = i * by_major + j * by_minor
            z00, z01 = flat[at], flat[at + by_minor]
            z10, z11 = flat[at + by_major], flat[at + by_major + by_minor]
            if min(z00, z01, z10, z11) > VOID_M:
                xa, ya = x0 - i, y0 - j
                za = (z00 * (1.0 - ya) + z01 * ya) * (1.0 - xa) + (z10 * (1.0 - ya) + z11 * ya) * xa
                # A little below the ground there, so that what is found along the ray is the same as without a guess.
                best, best_s = (za - GUESS_MARGIN_M - eye) / guess - drop * guess, guess
    x0, y0, d0 = start, minor_start, 0.0  # where the stretch begins: major, minor, distance
    enters = False  # whether no other stretch ends there: at the DEM's end, behind a void
    line = int(np.floor(start)) + 1 if step > 0 else int(np.ceil(start)) - 1
    if (step > 0 and start < 0.0) or (step < 0 and start > last):  # outside, looking in
        line = 0 if step > 0 else last
        d0 = (s1 + s2 * (line - start)) * (line - start)
        x0, y0 = float(line), minor_start + (b1 + b2 * d0) * d0
        line += step
        enters = True

    while 0 <= line <= last:
        offset = line - start
        d1 = (s1 + s2 * offset) * offset
        y1 = minor_start + (b1 + b2 * d1) * d1
        sight = eye + (best + drop * d0) * d0
        lowest_sight = min(sight, eye + (best + drop * d1) * d1) - 1e-3 if best > -np.inf else -np.inf
        if best >= 0.0 and sight > highest:
            break
        x1, y_out, d_out = float(line), y1, d1
        leaves = False
        if min(y0, y1) < 0.0 or max(y0, y1) > minor_last:
            heading = b1 + 2.0 * b2 * d1
            leaves = (y1 < 0.0 and heading <= 0.0) or (y1 > minor_last and heading >= 0.0)
            began_inside, ends_inside = 0.0 <= y0 <= minor_last, 0.0 <= y1 <= minor_last
            if began_inside or ends_inside:
                # Of the stretch in which the ray crosses the DEM's end, the part that is inside.
                border = 0.0 if min(y0, y1) < 0.0 else float(minor_last)
                share = (border - y0) / (y1 - y0)
                x_border, d_border = x0 + share * (x1 - x0), d0 + share * (d1 - d0)
                if ends_inside:
                    x0, y0, d0, enters = x_border, border, d_border, True
                else:
                    x1, y1, d1 = x_border, border, d_border
            else:
                if leaves:
                    break
                x0, y0, d0 = x1, y1, d1
                line += step
                continue

        skip = 0
        if line & 3 == first_of_block and best > -np.inf:
            # A block begins behind this line: its maximum covers the stretch that leads into it and the one out of it.
            first = 0
            for size in BLOCKS:
                if line & (size - 1) != (0 if step > 0 else size - 1):
                    break
                wide = minor_last // size + 1
                ceiling = blocks[first + line // size * wide + int(y1) // size]
                far = offset + step * size
                d_far = (s1 + s2 * far) * far
                # Between two points the line of sight, convex, sinks below the lower end by less than drop ds^2 / 4.
                lower = min(eye + (best + drop * d0) * d0, eye + (best + drop * d_far) * d_far)
                if ceiling >= lower - 0.25 * drop * (d_far - d0) * (d_far - d0):
                    break
                skip = size
                first += (last // size + 1) * wide
        if skip > 0:
            line += step * (skip - 1)
            offset = line - start
            d0 = (s1 + s2 * offset) * offset
            x0, y0 = float(line), minor_start + (b1 + b2 * d0) * d0
            line += step
            continue

        # The stretch between two major grid lines lies in one cell, or in two with a minor grid line between them.
        i = line - 1 if step > 0 else line
        j0, j1 = min(int(y0), minor_last - 1), min(int(y1), minor_last - 1)
        cell_0, cell_1 = i * by_major + j0 * by_minor, i * by_major + j1 * by_minor
        if max(ceilings[cell_0], ceilings[cell_1]) > lowest_sight:
            split = (max(j0, j1) - y0) / (y1 - y0) if j0 != j1 else 1.0
            for piece in range(2 if j0 != j1 else 1):
                t0, t1 = (0.0, split) if piece == 0 else (split, 1.0)
                at, j = (cell_0, j0) if piece == 0 else (cell_1, j1)
                z00, z01 = flat[at], flat[at + by_minor]
                z10, z11 = flat[at + by_major], flat[at + by_major + by_minor]
                if min(z00, z01, z10, z11) <= VOID_M:
                    enters = True
                    continue
                xa, xb = x0 + (x1 - x0) * t0 - i, x0 + (x1 - x0) * t1 - i
                ya, yb = y0 + (y1 - y0) * t0 - j, y0 + (y1 - y0) * t1 - j
                za = (z00 * (1.0 - ya) + z01 * ya) * (1.0 - xa) + (z10 * (1.0 - ya) + z11 * ya) * xa
                zb = (z00 * (1.0 - yb) + z01 * yb) * (1.0 - xb) + (z10 * (1.0 - yb) + z11 * yb) * xb
                sa, sb = d0 + (d1 - d0) * t0, d0 + (d1 - d0) * t1
                if sb <= beyond:
                    continue
                if enters and sa > beyond and za > eye + (best + drop * sa) * sa:
                    best, best_s = (za - eye) / sa - drop * sa, sa
                enters = False
                if zb > eye + (best + drop * sb) * sb:
                    best, best_s = (zb - eye) / sb - drop * sb, sb
                twist = (z00 - z01 - z10 + z11) * (xb - xa) * (yb - ya)
                # It cannot bulge above the higher of its ends by more than a quarter of its twist.
                if twist < 0.0 and max(za, zb) - 0.25 * twist > eye + min(best * sa, best * sb):
                    tangent, where = _interior_maximum(za, zb, twist, sa, sb - sa, eye, drop)
                    if tangent > best and where > beyond:
                        best, best_s = tangent, where
        if leaves:
            break
        x0, y0, d0 = float(line), y_out, d_out
        line += step
    return best, best_s


@kernel(parallel=True)
def _horizons(
    height: Heights,
    cell_ceilings: Heights,
    row_blocks: Heights,
    col_blocks: Heights,
    highest: float,
    drop: float,
    coefficients: Floats,
    row: Floats,
    col: Floats,
    eye: Floats,
    azimuth: Floats,
) -> tuple[Floats, Floats]:
    observers, rays = azimuth.shape
    tangent = np.empty((observers, rays))
    distance = np.empty((observers, rays))
    for index in numba.prange(observers * rays):
        i, j = index // rays, index % rays
        tangent[i, j], distance[i, j] = ray_horizon(
            height,
            cell_ceilings,
            row_blocks,
            col_blocks,
            highest,
            drop,
            coefficients[i],
            row[i],
            col[i],
            eye[i],
            azimuth[i, j],
            np.nan,
            0.0,
        )
    return tangent, distance


@kernel()
def _horizon_around(
    height: Heights,
    cell_ceilings: Heights,
    row_blocks: Heights,
    col_blocks: Heights,
    highest: float,
    drop: float,
    coefficients: Floats,
    row: float,
    col: float,
    eye: float,
    azimuth: Floats,
    guess: Floats,
    beyond: float,
) -> tuple[Floats, Floats]:
    tangent = np.empty(azimuth.shape[0])
    distance = np.empty(azimuth.shape[0])
    for i in range(azimuth.shape[0]):
        tangent[i], distance[i] = ray_horizon(
            height,
            cell_ceilings,
            row_blocks,
            col_blocks,
            highest,
            drop,
            coefficients,
            row,
            col,
            eye,
            azimuth[i],
            guess[i],
            beyond,
        )
    return tangent, distance
