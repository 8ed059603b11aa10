"""Elevation rasters of the cases: pieces of the terrain that ships, moved elsewhere, and craters that look alike."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import rasterio
from affine import Affine
from numpy.typing import NDArray
from pyproj import Transformer

import sim
from localizer import Dem, load_dem

Heights = NDArray[np.float64]
UTM_10_NORTH = "EPSG:32610"
VOID = -32768.0


@dataclass(frozen=True)
class Grid:
    """One elevation file. ``stored``: how the file holds the heights, as GDAL's data type, unit of metres and more."""

    height_m: Heights
    transform: Affine
    crs: str = UTM_10_NORTH
    dtype: str = "float32"
    unit: str | None = None
    scale: float = 1.0
    south_up: bool = False
    point: bool = False

    def write(self, path: Path) -> Path:
        """As a GeoTIFF."""
        stored = self.height_m / self.scale
        stored = np.where(np.isfinite(stored), stored, VOID)
        if self.dtype.startswith("int"):
            stored = np.rint(stored)
        transform = self.transform
        if self.south_up:
            stored = stored[::-1]
            transform = transform @ Affine.translation(0.0, len(stored)) @ Affine.scale(1.0, -1.0)
        rows, cols = stored.shape
        profile = {"driver": "GTiff", "count": 1, "dtype": self.dtype, "crs": self.crs, "nodata": VOID}
        with rasterio.open(path, "w", height=rows, width=cols, transform=transform, **profile) as raster:
            raster.write(stored.astype(self.dtype), 1)
            if self.point:
                raster.update_tags(AREA_OR_POINT="Point")
            if self.unit:
                raster.set_band_unit(1, self.unit)
            if self.scale != 1.0:
                raster.scales = (self.scale,)
        return path

    def piece(self, rows: slice, cols: slice) -> "Grid":
        """A part of it."""
        shift = Affine.translation(cols.start or 0, rows.start or 0)
        return replace(self, height_m=self.height_m[rows, cols].copy(), transform=self.transform @ shift)

    def lonlat_deg(self, row: float, col: float) -> tuple[float, float]:
        """WGS84 longitude and latitude of a position between the cells' centres."""
        x, y = self.transform @ (col + 0.5, row + 0.5)
        lon, lat = Transformer.from_crs(self.crs, "EPSG:4326", always_xy=True).transform(x, y)
        return float(lon), float(lat)

    @property
    def text(self) -> str:
        """All but the heights."""
        numbers = " ".join(f"{number:.9g}" for number in self.transform[:6])
        stored = f"{self.dtype} {self.unit} {self.scale:.9g} {self.south_up} {self.point}"
        return f"{self.height_m.shape} {numbers} {self.crs} {stored}"


@dataclass(frozen=True)
class Ground:
    """The files that are searched, in their order, and the options of `localizer.load_dem`."""

    grids: tuple[Grid, ...]
    options: Mapping[str, float | int | str] = field(default_factory=dict)

    def load(self, folder: Path) -> Dem:
        """Write the files and read them as a user would. Raises DemError."""
        paths = [grid.write(folder / f"ground-{number}.tif") for number, grid in enumerate(self.grids)]
        return load_dem(paths, **self.options)  # type: ignore[arg-type]

    @property
    def text(self) -> str:
        """All but the heights."""
        return f"{[grid.text for grid in self.grids]} {sorted(self.options.items())}"


@lru_cache(maxsize=1)
def shipped() -> Grid:
    """The terrain that comes with sim, 800 x 800 cells of a second of arc."""
    with rasterio.open(sim.EMBEDDED_DEM) as raster:
        return Grid(raster.read(1).astype(np.float64), raster.transform, "EPSG:4326")


def hills(side: int, row: int, col: int, *, every: int = 1) -> Grid:
    """A piece of it of ``side`` x ``side`` cells, each the mean of ``every`` x ``every``."""
    piece = shipped().piece(slice(row, row + side * every), slice(col, col + side * every))
    mean = piece.height_m.reshape(side, every, side, every).mean(axis=(1, 3))
    return replace(piece, height_m=mean, transform=piece.transform @ Affine.scale(every))


def moved(grid: Grid, crs: str, west: float, north: float, cell: float, cell_ns: float | None = None) -> Grid:
    """The same heights elsewhere on the Earth: the north-western corner and the cell's sides in the units of ``crs``."""
    down = cell if cell_ns is None else cell_ns
    return replace(grid, crs=crs, transform=Affine(cell, 0.0, west, 0.0, -down, north))


def with_error(grid: Grid, rms_m: float, seed: int) -> Grid:
    """With an error in each cell of its own."""
    noise = np.random.default_rng(seed).standard_normal(grid.height_m.shape)
    return replace(grid, height_m=grid.height_m + rms_m * noise)


def with_voids(grid: Grid, share: float, seed: int, patches: Sequence[tuple[slice, slice]] = ()) -> Grid:
    """With single cells missing, and whole patches."""
    height_m = grid.height_m.copy()
    height_m[np.random.default_rng(seed).random(height_m.shape) < share] = np.nan
    for patch in patches:
        height_m[patch] = np.nan
    return replace(grid, height_m=height_m)


CRATER = 96
"""Cells a side."""


def crater(seed: int, hillocks: Sequence[tuple[float, float]] = ()) -> Heights:
    """A ragged rim around ground that slopes gently, all drawn from a seed; ``hillocks`` (row, col) of 60 m are added."""
    rng = np.random.default_rng([seed, 96])
    row, col = np.mgrid[:CRATER, :CRATER].astype(np.float64)
    y, x = row - CRATER / 2, col - CRATER / 2
    angle, radius = np.arctan2(y, x), np.hypot(y, x)
    rim_m = 420.0 + sum(
        height_m * np.sin(waves * angle + rng.uniform(0.0, 2.0 * np.pi))
        for waves, height_m in ((1, 20.0), (3, 20.0), (5, 18.0), (7, 15.0), (13, 10.0), (23, 5.0))
    )
    east, south = rng.uniform(-0.6, 0.6, 2)
    height_m = 500.0 + east * x + south * y + rim_m * np.exp(-(((radius - 40.0) / 4.0) ** 2))
    for at in hillocks:
        height_m += 60.0 * np.exp(-((row - at[0]) ** 2 + (col - at[1]) ** 2) / 2.0)
    return np.asarray(height_m)


def side_by_side(craters: Sequence[Heights], cell_m: float = 30.0) -> Grid:
    """Craters from west to east."""
    return Grid(np.hstack(list(craters)), Affine(cell_m, 0.0, 500_000.0, 0.0, -cell_m, 4_600_000.0))
