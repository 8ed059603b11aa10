"""DEMs of every kind: projections, latitudes, cells, voids, edges, and such in which nothing can be found."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from affine import Affine

from frozen_answers.ground import Grid, Ground, hills, moved, with_error, with_voids
from frozen_answers.inputs import Question
from frozen_answers.looks import Rig, contours, place

SIDE = 150


def elsewhere(
    folder: Path,
    *,
    crs: str,
    west: float,
    north: float,
    cell: float,
    cell_ns: float | None = None,
    margin_m: float = 500.0,
    seed: int,
) -> Question:
    """The hills in another CRS, or another part of the Earth."""
    grid = moved(hills(SIDE, 300, 200), crs, west, north, cell, cell_ns)
    return _seen(grid, Ground((grid,)), folder, seed, margin_m)


def cells(folder: Path, *, every: int, seed: int, side: int = 100) -> Question:
    """The hills with larger cells: searched as they are seen."""
    grid = hills(side, 0, 0, every=every)
    return _seen(grid, Ground((grid,)), folder, seed)


def coarser_than_the_truth(folder: Path, *, every: int, seed: int) -> Question:
    """Seen on fine hills, searched on their means."""
    fine = hills(240, 260, 200)
    coarse = hills(240 // every, 260, 200, every=every)
    return _seen(fine, Ground((coarse,)), folder, seed)


def scaled(folder: Path, *, factor: float, seed: int) -> Question:
    """Higher or lower hills."""
    grid = hills(SIDE, 300, 200)
    grid = replace(grid, height_m=factor * grid.height_m)
    return _seen(grid, Ground((grid,)), folder, seed)


def holes(
    folder: Path, *, share: float, seed: int, patch: tuple[int, int, int, int] | None = None
) -> Question:
    """Voids in what is searched."""
    grid = hills(SIDE, 300, 200)
    patches = [(slice(patch[0], patch[1]), slice(patch[2], patch[3]))] if patch else []
    return _seen(grid, Ground((with_voids(grid, share, seed, patches),)), folder, seed)


def voids_around_the_camera(folder: Path, *, reach: int, seed: int) -> Question:
    """No ground where the camera stands."""
    grid = hills(SIDE, 300, 200)
    world = place(grid, folder, seed=seed)
    row, col = round(world.place.row), round(world.place.col)
    patch = slice(row - reach, row + reach + 1), slice(col - reach, col + reach + 1)
    return Question(Ground((with_voids(grid, 0.0, seed, [patch]),)), (contours(world, Rig(), seed),))


def wrong_heights(folder: Path, *, rms_m: float, seed: int, error_m: float | None = None) -> Question:
    """What is searched has an error in each cell, and states one."""
    grid = hills(SIDE, 300, 200)
    options = {} if error_m is None else {"error_m": error_m}
    searched = with_error(grid, rms_m, seed) if rms_m else grid
    return _seen(grid, Ground((searched,), options), folder, seed)


def too_high(folder: Path, *, by_m: float, seed: int) -> Question:
    """All heights off by the same."""
    grid = hills(SIDE, 300, 200)
    searched = replace(grid, height_m=grid.height_m + by_m)
    return _seen(grid, Ground((searched,)), folder, seed)


def cut(folder: Path, *, beyond_cells: float, seed: int) -> Question:
    """The DEM ends so many cells east of the camera; before it if negative."""
    grid = hills(SIDE, 300, 200)
    world = place(grid, folder, seed=seed)
    last = round(world.place.col + beyond_cells)
    searched = grid.piece(slice(None), slice(0, last + 1))
    return Question(Ground((searched,)), (contours(world, Rig(), seed),))


def around(folder: Path, *, reach: int, seed: int) -> Question:
    """So many cells in each direction from the camera, and no more."""
    grid = hills(SIDE, 300, 200)
    world = place(grid, folder, seed=seed, margin_m=31.0 * (reach + 2), enclosed=0.3)
    row, col = round(world.place.row), round(world.place.col)
    searched = grid.piece(slice(row - reach, row + reach + 1), slice(max(col - reach, 0), col + reach + 1))
    return Question(Ground((searched,)), (contours(world, Rig(), seed),))


def shaped(folder: Path, *, shape: str, seed: int, side: int = 50) -> Question:
    """Surfaces of which all places, or whole lines of them, look alike."""
    row, col = np.mgrid[:side, :side].astype(np.float64)
    y, x = row - side / 2, col - side / 2
    height_m = {
        "flat": np.full((side, side), 400.0),
        "slope": 400.0 + 3.0 * col,
        "trough": 300.0 + 4.0 * np.abs(x),
        "cone": 900.0 - 6.0 * np.hypot(x, y),
        "bowl": 300.0 + 0.12 * (x**2 + y**2),
        "waves": 400.0 + 40.0 * np.sin(row / 4.0) * np.sin(col / 4.0),
        "noise": 400.0 + 30.0 * np.random.default_rng(seed).standard_normal((side, side)),
    }[shape]
    grid = Grid(height_m, Affine(30.0, 0.0, 500_000.0, 0.0, -30.0, 4_600_000.0))
    world = place(grid, folder, at=(0.53 * side, 0.44 * side), seed=seed)
    return Question(Ground((grid,)), (contours(world, Rig(), seed),))


def tiny(folder: Path, *, side: int, seed: int) -> Question:
    """A few cells in all."""
    grid = hills(SIDE, 300, 200)
    searched = grid.piece(slice(80, 80 + side), slice(80, 80 + side))
    world = place(grid, folder, at=(80.0 + 0.5 * side, 80.0 + 0.4 * side), seed=seed)
    return Question(Ground((searched,)), (contours(world, Rig(), seed),))


def _seen(grid: Grid, searched: Ground, folder: Path, seed: int, margin_m: float = 500.0) -> Question:
    world = place(grid, folder, seed=seed, margin_m=margin_m)
    return Question(searched, (contours(world, Rig(), seed),))


SECOND = 1.0 / 3600.0
CASES = {
    "utm-north": partial(elsewhere, crs="EPSG:32610", west=560_000, north=4_140_000, cell=30.0, seed=1),
    "utm-south": partial(elsewhere, crs="EPSG:32719", west=390_000, north=6_310_000, cell=30.0, seed=2),
    "utm-south-equator": partial(
        elsewhere, crs="EPSG:32737", west=300_000, north=9_998_000, cell=30.0, seed=3
    ),
    "utm-edge-of-zone": partial(
        elsewhere, crs="EPSG:32632", west=215_000, north=5_200_000, cell=30.0, seed=4
    ),
    "utm-far-outside-zone": partial(
        elsewhere, crs="EPSG:32632", west=-200_000, north=5_200_000, cell=30.0, seed=5
    ),
    "across-the-equator": partial(
        elsewhere, crs="EPSG:4326", west=37.0, north=90 * SECOND, cell=SECOND, seed=6
    ),
    "alps-degrees": partial(elsewhere, crs="EPSG:4326", west=7.6, north=46.0, cell=SECOND, seed=7),
    "norway-degrees": partial(elsewhere, crs="EPSG:4326", west=15.0, north=68.0, cell=SECOND, seed=8),
    "norway-wide-cells": partial(
        elsewhere, crs="EPSG:4326", west=15.0, north=68.0, cell=2 * SECOND, cell_ns=SECOND, seed=9
    ),
    "chile-degrees": partial(elsewhere, crs="EPSG:4326", west=-70.3, north=-33.0, cell=SECOND, seed=10),
    "date-line": partial(
        elsewhere, crs="EPSG:4326", west=180 - 90 * SECOND, north=-16.5, cell=SECOND, seed=11
    ),
    "date-line-utm": partial(elsewhere, crs="EPSG:32760", west=818_000, north=8_170_000, cell=30.0, seed=12),
    "longitudes-to-360": partial(elsewhere, crs="EPSG:4326", west=289.7, north=-33.0, cell=SECOND, seed=13),
    "polar-stereographic": partial(
        elsewhere, crs="EPSG:3995", west=900_000, north=-1_500_000, cell=30.0, seed=14
    ),
    "antarctica": partial(elsewhere, crs="EPSG:3031", west=-400_000, north=-1_200_000, cell=30.0, seed=15),
    "web-mercator": partial(elsewhere, crs="EPSG:3857", west=850_000, north=5_780_000, cell=40.0, seed=16),
    "lambert-france": partial(elsewhere, crs="EPSG:2154", west=950_000, north=6_500_000, cell=30.0, seed=17),
    "laea-europe": partial(elsewhere, crs="EPSG:3035", west=4_100_000, north=2_600_000, cell=30.0, seed=18),
    "swiss": partial(elsewhere, crs="EPSG:2056", west=2_600_000, north=1_130_000, cell=30.0, seed=19),
    "britain-airy": partial(elsewhere, crs="EPSG:27700", west=220_000, north=360_000, cell=30.0, seed=20),
    "new-zealand": partial(elsewhere, crs="EPSG:2193", west=1_300_000, north=5_100_000, cell=30.0, seed=20),
    "fine-cells-5-m": partial(
        elsewhere, crs="EPSG:32610", west=560_000, north=4_140_000, cell=5.0, margin_m=100.0, seed=23
    ),
    "coarse-cells-100-m": partial(
        elsewhere, crs="EPSG:32610", west=560_000, north=4_140_000, cell=100.0, seed=24
    ),
    "coarse-cells-500-m": partial(
        elsewhere, crs="EPSG:32610", west=560_000, north=4_140_000, cell=500.0, seed=25
    ),
    **{f"means-of-{every}": partial(cells, every=every, seed=30 + every) for every in (2, 4, 8)},
    **{
        f"coarser-than-seen-{every}": partial(coarser_than_the_truth, every=every, seed=40 + every)
        for every in (2, 3, 6)
    },
    **{f"heights-times-{factor:g}": partial(scaled, factor=factor, seed=51) for factor in (0.2, 2.5, 5.0)},
    **{f"voids-{share:g}": partial(holes, share=share, seed=60) for share in (0.001, 0.02, 0.3, 0.9)},
    "void-patch": partial(holes, share=0.0, seed=61, patch=(20, 70, 60, 120)),
    "void-half": partial(holes, share=0.0, seed=62, patch=(0, 150, 75, 150)),
    **{
        f"void-around-camera-{reach}": partial(voids_around_the_camera, reach=reach, seed=63)
        for reach in (0, 2, 8)
    },
    "voids-only": partial(holes, share=1.1, seed=64),
    **{
        f"error-{rms:g}-m{f'-stated-{stated:g}' if stated is not None else ''}": partial(
            wrong_heights, rms_m=rms, error_m=stated, seed=70
        )
        for rms, stated in (
            (0.0, 0.0),
            (0.0, 10.0),
            (2.0, None),
            (2.0, 0.0),
            (5.0, None),
            (5.0, 5.0),
            (15.0, None),
            (40.0, None),
        )
    },
    **{f"too-high-{by:g}-m": partial(too_high, by_m=by, seed=80) for by in (10.0, 45.0, 200.0)},
    **{f"edge-{cells_:+d}": partial(cut, beyond_cells=cells_, seed=81) for cells_ in (-20, -2, 0, 1, 3, 15)},
    **{f"within-{reach}-cells": partial(around, reach=reach, seed=90) for reach in (10, 25, 50)},
    **{
        shape: partial(shaped, shape=shape, seed=95)
        for shape in ("flat", "slope", "trough", "cone", "bowl", "waves", "noise")
    },
    **{f"tiny-{side}": partial(tiny, side=side, seed=96) for side in (2, 3, 6, 12, 24)},
}
