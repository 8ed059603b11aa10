"""A calibration at a known place needs a DEM with known horizontal and vertical datum."""

from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from pyproj import CRS

from rig.calibrate.boresight.known_place import known_place
from rig.config.calibration_files import CalibrationError

ELLIPSOIDAL = CRS.from_epsg(32611).to_3d().to_wkt("WKT2_2019")


@pytest.mark.parametrize(
    ("crs", "complaint"),
    [
        (ELLIPSOIDAL, "count from the ellipsoid"),
        ("+proj=utm +zone=11 +ellps=clrk66 +units=m", "datum is not known"),
    ],
)
def test_a_dem_that_would_spoil_a_calibration_is_refused(tmp_path: Path, crs: str, complaint: str) -> None:
    path = tmp_path / "dem.tif"
    hills = (500.0 + np.add.outer(np.arange(40.0), np.arange(50.0))).astype(np.float32)
    grid = Affine(30.0, 0.0, 400_000.0, 0.0, -30.0, 3_800_000.0)
    with rasterio.open(
        path, "w", driver="GTiff", height=40, width=50, count=1, dtype="float32", crs=crs, transform=grid
    ) as dataset:
        dataset.write(hills, 1)
    with pytest.raises(CalibrationError, match=complaint):
        known_place(34.33, -118.08, (path,))
