"""Separate process that draws a DEM: ``python -m rig.daemon.http.draw_relief DEM``, a ``DemChoice`` as JSON.

Writes one line of JSON, the fields of ``MapSheet`` except ``image``, and then the picture (WebP) to standard output.
"""

import json
import os
import sys

import cv2
import numpy as np

from localizer.dem.choice import DemChoice
from localizer.dem.ground import map_metres
from localizer.documents import json_values
from localizer.errors import SkyfixError
from localizer.show.relief import dem_bounds_m, relief_image

MIN_PX, MAX_PX = 800, 2000
PX_A_CELL = 2
QUALITY = 85
SCALES = 9
"""Between these samples a map's scale is linear to better than 1e-3."""
NICENESS = 5
"""The map has lower priority than the control of the head."""


def main(choice: str) -> int:
    """Draw; the status is 2 where the DEM cannot be used."""
    os.nice(NICENESS)
    try:
        dem = DemChoice.from_fields(json_values(choice)).load()
    except SkyfixError as error:
        print(error, file=sys.stderr)
        return 2
    bounds_m = dem_bounds_m(dem)
    pixels = int(np.clip(PX_A_CELL * max(dem.rows, dem.cols), MIN_PX, MAX_PX))
    image = np.round(255.0 * relief_image(dem, bounds_m, pixels)).astype(np.uint8)
    ok, webp = cv2.imencode(".webp", image[:, :, ::-1], [cv2.IMWRITE_WEBP_QUALITY, QUALITY])
    assert ok
    west_m, east_m, south_m, north_m = bounds_m
    sheet = {
        "crs": dem.metric_crs.to_string(),
        "west_m": west_m,
        "east_m": east_m,
        "south_m": south_m,
        "north_m": north_m,
        "width_px": image.shape[1],
        "height_px": image.shape[0],
        "lowest_m": float(np.nanmin(dem.z_m)),
        "highest_m": float(np.nanmax(dem.z_m)),
        "scales": [
            map_metres(dem.metric_crs, (west_m + east_m) / 2.0, float(northing_m)).scale
            for northing_m in np.linspace(north_m, south_m, SCALES)
        ],
    }
    sys.stdout.buffer.write(json.dumps(sheet).encode() + b"\n" + webp.tobytes())
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
