"""Shaded relief of any rectangle of a DEM, for maps."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from numpy.typing import NDArray

from localizer.dem.geodesy import metric_to_rowcol, rowcol_to_metric
from localizer.dem.ground import map_metres
from localizer.dem.lattice import Dem

Floats = NDArray[np.float64]

TINTS = LinearSegmentedColormap.from_list(
    "relief", ["#a9b99b", "#c6c9a6", "#d9d0ae", "#cdb99b", "#c9c0b6", "#e9e6e3", "#ffffff"]
)
"""From the lowest ground to the highest; pale, so that overlays are visible."""
VOID_GREY = 0.93
PIXELS = 900
"""Of the longer side."""
COUNTED = 1_000_000
"""About so many cells are sampled for the range of the tints."""


def draw_relief(
    axes: Axes,
    dem: Dem,
    bounds_m: tuple[float, float, float, float],
    *,
    unit_m: float | tuple[float, float] = 1.0,
    origin_m: tuple[float, float] = (0.0, 0.0),
    pixels: int = PIXELS,
) -> None:
    """Draw the rectangle west, east, south, north of the DEM's metric CRS.

    The axes then count ``unit_m``, or one to the east and another to the north, from ``origin_m`` (easting, northing).
    """
    west_m, east_m, south_m, north_m = bounds_m
    image = relief_image(dem, bounds_m, pixels)
    unit_e_m, unit_n_m = unit_m if isinstance(unit_m, tuple) else (unit_m, unit_m)
    extent = (
        (west_m - origin_m[0]) / unit_e_m,
        (east_m - origin_m[0]) / unit_e_m,
        (south_m - origin_m[1]) / unit_n_m,
        (north_m - origin_m[1]) / unit_n_m,
    )
    axes.imshow(image, extent=extent, origin="upper", aspect="equal", interpolation="antialiased")
    axes.set_xlim(extent[0], extent[1])
    axes.set_ylim(extent[2], extent[3])


def relief_image(dem: Dem, bounds_m: tuple[float, float, float, float], pixels: int = PIXELS) -> Floats:
    """Red, green and blue, 0 to 1, (down, across, 3), of the rectangle west, east, south, north of the DEM's metric CRS.

    It is sampled from the lattice, whatever CRS that has of its own, ``pixels`` on its longer side; row 0 is the
    northernmost.
    """
    west_m, east_m, south_m, north_m = bounds_m
    step_m = max(east_m - west_m, north_m - south_m) / pixels
    across, down = (max(2, round(size / step_m)) for size in (east_m - west_m, north_m - south_m))
    easting_m = west_m + (np.arange(across) + 0.5) * (east_m - west_m) / across
    northing_m = north_m - (np.arange(down) + 0.5) * (north_m - south_m) / down
    z_m = dem.ground_m(*metric_to_rowcol(dem, *np.meshgrid(easting_m, northing_m)))
    every = max(1, dem.rows * dem.cols // COUNTED)  # a sample of the cells is enough for the range
    lowest_m, highest_m = np.nanpercentile(dem.z_m.ravel()[::every], (0.5, 99.8))
    tint = TINTS((z_m - lowest_m) / max(highest_m - lowest_m, 1.0))[..., :3]
    # slopes are of the ground, and over about a cell: over less, the facets of the bilinear surface show
    step_m /= map_metres(dem.metric_crs, (west_m + east_m) / 2.0, (south_m + north_m) / 2.0).scale
    reach = max(1, round(dem.spacing_ns_m / step_m / 2.0))
    image = np.clip(tint * (0.42 + 0.8 * hillshade(z_m, step_m, reach))[..., None], 0.0, 1.0)
    image[np.isnan(z_m)] = VOID_GREY
    return np.asarray(image)


def dem_bounds_m(dem: Dem) -> tuple[float, float, float, float]:
    """West, east, south, north of its corner cells' centres in its metric CRS."""
    easting_m, northing_m = rowcol_to_metric(
        dem, [0.0, 0.0, dem.rows - 1, dem.rows - 1], [0.0, dem.cols - 1, 0.0, dem.cols - 1]
    )
    return float(easting_m.min()), float(easting_m.max()), float(northing_m.min()), float(northing_m.max())


def hillshade(z_m: Floats, step_m: float, reach: int = 1) -> Floats:
    """Brightness, 0 to 1, of a surface under a light 45° high in the north-west; row 0 is the northernmost.

    Slopes are taken over ``reach`` pixels to either side. Flat ground and voids have sqrt(0.5).
    """
    padded = np.pad(z_m, reach, mode="edge")
    core = slice(reach, -reach)
    to_east = (padded[core, 2 * reach :] - padded[core, : -2 * reach]) / (2 * reach * step_m)
    to_north = (padded[: -2 * reach, core] - padded[2 * reach :, core]) / (2 * reach * step_m)
    west, north, up = 0.5, 0.5, np.sqrt(0.5)  # of the unit vector to the light
    shade = (up + west * to_east - north * to_north) / np.sqrt(1.0 + to_east**2 + to_north**2)
    return np.asarray(np.clip(np.nan_to_num(shade, nan=up), 0.0, 1.0))
