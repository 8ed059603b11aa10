"""DEMs of heights that a test chooses, around the origin of a map: north is up all over them."""

import numpy as np
from affine import Affine
from pyproj import CRS

from localizer.dem.lattice import Dem, dem_from_array

LOCAL = CRS.from_proj4("+proj=tmerc +lat_0=37 +lon_0=-122 +k=1 +x_0=0 +y_0=0 +ellps=WGS84")


def local_dem(height_m: np.ndarray, cell_m: float) -> Dem:
    """Its middle is the map's origin."""
    rows, cols = height_m.shape
    corner = Affine.translation(-0.5 * cols * cell_m, 0.5 * rows * cell_m)
    return dem_from_array(height_m.astype(np.float32), corner @ Affine.scale(cell_m, -cell_m), LOCAL)
