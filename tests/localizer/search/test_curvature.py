"""Terrain far away is lower than on a flat Earth, and the first stage of the search counts on it."""

import numpy as np
import pytest
from affine import Affine
from pyproj import CRS

from localizer.dem.horizon import prepare_terrain
from localizer.dem.lattice import dem_from_array
from localizer.search.stage1 import Band, search_stage1

LOCAL = CRS.from_proj4("+proj=tmerc +lat_0=46 +lon_0=8 +k=1 +x_0=0 +y_0=0 +ellps=WGS84")
SIDE, CELL_M = 201, 200.0
CAMERA = (175, 100)


@pytest.mark.parametrize(("refraction", "stays"), [(0.13, True), (1.0, False)])
def test_the_true_cell_stays_on_a_curved_earth_and_not_on_a_flat_one(refraction: float, stays: bool) -> None:
    """A plateau of 500 m, 30 km to the north of a plain; refraction 1 bends the light as much as the Earth is curved."""
    # Both ramps rise by 4 m in each cell, so that half a cell's relief adds no more than 2 m to the band. The near ridge hides
    # all of the far one but the last cells.
    row = np.arange(SIDE)
    height_m = np.maximum(np.interp(row, [25, 150], [500.0, 0.0]), 30.0 - 4.0 * np.abs(row - 165))
    height_m = np.repeat(height_m.clip(0.0)[:, None], SIDE, axis=1)
    half = SIDE * CELL_M / 2.0
    dem = dem_from_array(height_m, Affine(CELL_M, 0.0, -half, 0.0, -CELL_M, half), LOCAL, error_m=0.0)
    terrain = prepare_terrain(dem, refraction)
    tangent = 498.0 / 30_000.0 - 0.87 * 30_000.0 / (2.0 * 6371008.8)  # the camera is 2 m above the plain
    sigma = np.radians(0.003)
    band = Band("N", 0.0, np.array([tangent - 3.0 * sigma]), np.array([tangent + 3.0 * sigma]))
    left = search_stage1(terrain, [band], 2.0, 2.0, 1.0, terrain.nominal_error_m).last
    assert (CAMERA in set(map(tuple, left.tolist()))) == stays
