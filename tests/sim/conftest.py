"""Terrain made to measure, and one world that several tests look at."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import rasterio
from numpy.typing import NDArray
from rasterio.transform import Affine

from sim.world.scenario import Scenario
from sim.world.truth import World

SANTA_CRUZ = Path(__file__).parents[2] / "sim" / "terrain" / "santa_cruz_srtm_1s.tif"

# Around its origin this projection keeps distances and azimuths: what is north on the lattice is north on the ground.
AROUND_ORIGIN = "+proj=aeqd +lat_0=46 +lon_0=9 +datum=WGS84 +units=m"

WriteDem = Callable[..., Path]


@pytest.fixture
def write_dem(tmp_path: Path) -> WriteDem:
    """Writes heights as a GeoTIFF; the middle of its lattice is the origin of the CRS unless ``corner`` says otherwise."""

    def write(
        height_m: NDArray[np.floating],
        cell: float = 30.0,
        crs: str | None = AROUND_ORIGIN,
        corner: tuple[float, float] | None = None,
        name: str = "dem.tif",
        unit: str = "",
        void: float | None = None,
    ) -> Path:
        rows, cols = height_m.shape
        x, y = corner or (-cell * cols / 2.0, cell * rows / 2.0)
        path = tmp_path / name
        with rasterio.open(
            path,
            "w",
            driver="GTiff",
            height=rows,
            width=cols,
            count=1,
            dtype="float32",
            crs=crs,
            transform=Affine(cell, 0.0, x, 0.0, -cell, y),
            nodata=void,
        ) as dataset:
            dataset.write(height_m.astype(np.float32), 1)
            dataset.units = (unit,)
        return path

    return write


@pytest.fixture(scope="session")
def santa_cruz() -> Path:
    """The terrain that ships."""
    return SANTA_CRUZ


@pytest.fixture(scope="session")
def world(santa_cruz: Path) -> World:
    """A world with the default scenario."""
    return World.create([santa_cruz], Scenario(), 1)
