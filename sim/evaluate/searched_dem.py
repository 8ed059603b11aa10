"""The DEM for the search: whole, or a half without the vehicle."""

from functools import lru_cache
from pathlib import Path
from typing import Literal

import numpy as np
from affine import Affine
from numpy.typing import NDArray

from localizer import dem_from_array, load_dem
from localizer.experiments import Terrain, load_kernels, prepare_terrain
from sim.evaluate.twins import TwinPlace
from sim.world.surface import Surface

Side = Literal["whole", "north", "south", "west", "east"]
HALVES: tuple[Side, ...] = ("north", "south", "west", "east")


@lru_cache(maxsize=8)
def searched_terrain(dem: Path, side: Side = "whole", error_m: float | None = None) -> Terrain:
    """The DEM, or one half of it, prepared for the search, cached per process; ``error_m``: its stated error."""
    whole = load_dem([dem], error_m=error_m)
    if side != "whole":
        part = _half(whole.z_m.shape, side)
        shift = Affine.translation(part[1].start or 0, part[0].start or 0)
        whole = dem_from_array(whole.z_m[part], whole.transform @ shift, whole.crs, error_m=error_m)
    terrain = prepare_terrain(whole)
    load_kernels(terrain)
    return terrain


def terrain_of_twins(dem: Path, twins: TwinPlace, error_m: float | None = None) -> Terrain:
    """The DEM of one case with duplicated surroundings."""
    whole = load_dem([dem])
    transform = whole.transform @ Affine.translation(twins.first_col, twins.first_row)
    terrain = prepare_terrain(dem_from_array(twins.surface.height_m, transform, whole.crs, error_m=error_m))
    load_kernels(terrain)
    return terrain


def _half(shape: tuple[int, ...], side: Side) -> tuple[slice, slice]:
    rows, cols = shape
    whole = slice(None)
    return {
        "whole": (whole, whole),
        "north": (slice(0, rows // 2), whole),
        "south": (slice(rows // 2, rows), whole),
        "west": (whole, slice(0, cols // 2)),
        "east": (whole, slice(cols // 2, cols)),
    }[side]


def beyond(surface: Surface, searched: Side, margin_m: float) -> NDArray[np.bool_]:
    """Lattice points (rows, cols) of the half that is not searched, ``margin_m`` or more from the one that is."""
    south_m, east_m = surface.terrain.cell_size_m()
    rows, cols = surface.height_m.shape
    vertical = searched in ("north", "south")
    count, cell_m = (rows, south_m) if vertical else (cols, east_m)
    index = np.arange(count)
    middle, margin = count // 2, margin_m / cell_m
    suits = index >= middle + margin if searched in ("north", "west") else index < middle - margin
    return np.broadcast_to(suits[:, None] if vertical else suits[None, :], (rows, cols))
