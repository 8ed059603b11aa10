"""The digital elevation model that is searched: one lattice of elevations, read from one or more files.

A geographic DEM keeps its own lattice; nothing is resampled. Rows and columns count cell centres: the value
at (row, col) lies at ``transform @ (col + 0.5, row + 0.5)`` be the file's pixels areas or points.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from affine import Affine
from numpy.typing import ArrayLike, NDArray
from pyproj import CRS

from localizer.crs import (
    WGS84,
    degrees_per_unit,
    geographic_crs,
    is_metric,
    lattice_xy,
    own_lonlat_deg,
    transform_xy,
    utm_crs,
)
from localizer.dem_file import MAX_CELLS, DemError, DemFile, Tile, read_tile

__all__ = ["Dem", "DemError", "dem_from_array", "load_dem"]

MIN_SIDE = 3
SPACING_RANGE_M = (0.05, 10_000.0)
ALIGNED_CELLS = 0.05
"""Two files share a lattice if their cells lie that close together, in cells."""
EDGE_TOLERANCE_CELLS = 1e-6


@dataclass(frozen=True, eq=False)
class Dem:
    """Elevations on a lattice."""

    z_m: NDArray[np.float32]
    """(rows, cols), row 0 northernmost, voids NaN."""
    crs: CRS
    """Of the lattice, horizontal."""
    transform: Affine
    """From (col, row) of a cell's corner to x, y in ``crs`` (apply with @); centres at + 0.5."""
    metric_crs: CRS
    """``crs`` itself if it is projected in metres, else the WGS84 UTM zone of the centre."""
    spacing_ns_m: float
    """Metres from row to row, at the centre."""
    spacing_ew_m: float
    """Metres from column to column, at the centre."""
    files: tuple[DemFile, ...] = ()
    """Empty if the DEM does not come from files."""
    error_m: float | None = None
    """One standard deviation of the elevations, where somebody says it. 0: it is the terrain itself, as in a simulation."""

    @property
    def rows(self) -> int:
        return int(self.z_m.shape[0])

    @property
    def cols(self) -> int:
        return int(self.z_m.shape[1])

    @property
    def source(self) -> tuple[Path, ...]:
        """The files that the DEM was read from."""
        return tuple(file.path for file in self.files)

    def covers(self, row: float, col: float) -> bool:
        """Whether a lattice position lies in one of its cells, be it a void."""
        return -0.5 <= row <= self.rows - 0.5 and -0.5 <= col <= self.cols - 0.5

    def ground_m(self, row: ArrayLike, col: ArrayLike) -> NDArray[np.float64]:
        """Bilinear elevation, elementwise; NaN outside the lattice and where a cell that counts is void."""
        row, col = np.broadcast_arrays(np.asarray(row, np.float64), np.asarray(col, np.float64))
        inside = (
            (row >= -EDGE_TOLERANCE_CELLS)
            & (row <= self.rows - 1 + EDGE_TOLERANCE_CELLS)
            & (col >= -EDGE_TOLERANCE_CELLS)
            & (col <= self.cols - 1 + EDGE_TOLERANCE_CELLS)
        )
        r = np.where(inside, row, 0.0).clip(0.0, self.rows - 1)
        c = np.where(inside, col, 0.0).clip(0.0, self.cols - 1)
        r0 = np.minimum(r.astype(np.int64), self.rows - 2)
        c0 = np.minimum(c.astype(np.int64), self.cols - 2)
        fr, fc = r - r0, c - c0
        ground_m = np.zeros(r.shape)
        for dr, wr in ((0, 1.0 - fr), (1, fr)):
            for dc, wc in ((0, 1.0 - fc), (1, fc)):
                weight = wr * wc
                # a void beside a point that lies exactly on a grid line does not count
                ground_m += np.where(weight > 0.0, weight * self.z_m[r0 + dr, c0 + dc], 0.0)
        return np.where(inside, ground_m, np.nan)


def load_dem(
    paths: Sequence[Path],
    *,
    vertical_unit: str | None = None,
    crs: str | None = None,
    nodata: float | None = None,
    error_m: float | None = None,
) -> Dem:
    """Read one file, or several that adjoin or overlap on one lattice (where they overlap, the first counts).

    ``vertical_unit`` ("m", "ft", "us-ft"), ``crs`` (whatever pyproj understands) and ``nodata`` (a further
    value that means void, in the file's own unit) take precedence over what the files say. ``error_m``: see ``Dem``.

    Raises ``DemError``.
    """
    if not paths:
        raise DemError("no elevation file was named")
    tiles = [read_tile(path, vertical_unit, crs, nodata) for path in paths]
    z_m, transform = _joined(tiles) if len(tiles) > 1 else (tiles[0].z_m, tiles[0].transform)
    return dem_from_array(z_m, transform, tiles[0].crs, tuple(tile.file for tile in tiles), error_m)


def dem_from_array(
    z_m: NDArray[np.floating],
    transform: Affine,
    crs: CRS,
    files: tuple[DemFile, ...] = (),
    error_m: float | None = None,
) -> Dem:
    """A DEM of elevations in metres, (rows, cols), row 0 northernmost, voids NaN, on a north-up lattice.

    Raises ``DemError`` if the lattice is tiny or does not lie where the CRS is defined.
    """
    rows, cols = z_m.shape
    where = ", ".join(str(file.path) for file in files) or "DEM"
    if min(rows, cols) < MIN_SIDE:
        raise DemError(f"{where}: {rows} x {cols} cells are too few to search")
    if crs.is_geographic:
        degrees = degrees_per_unit(crs)
        south, north = (transform.f + transform.e * rows) * degrees, transform.f * degrees
        if not -90.1 <= south < north <= 90.1:
            raise DemError(f"{where}: its coordinates are no degrees, but its CRS is {crs.name}; see --crs")
    # the centre, and half a cell to the west, east, north and south of it
    row, col = (rows - 1) / 2, (cols - 1) / 2
    x, y = lattice_xy(transform, row + np.array([0, 0, 0, -0.5, 0.5]), col + np.array([0, -0.5, 0.5, 0, 0]))
    lon_deg, lat_deg = own_lonlat_deg(crs, x, y)
    if not (np.isfinite(lon_deg).all() and np.isfinite(lat_deg).all()):
        raise DemError(f"{where}: lies where {crs.name} is not defined; see --crs")
    geod = geographic_crs(crs).get_geod()
    assert geod is not None
    _, _, lengths_m = geod.inv(lon_deg[[1, 3]], lat_deg[[1, 3]], lon_deg[[2, 4]], lat_deg[[2, 4]])
    spacing_ew_m, spacing_ns_m = (float(length) for length in np.asarray(lengths_m))
    shortest_m, longest_m = sorted((spacing_ew_m, spacing_ns_m))
    if not SPACING_RANGE_M[0] <= shortest_m <= longest_m <= SPACING_RANGE_M[1]:
        raise DemError(
            f"{where}: its cells measure {spacing_ew_m:g} x {spacing_ns_m:g} m, as no elevation model's do; "
            f"is its CRS really {crs.name}? See --crs"
        )
    centre_lon_deg, centre_lat_deg = transform_xy(crs, WGS84, x[:1], y[:1])
    return Dem(
        z_m=np.ascontiguousarray(z_m, np.float32),
        crs=crs,
        transform=transform,
        metric_crs=crs if is_metric(crs) else utm_crs(float(centre_lon_deg[0]), float(centre_lat_deg[0])),
        spacing_ns_m=spacing_ns_m,
        spacing_ew_m=spacing_ew_m,
        files=files,
        error_m=error_m,
    )


def _joined(tiles: Sequence[Tile]) -> tuple[NDArray[np.float32], Affine]:
    """All tiles on the lattice of the first, gaps NaN. Raises ``DemError`` where they do not fit together."""
    first = tiles[0]
    for tile in tiles[1:]:
        if not tile.crs.equals(first.crs, ignore_axis_order=True):
            raise DemError(
                f"{first.file.path} and {tile.file.path}: their CRS differ ({first.crs.name}, {tile.crs.name}); "
                "reproject one with gdalwarp"
            )
    tiles = [_on_the_same_turn(first, tile) for tile in tiles]
    _check_connected(tiles)
    origins = np.array([_origin_on(first, tile) for tile in tiles])  # (n, 2) row, col
    ends = origins + np.array([tile.z_m.shape for tile in tiles])
    top_left = origins.min(axis=0)
    rows, cols = (int(size) for size in ends.max(axis=0) - top_left)
    if rows * cols > MAX_CELLS:
        raise DemError(f"{first.file.path} and the other files: {rows} x {cols} cells together are too many")
    z_m = np.full((rows, cols), np.nan, np.float32)
    for tile, (row, col) in zip(tiles, origins - top_left, strict=True):
        part = z_m[row : row + tile.z_m.shape[0], col : col + tile.z_m.shape[1]]
        np.copyto(part, tile.z_m, where=np.isnan(part))
    return z_m, first.transform @ Affine.translation(int(top_left[1]), int(top_left[0]))


def _on_the_same_turn(first: Tile, tile: Tile) -> Tile:
    """Files on both sides of the date line adjoin: longitudes by whole turns as near to the first file's as can be."""
    if not tile.crs.is_geographic:
        return tile
    middles = [t.transform.c + 0.5 * t.transform.a * t.z_m.shape[1] for t in (first, tile)]
    turn = 360.0 / degrees_per_unit(first.crs)
    turns = round((middles[0] - middles[1]) / turn)
    return replace(tile, transform=Affine.translation(turn * turns, 0.0) @ tile.transform)


def _check_connected(tiles: Sequence[Tile]) -> None:
    """Every tile must be reachable from the first over tiles that overlap or adjoin."""
    first = tiles[0].transform
    slack = np.array([first.a, -first.e]) / 4  # on both sides: half a cell is no gap
    low = np.array([t.transform @ (0, t.z_m.shape[0]) for t in tiles]) - slack  # (n, 2) west, south
    high = np.array([t.transform @ (t.z_m.shape[1], 0) for t in tiles]) + slack
    reached = np.zeros(len(tiles), bool)
    reached[0] = True
    for _ in tiles:
        for i in np.flatnonzero(reached):
            reached |= ((low <= high[i]) & (low[i] <= high)).all(axis=1)
    if not reached.all():
        apart = tiles[int(np.flatnonzero(~reached)[0])].file.path
        raise DemError(
            f"{apart}: no overlap with {tiles[0].file.path}; the files of one DEM must overlap or adjoin"
        )


def _origin_on(first: Tile, tile: Tile) -> tuple[int, int]:
    """Row and col of the tile's first cell on the lattice of ``first``."""
    both = f"{first.file.path} and {tile.file.path}"
    rows, cols = tile.z_m.shape
    to_first = ~first.transform
    col, row = to_first @ (tile.transform.c, tile.transform.f)
    last_col, last_row = to_first @ (tile.transform @ (cols, rows))
    if max(abs(last_col - col - cols), abs(last_row - row - rows)) > ALIGNED_CELLS:
        raise DemError(f"{both}: their cells differ in size; resample one with gdalwarp -tr")
    if max(abs(col - round(col)), abs(row - round(row))) > ALIGNED_CELLS:
        raise DemError(f"{both}: their grids are shifted by part of a cell; align one with gdalwarp -tap")
    return round(row), round(col)
