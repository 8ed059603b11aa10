"""Compiled: the horizon and the profile along lines of sight over the triangulated terrain (see ``sim.world.surface``)."""

import numpy as np
from numba import prange

from sim.jit import kernel

CHUNK_CELLS = 8  # length of a straight chunk of track, in the cell's shorter side
BLOCK_CELLS = 16  # side of the blocks whose maxima identify invisible chunks; at least a chunk's length
AZIMUTHS_PER_TASK = 64
MAX_CROSSINGS = 96  # in one chunk, of three families of lines, with room for slanting lattices
TRACK_DEGREE = 8  # of the polynomial from metres east and north of the observer to the lattice


@kernel()
def triangle_at(height_m, row, col):  # type: ignore[no-untyped-def]
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


@kernel()
def ray_polynomial(track, azimuth):  # type: ignore[no-untyped-def]
    """Coefficients (2, TRACK_DEGREE + 1) of row and column offsets in distance / reach along one azimuth."""
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


@kernel(inline="always")
def ray_position(ray, x):  # type: ignore[no-untyped-def]
    """Row and column offsets at ``x`` = distance / reach."""
    row = col = 0.0
    for n in range(TRACK_DEGREE, 0, -1):
        row = (row + ray[0, n]) * x
        col = (col + ray[1, n]) * x
    return row, col


@kernel(inline="always")
def _first_crossing(at, step):  # type: ignore[no-untyped-def]
    """Time at which a coordinate next reaches a whole number, in steps, and the time between such crossings."""
    if step > 0.0:
        return (np.floor(at) + 1.0 - at) / step, 1.0 / step
    if step < 0.0:
        return (np.ceil(at) - 1.0 - at) / step, -1.0 / step
    return np.inf, np.inf


@kernel()
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
        z, per_row, per_col = triangle_at(height_m, row0 + middle * d_row, col0 + middle * d_col)
        half = 0.5 * (end - t) * (d_row * per_row + d_col * per_col)
        z0[count], z1[count] = z - half, z + half
        count += 1
        times[count] = end
        t = end
        if count >= MAX_CROSSINGS:
            break
    return count


@kernel(inline="always")
def chunk_ceiling(block_max_m, row, col):  # type: ignore[no-untyped-def]
    """Upper bound of the heights along a chunk whose middle lies at (row, col)."""
    i = min(max(int(row) // BLOCK_CELLS, 0), block_max_m.shape[0] - 1)
    j = min(max(int(col) // BLOCK_CELLS, 0), block_max_m.shape[1] - 1)
    return block_max_m[i, j]


@kernel(inline="always")
def tangent_bound(height_m, altitude_m, drop, near_m, far_m):  # type: ignore[no-untyped-def]
    """Upper bound of the tangent under which anything up to ``height_m`` appears between two distances."""
    rise = height_m - altitude_m
    if rise <= 0.0:
        return rise / far_m - drop * near_m
    if near_m <= 0.0:
        return np.inf
    return rise / near_m - drop * near_m


@kernel(inline="always")
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


@kernel()
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


@kernel()
def horizons(terrain, viewpoint, azimuths, tangents, distances):  # type: ignore[no-untyped-def]
    """Fill the tangents and distances of the horizon at some azimuths."""
    height_m, block_max_m, max_height_m, drop, chunk_m = terrain
    times, z0, z1 = np.empty(MAX_CROSSINGS + 1), np.empty(MAX_CROSSINGS), np.empty(MAX_CROSSINGS)
    for k in range(len(azimuths)):
        tangents[k], distances[k] = horizon_tangent(
            height_m, block_max_m, max_height_m, drop, chunk_m, viewpoint, azimuths[k], -np.inf, times, z0, z1
        )


@kernel(parallel=True)
def many_horizons(terrain, viewpoint, azimuths, tangents, distances):  # type: ignore[no-untyped-def]
    for task in prange((len(azimuths) + AZIMUTHS_PER_TASK - 1) // AZIMUTHS_PER_TASK):
        part = slice(task * AZIMUTHS_PER_TASK, (task + 1) * AZIMUTHS_PER_TASK)
        horizons(terrain, viewpoint, azimuths[part], tangents[part], distances[part])


@kernel()
def profile_along(height_m, chunk_m, viewpoint, azimuth):  # type: ignore[no-untyped-def]
    row, col, _, reach_m, track = viewpoint
    rows, cols = height_m.shape
    ray = ray_polynomial(track, azimuth)
    times, z0, z1 = np.empty(MAX_CROSSINGS + 1), np.empty(MAX_CROSSINGS), np.empty(MAX_CROSSINGS)
    distance, height = [0.0], [triangle_at(height_m, row, col)[0]]
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
