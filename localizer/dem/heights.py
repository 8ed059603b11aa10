"""Vertical datum of elevations: heights above sea level (orthometric) or above the ellipsoid.

They differ by the geoid undulation N, up to 107 m: orthometric height = ellipsoidal height - N. An altimeter measures the
former.
"""

import warnings
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS
from pyproj.exceptions import CRSError, ProjError
from pyproj.transformer import TransformerGroup

from localizer.dem.datum import pipeline

GEOID_SIGMA_M = 35.0
"""Standard deviation of the undulation over land, used if it is unknown."""
GEOID_RANGE_M = (-120.0, 120.0)
"""Range of the undulation: -107 m south of India, +85 m in New Guinea."""
SEA_LEVELS = (("EGM2008", 9518), ("EGM96", 9707))
"""WGS84 with heights above a geoid, as EPSG lists them, the better first."""
NODES = 33
"""Grid points per side at which the undulation is computed; it is smooth over tens of kilometres."""
ELLIPSOID = "ellips"

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Heights:
    """The vertical datum of elevations."""

    name: str | None = None
    """As the file's CRS has it, as "NAVD88 height"; None where it says nothing."""
    ellipsoidal: bool = False
    downward: bool = False
    """Whether they are depths, as the file's CRS has it."""
    geoid_offset_m: float | None = None
    """Geoid undulation that was subtracted, as given by the user; None if none was."""
    converted: str | None = None
    """Vertical datum to which a geoid grid of PROJ converted the elevations; None without conversion."""

    @property
    def altitude_sigma_m(self) -> float:
        """Additional uncertainty of an altitude above sea level when it is compared with these elevations."""
        unsaid = self.ellipsoidal and self.geoid_offset_m is None and self.converted is None
        return GEOID_SIGMA_M if unsaid else 0.0


def heights_of(crs: CRS) -> Heights:
    """Vertical datum by a raster's CRS."""
    whole = crs.source_crs if crs.is_bound and crs.source_crs is not None else crs
    vertical = next((part for part in whole.sub_crs_list if part.is_vertical), None)
    if vertical is None and whole.is_vertical:
        vertical = whole
    if vertical is not None:
        datum = "" if vertical.datum is None else vertical.datum.name
        downward = any(axis.direction == "down" for axis in vertical.axis_info)
        return Heights(vertical.name, ELLIPSOID in f"{vertical.name} {datum}".lower(), downward)
    if len(whole.axis_info) == 3 and not whole.is_geocentric:
        return Heights("height above the ellipsoid", True)
    return Heights()


def to_sea_level(
    z_m: NDArray[np.float32], lon_deg: Floats, lat_deg: Floats, heights: Heights, geoid_offset_m: float | None
) -> tuple[NDArray[np.float32], Heights]:
    """Elevations (rows, cols) above sea level, as far as the undulation is known, and their vertical datum.

    ``lon_deg``, ``lat_deg`` (n, m), WGS84, are a regular grid over the cells. ``geoid_offset_m``: undulation given by the
    user; PROJ's grids are then not used.
    """
    if geoid_offset_m is not None:
        return z_m - np.float32(geoid_offset_m), replace(heights, geoid_offset_m=geoid_offset_m)
    if not heights.ellipsoidal:
        return z_m, heights
    for name, epsg in SEA_LEVELS:
        undulation_m = _undulation_m(epsg, lon_deg, lat_deg)
        if undulation_m is not None:
            import cv2

            rows, cols = z_m.shape
            # the outer grid points lie at the centres of the outermost cells
            row = np.linspace(0.0, undulation_m.shape[0] - 1.0, rows, dtype=np.float32)
            col = np.linspace(0.0, undulation_m.shape[1] - 1.0, cols, dtype=np.float32)
            for first in range(0, rows, 1024):
                part = slice(first, min(first + 1024, rows))
                at_col, at_row = np.meshgrid(col, row[part])
                z_m[part] -= cv2.remap(undulation_m.astype(np.float32), at_col, at_row, cv2.INTER_LINEAR)
            low, high = float(undulation_m.min()), float(undulation_m.max())
            return z_m, replace(heights, converted=f"{name} height ({low:+.1f} to {high:+.1f} m taken off)")
    return z_m, heights


def _undulation_m(epsg: int, lon_deg: Floats, lat_deg: Floats) -> Floats | None:
    """Undulation of the geoid above the WGS84 ellipsoid; None if PROJ has no grid."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of grids that are missing
            group = TransformerGroup(CRS.from_epsg(4979), epsg, always_xy=True, allow_ballpark=False)
    except (ProjError, CRSError, IndexError):
        return None
    if not group.transformers:
        return None
    x, y = lon_deg.ravel(), lat_deg.ravel()
    _, _, height_m = pipeline(group.transformers[0].definition).transform(x, y, np.zeros_like(x))
    undulation_m = -np.asarray(height_m, np.float64).reshape(lon_deg.shape)
    low, high = GEOID_RANGE_M
    return undulation_m if bool(((undulation_m > low) & (undulation_m < high)).all()) else None


def heights_text(heights: Heights) -> str:
    """For ``dem info``: the vertical datum and its conversion."""
    name = heights.name or "not stated; taken for heights above the sea"
    if heights.geoid_offset_m is not None:
        return f"{name}; {heights.geoid_offset_m:+.1f} m taken off (--geoid-offset)"
    return f"{name}; brought to {heights.converted}" if heights.converted else name


def heights_note(heights: Heights) -> str | None:
    """A note for users on the vertical datum; None if there is nothing to note."""
    if heights.geoid_offset_m and heights.name and not heights.ellipsoidal:
        return (
            f"the file says that its elevations are {heights.name}, which counts from the sea; --geoid-offset moves them by "
            f"{-heights.geoid_offset_m:+.1f} m all the same"
        )
    if not heights.altitude_sigma_m:
        return None
    return (
        "its elevations are heights above the ellipsoid, up to 107 m off the sea's level, and no geoid grid of PROJ's is "
        f"installed; the altimeter is trusted to {GEOID_SIGMA_M:g} m only: say --geoid-offset M, the geoid's height above the "
        "ellipsoid there (negative below it)"
    )
