"""Joining of several elevation files into one lattice.

Files on one lattice are merged without resampling. Adjoining files on different lattices (Copernicus tiles have wider cells
towards the poles; archives use NAD83 or WGS84) are resampled bilinearly onto the finest lattice. Overlapping files on
different lattices are refused, because it is unknown which is right.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from affine import Affine
from numpy.typing import NDArray

from localizer.dem.crs import degrees_per_unit, geographic_crs, lattice_xy, own_lonlat_deg, readable_name
from localizer.dem.datum import DatumShift, datum_shift
from localizer.dem.file import DemError, Tile
from localizer.dem.merge import (
    MergedLattice,
    check_cells,
    check_connected,
    first_unconnected,
    lattice_mismatch,
    merge_tiles,
    shifted_by_period,
)

EXTRAPOLATED_CELLS = 0.25
"""A surface is extrapolated by so many cells beyond its outer ones, so that there is no gap between files."""
MOST_OVERLAP = 0.25
"""Largest overlap as a share of the smaller file: tiles of archives overlap by a few cells at their edges."""
EDGE_POINTS = 21
ROWS_AT_ONCE = 256

Floats = NDArray[np.float64]


def joined(tiles: Sequence[Tile]) -> MergedLattice:
    """All tiles as one lattice; where they overlap, the first counts. Raises ``DemError`` if they do not fit together."""
    first = tiles[0]
    if len(tiles) == 1:
        return MergedLattice(first.z_m, first.transform, first.crs)
    _check_heights(tiles)
    groups = _groups(tiles)
    if len(groups) == 1:
        tiles = [shifted_by_period(first, tile) for tile in tiles]
        check_connected(tiles)
        return merge_tiles(tiles)
    return _resampled_onto_finest(
        [merge_tiles([shifted_by_period(g[0], t) for t in g]) for g in groups], groups
    )


def _groups(tiles: Sequence[Tile]) -> list[list[Tile]]:
    """Groups of tiles on one lattice, in the order of their first tiles."""
    groups: list[list[Tile]] = []
    for tile in tiles:
        for group in groups:
            if lattice_mismatch(group[0], shifted_by_period(group[0], tile)) is None:
                group.append(tile)
                break
        else:
            groups.append([tile])
    return groups


def _warp_command(base: MergedLattice, tile: Tile, low: Floats, high: Floats) -> str:
    """The gdalwarp command that resamples a file onto the lattice ``base``; it extends from ``low`` to ``high`` (row, col)."""
    t = base.transform
    top, left = (int(v) for v in np.floor(low + 0.5))
    bottom, right = (int(v) for v in np.ceil(high + 0.5))
    west, north = t @ (left, top)
    east, south = t @ (right, bottom)
    crs = readable_name(base.crs)
    crs = crs if crs.startswith(("EPSG:", "ESRI:")) else "CRS"
    box = " ".join(f"{edge:.12g}" for edge in (west, south, east, north))
    return (
        f"gdalwarp -t_srs {crs} -tr {t.a:.12g} {-t.e:.12g} -te {box} -r bilinear {tile.file.path} "
        f"{tile.file.path.stem}_resampled.tif"
    )


def _check_heights(tiles: Sequence[Tile]) -> None:
    first = tiles[0]
    for tile in tiles[1:]:
        if tile.heights.ellipsoidal != first.heights.ellipsoidal:
            raise DemError(
                f"{first.file.path} and {tile.file.path}: the elevations of one count from the ellipsoid, of the other from "
                "the sea; bring both to one, with gdalwarp -t_srs CRS+5773"
            )


@dataclass(frozen=True)
class _LatticeMapping:
    """Mapping between the base lattice and another one, by way of WGS84 if their CRS differ."""

    base: MergedLattice
    base_shift: DatumShift
    other: MergedLattice
    other_shift: DatumShift

    def rowcol(self, row: Floats, col: Floats) -> tuple[Floats, Floats]:
        """Positions on ``other`` of positions on ``base``."""
        x, y = lattice_xy(self.base.transform, row, col)
        if not self.other.crs.equals(self.base.crs, ignore_axis_order=True):
            x, y = self.other_shift.from_lonlat_deg(
                self.other.crs, *self.base_shift.to_lonlat_deg(self.base.crs, x, y)
            )
        return _rowcol(self.other, x, y)

    def back(self, row: Floats, col: Floats) -> tuple[Floats, Floats]:
        """Positions on ``base`` of positions on ``other``."""
        x, y = lattice_xy(self.other.transform, row, col)
        if not self.other.crs.equals(self.base.crs, ignore_axis_order=True):
            x, y = self.base_shift.from_lonlat_deg(
                self.base.crs, *self.other_shift.to_lonlat_deg(self.other.crs, x, y)
            )
        return _rowcol(self.base, x, y)


def _rowcol(surface: MergedLattice, x: Floats, y: Floats) -> tuple[Floats, Floats]:
    t = surface.transform
    if surface.crs.is_geographic:
        turn = 360.0 / degrees_per_unit(surface.crs)
        middle = t.c + 0.5 * t.a * surface.z_m.shape[1]
        x = x + turn * np.round((middle - x) / turn)
    return (y - t.f) / t.e - 0.5, (x - t.c) / t.a - 0.5


def _resampled_onto_finest(
    surfaces: Sequence[MergedLattice], groups: Sequence[Sequence[Tile]]
) -> MergedLattice:
    """All surfaces on the lattice of the finest."""
    finest = int(np.argmin([round(_cell_m(surface), 3) for surface in surfaces]))
    base = surfaces[finest]
    shifts = [_shift(surface) for surface in surfaces]
    for i, (surface, shift) in enumerate(zip(surfaces, shifts, strict=True)):
        crs_differ = not surface.crs.equals(base.crs, ignore_axis_order=True)
        if crs_differ and not (shift.known and shifts[finest].known):
            raise DemError(
                f"{groups[finest][0].file.path} and {groups[i][0].file.path}: their CRS differ ({base.crs.name}, "
                f"{surface.crs.name}) and PROJ has no operation between them; name one CRS for both with --crs, if it is one"
            )
    mappings = [
        _LatticeMapping(base, shifts[finest], surface, shift)
        for surface, shift in zip(surfaces, shifts, strict=True)
    ]
    low, high = (
        np.array(ends) for ends in zip(*(_extent(mapping) for mapping in mappings), strict=True)
    )  # (n, 2) row, col
    _check_side_by_side(low, high, base, finest, groups)
    top, left = (int(v) for v in np.ceil(low.min(axis=0) - 1e-6))  # cells whose centres are covered
    bottom, right = (int(v) for v in np.floor(high.max(axis=0) + 1e-6))
    rows, cols = bottom - top + 1, right - left + 1
    check_cells(rows, cols, groups[0][0])
    z_m = np.full((rows, cols), np.nan, np.float32)
    for i, mapping in enumerate(mappings):
        if i == finest:
            part = z_m[-top : base.z_m.shape[0] - top, -left : base.z_m.shape[1] - left]
            np.copyto(part, base.z_m, where=np.isnan(part))
        else:
            _fill_voids(z_m, mapping, low[i], high[i], top, left)
    notes = tuple(
        f"{group[0].file.path}{f' and {len(group) - 1} more' if len(group) > 1 else ''}: lies on another lattice than "
        f"{groups[finest][0].file.path}, and was continued onto that, bilinearly"
        for i, group in enumerate(groups)
        if i != finest
    )
    return MergedLattice(z_m, base.transform @ Affine.translation(left, top), base.crs, notes)


def _fill_voids(
    z_m: NDArray[np.float32], mapping: _LatticeMapping, low: Floats, high: Floats, top: int, left: int
) -> None:
    """Fill the void cells within a box (row, col) of the base lattice from another surface."""
    first_row, last_row = (
        max(int(np.floor(low[0])) - top, 0),
        min(int(np.ceil(high[0])) - top + 1, z_m.shape[0]),
    )
    first_col, last_col = (
        max(int(np.floor(low[1])) - left, 0),
        min(int(np.ceil(high[1])) - left + 1, z_m.shape[1]),
    )
    for begin in range(first_row, last_row, ROWS_AT_ONCE):
        rows = slice(begin, min(begin + ROWS_AT_ONCE, last_row))
        part = z_m[rows, first_col:last_col]
        row, col = np.nonzero(np.isnan(part))
        if row.size:
            at_row, at_col = mapping.rowcol(
                np.asarray(row + (begin + top), np.float64), np.asarray(col + (first_col + left), np.float64)
            )
            part[row, col] = _surface(mapping.other.z_m, at_row, at_col)


def _surface(z_m: NDArray[np.float32], row: Floats, col: Floats) -> Floats:
    """Bilinear elevations at positions (n,), extrapolated just beyond the outer cells; NaN farther out."""
    rows, cols = z_m.shape
    edge = 0.5 + EXTRAPOLATED_CELLS
    inside = (row >= -edge) & (row <= rows - 1 + edge) & (col >= -edge) & (col <= cols - 1 + edge)
    r, c = np.where(inside, row, 0.0), np.where(inside, col, 0.0)
    r0 = np.floor(r).astype(np.int64).clip(0, rows - 2)
    c0 = np.floor(c).astype(np.int64).clip(0, cols - 2)
    fr, fc = r - r0, c - c0
    out = np.zeros(row.shape)
    for dr, wr in ((0, 1.0 - fr), (1, fr)):
        for dc, wc in ((0, 1.0 - fc), (1, fc)):
            weight = wr * wc
            out += np.where(np.abs(weight) > 1e-9, weight * z_m[r0 + dr, c0 + dc], 0.0)
    return np.where(inside, out, np.nan)


def _extent(mapping: _LatticeMapping) -> tuple[Floats, Floats]:
    """Lowest and highest row and col, (2,) each, of the other lattice's outer edge on the base lattice."""
    rows, cols = mapping.other.z_m.shape
    if mapping.other is mapping.base:
        return np.array([-0.5, -0.5]), np.array([rows - 0.5, cols - 0.5])
    down, across = (np.linspace(-0.5, side - 0.5, EDGE_POINTS, dtype=np.float64) for side in (rows, cols))
    row = np.concatenate([down, down, np.full(EDGE_POINTS, -0.5), np.full(EDGE_POINTS, rows - 0.5)])
    col = np.concatenate([np.full(EDGE_POINTS, -0.5), np.full(EDGE_POINTS, cols - 0.5), across, across])
    at = np.stack(mapping.back(row, col), axis=1)
    return at.min(axis=0), at.max(axis=0)


def _check_side_by_side(
    low: Floats, high: Floats, base: MergedLattice, finest: int, groups: Sequence[Sequence[Tile]]
) -> None:
    """Raise ``DemError`` for overlapping or disconnected surfaces. ``low``, ``high``: (n, 2) on ``base``."""
    first = groups[0][0]
    near = bool(np.isfinite(low).all() and np.isfinite(high).all())
    apart = (
        first_unconnected(low - EXTRAPOLATED_CELLS, high + EXTRAPOLATED_CELLS) if near else len(groups) - 1
    )
    if apart is not None:
        other = groups[apart][0]
        why = lattice_mismatch(first, shifted_by_period(first, other)) or ""
        raise DemError(
            f"{other.file.path}: no overlap with {first.file.path} ({why}); the files of one DEM must overlap or "
            "adjoin"
        )
    for i, group in enumerate(groups):
        if i == finest:
            continue
        size = np.minimum(high[i], high[finest]) - np.maximum(low[i], low[finest])
        smaller = min(np.prod(high[i] - low[i]), np.prod(high[finest] - low[finest]))
        if bool((size > 0.0).all()) and float(np.prod(size)) > MOST_OVERLAP * smaller:
            tile = groups[finest][0]
            why = (
                lattice_mismatch(tile, shifted_by_period(tile, group[0])) or "they lie on different lattices"
            )
            raise DemError(
                f"{tile.file.path} and {group[0].file.path}: {why}, and they lie over each other; put one on "
                f"the other's lattice with {_warp_command(base, group[0], low[i], high[i])}"
            )


def _shift(surface: MergedLattice) -> DatumShift:
    rows, cols = surface.z_m.shape
    row, col = np.array([0.0, 0.0, rows - 1.0, rows - 1.0]), np.array([0.0, cols - 1.0, 0.0, cols - 1.0])
    return datum_shift(surface.crs, *lattice_xy(surface.transform, row, col))


def _cell_m(surface: MergedLattice) -> float:
    """The shorter side of the middle cell."""
    rows, cols = surface.z_m.shape
    row, col = (rows - 1) / 2, (cols - 1) / 2
    x, y = lattice_xy(surface.transform, row + np.array([0.0, 0.0, 1.0]), col + np.array([0.0, 1.0, 0.0]))
    lon_deg, lat_deg = own_lonlat_deg(surface.crs, x, y)
    geod = geographic_crs(surface.crs).get_geod()
    assert geod is not None
    _, _, sides_m = geod.inv(lon_deg[[0, 0]], lat_deg[[0, 0]], lon_deg[1:], lat_deg[1:])
    return float(np.min(sides_m))
