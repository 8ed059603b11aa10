"""How a DEM is stored: data types, units, datums of place and height, several files."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from affine import Affine

from frozen_answers.ground import Grid, Ground, hills, moved
from frozen_answers.inputs import Question
from frozen_answers.looks import Rig, contours, place

SIDE = 160
NORTH_AMERICA = (-122.1, 37.2)
"""Longitude and latitude of the north-western corner."""


def utm() -> Grid:
    """The hills in metres."""
    return moved(hills(SIDE, 300, 220), "EPSG:32610", 570_000.0, 4_120_000.0, 30.0)


def stored(folder: Path, *, seed: int, how: Callable[[Grid], Ground]) -> Question:
    """The same hills, stored in another way."""
    grid = utm()
    world = place(grid, folder, seed=seed)
    return Question(how(grid), (contours(world, Rig(), seed),))


def on_another_datum(folder: Path, *, seed: int, crs: str) -> Question:
    """A geographic grid on this datum; what is seen is on WGS84."""
    grid = moved(hills(SIDE, 300, 220), "EPSG:4326", *NORTH_AMERICA, 1.0 / 3600.0)
    world = place(grid, folder, seed=seed)
    return Question(Ground((replace(grid, crs=crs),)), (contours(world, Rig(), seed),))


def _as(**changes: Any) -> Callable[[Grid], Ground]:
    return lambda grid: Ground((replace(grid, **changes),))


def _in_unit(unit: str, metres: float) -> Callable[[Grid], Ground]:
    return lambda grid: Ground((replace(grid, height_m=grid.height_m / metres, unit=unit),))


def _unit_told(unit: str, metres: float) -> Callable[[Grid], Ground]:
    return lambda grid: Ground((replace(grid, height_m=grid.height_m / metres),), {"vertical_unit": unit})


def _halves(grid: Grid, overlap: int = 0, swapped: bool = False) -> Ground:
    west, east = slice(0, SIDE // 2 + overlap), slice(SIDE // 2, SIDE)
    parts = grid.piece(slice(None), west), grid.piece(slice(None), east)
    return Ground(parts[::-1] if swapped else parts)


def _quarters(grid: Grid) -> Ground:
    halves = slice(0, SIDE // 2), slice(SIDE // 2, SIDE)
    return Ground(tuple(grid.piece(rows, cols) for rows in halves for cols in halves))


def _overlap_of_another_height(grid: Grid) -> Ground:
    ground = _halves(grid, overlap=20)
    second = replace(ground.grids[1], height_m=ground.grids[1].height_m + 40.0)
    return Ground((ground.grids[0], second))


def _half_with_larger_cells(grid: Grid) -> Ground:
    west = grid.piece(slice(None), slice(0, SIDE // 2))
    east = grid.piece(slice(None), slice(SIDE // 2, SIDE))
    mean = east.height_m.reshape(SIDE // 2, 2, SIDE // 4, 2).mean(axis=(1, 3))
    return Ground((west, replace(east, height_m=mean, transform=east.transform @ Affine.scale(2.0))))


def _half_on_another_datum(grid: Grid) -> Ground:
    ground = _halves(grid)
    return Ground((ground.grids[0], replace(ground.grids[1], crs="EPSG:26910")))


def _apart(grid: Grid) -> Ground:
    return Ground((grid.piece(slice(None), slice(0, 60)), grid.piece(slice(None), slice(90, SIDE))))


def _gap_in_the_middle(grid: Grid) -> Ground:
    frame = (slice(0, 60), slice(None)), (slice(60, 100), slice(0, 60)), (slice(60, 100), slice(100, SIDE))
    return Ground(tuple(grid.piece(*part) for part in (*frame, (slice(100, SIDE), slice(None)))))


def _with_nodata_value(grid: Grid) -> Ground:
    height_m = grid.height_m.copy()
    height_m[:15] = 1234.0
    return Ground((replace(grid, height_m=height_m),), {"nodata": 1234.0})


def _ellipsoidal(grid: Grid) -> Ground:
    return Ground((replace(grid, height_m=grid.height_m - 33.0),), {"geoid_offset_m": -33.0})


def _turned(grid: Grid) -> Ground:
    turned = grid.transform @ Affine.rotation(10.0)
    return Ground((replace(grid, transform=turned),))


def _rounded(metres: float) -> Callable[[Grid], Ground]:
    return lambda grid: Ground((replace(grid, height_m=np.rint(grid.height_m / metres) * metres),))


STORED: dict[str, Callable[[Grid], Ground]] = {
    "float32": _as(),
    "float64": _as(dtype="float64"),
    "int16": _as(dtype="int16"),
    "int32-centimetres": _as(dtype="int32", scale=0.01),
    "rounded-to-10-m": _rounded(10.0),
    "feet": _in_unit("ft", 0.3048),
    "feet-told": _unit_told("ft", 0.3048),
    "feet-not-told": lambda grid: Ground((replace(grid, height_m=grid.height_m / 0.3048),)),
    "decimetres-told": _unit_told("dm", 0.1),
    "south-up": _as(south_up=True),
    "pixel-is-point": _as(point=True),
    "nodata-told": _with_nodata_value,
    "geoid-offset": _ellipsoidal,
    "crs-wrong-hemisphere": _as(crs="EPSG:32710"),
    "crs-neighbouring-zone": _as(crs="EPSG:32611"),
    "nad83-utm": _as(crs="EPSG:26910"),
    "nad83-utm-navd88": _as(crs="EPSG:26910+5703"),
    "nad83-utm-navd88-feet": lambda grid: Ground(
        (replace(grid, crs="EPSG:26910+6360", height_m=grid.height_m * 3937.0 / 1200.0),)
    ),
    "nad27-utm": _as(crs="EPSG:26710"),
    "utm-egm96": _as(crs="EPSG:32610+5773"),
    "utm-egm2008": _as(crs="EPSG:32610+3855"),
    "unnamed-datum": _as(crs="+proj=utm +zone=10 +ellps=clrk66 +units=m +no_defs"),
    "no-earth": _as(crs="+proj=tmerc +lon_0=-123 +k=0.9996 +x_0=500000 +R=1737400 +units=m +no_defs"),
    "turned-grid": _turned,
    "two-files": _halves,
    "two-files-swapped": partial(_halves, swapped=True),
    "four-files": _quarters,
    "overlap": partial(_halves, overlap=20),
    "overlap-swapped": partial(_halves, overlap=20, swapped=True),
    "overlap-of-another-height": _overlap_of_another_height,
    "half-with-larger-cells": _half_with_larger_cells,
    "half-on-another-datum": _half_on_another_datum,
    "files-apart": _apart,
    "files-with-a-gap": _gap_in_the_middle,
}

CASES = {name: partial(stored, seed=1, how=how) for name, how in STORED.items()}
CASES |= {
    "nad83-degrees": partial(on_another_datum, seed=2, crs="EPSG:4269"),
    "nad27-degrees": partial(on_another_datum, seed=2, crs="EPSG:4267"),
    "wgs84-3d": partial(on_another_datum, seed=2, crs="EPSG:4979"),
}
