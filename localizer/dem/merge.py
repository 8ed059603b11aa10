"""Merging of elevation files on one lattice, without resampling."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from affine import Affine
from numpy.typing import NDArray
from pyproj import CRS

from localizer.dem.crs import degrees_per_unit
from localizer.dem.file import MAX_CELLS, DemError, Tile

ALIGNED_CELLS = 0.05
"""Two files share a lattice if their cell positions agree within this, in cells."""

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class MergedLattice:
    """One lattice, voids and gaps NaN."""

    z_m: NDArray[np.float32]
    transform: Affine
    crs: CRS
    notes: tuple[str, ...] = ()


def lattice_mismatch(first: Tile, tile: Tile) -> str | None:
    """Why two tiles are not on one lattice; None if they are."""
    if not tile.crs.equals(first.crs, ignore_axis_order=True):
        return f"their CRS differ ({first.crs.name}, {tile.crs.name})"
    rows, cols = tile.z_m.shape
    to_first = ~first.transform
    col, row = to_first @ (tile.transform.c, tile.transform.f)
    last_col, last_row = to_first @ (tile.transform @ (cols, rows))
    if max(abs(last_col - col - cols), abs(last_row - row - rows)) > ALIGNED_CELLS:
        return "their cells differ in size"
    if max(abs(col - round(col)), abs(row - round(row))) > ALIGNED_CELLS:
        return "their grids are shifted by part of a cell"
    return None


def merge_tiles(tiles: Sequence[Tile]) -> MergedLattice:
    """Merge tiles of one lattice; where they overlap, the first counts."""
    first = tiles[0]
    origins = np.array([_origin_on(first, tile) for tile in tiles])  # (n, 2) row, col
    ends = origins + np.array([tile.z_m.shape for tile in tiles])
    top_left = origins.min(axis=0)
    rows, cols = (int(size) for size in ends.max(axis=0) - top_left)
    check_cells(rows, cols, first)
    z_m = np.full((rows, cols), np.nan, np.float32)
    for tile, (row, col) in zip(tiles, origins - top_left, strict=True):
        part = z_m[row : row + tile.z_m.shape[0], col : col + tile.z_m.shape[1]]
        np.copyto(part, tile.z_m, where=np.isnan(part))
    return MergedLattice(
        z_m, first.transform @ Affine.translation(int(top_left[1]), int(top_left[0])), first.crs
    )


def check_cells(rows: int, cols: int, first: Tile) -> None:
    if rows * cols > MAX_CELLS:
        raise DemError(f"{first.file.path} and the other files: {rows} x {cols} cells together are too many")


def shifted_by_period(first: Tile, tile: Tile) -> Tile:
    """The tile, its longitudes shifted by whole periods towards the first tile's: tiles adjoin across the date line."""
    if not tile.crs.is_geographic or not first.crs.is_geographic:
        return tile
    middles = [t.transform.c + 0.5 * t.transform.a * t.z_m.shape[1] for t in (first, tile)]
    turn = 360.0 / degrees_per_unit(first.crs)
    turns = round((middles[0] - middles[1]) / turn)
    return replace(tile, transform=Affine.translation(turn * turns, 0.0) @ tile.transform)


def check_connected(tiles: Sequence[Tile]) -> None:
    """Raise ``DemError`` unless all tiles are connected by overlap or adjacency."""
    first = tiles[0].transform
    slack = (
        np.array([first.a, -first.e]) / 4
    )  # a quarter cell on both sides: gaps up to half a cell are tolerated
    low = np.array([t.transform @ (0, t.z_m.shape[0]) for t in tiles]) - slack  # (n, 2) west, south
    high = np.array([t.transform @ (t.z_m.shape[1], 0) for t in tiles]) + slack
    apart = first_unconnected(low, high)
    if apart is not None:
        raise DemError(
            f"{tiles[apart].file.path}: no overlap with {tiles[0].file.path}; the files of one DEM must overlap or adjoin"
        )


def first_unconnected(low: Floats, high: Floats) -> int | None:
    """Index of the first of n boxes (n, 2) that is not connected to box 0 by touching boxes; None if all are."""
    reached = np.zeros(len(low), bool)
    reached[0] = True
    for _ in low:
        for i in np.flatnonzero(reached):
            reached |= ((low <= high[i]) & (low[i] <= high)).all(axis=1)
    return None if reached.all() else int(np.flatnonzero(~reached)[0])


def _origin_on(first: Tile, tile: Tile) -> tuple[int, int]:
    """Row and col of the tile's first cell on the lattice of ``first``."""
    col, row = ~first.transform @ (tile.transform.c, tile.transform.f)
    return round(row), round(col)
