"""The known place of a calibration, on a DEM."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from localizer.dem.crs import wrapped_lon_deg
from localizer.dem.geodesy import lonlat_to_rowcol
from localizer.dem.lattice import Dem, load_dem
from rig.config.calibration_files import CalibrationError


@dataclass(frozen=True)
class KnownPlace:
    """A place in WGS84, with its lattice position in the DEM and the ground height there."""

    lat_deg: float
    lon_deg: float
    dem: Dem
    row: float
    col: float
    ground_m: float


@dataclass(frozen=True)
class PlaceSigmas:
    """Sigmas of the place, horizontally and in altitude, and of the DEM's heights, metres."""

    horizontal_m: float
    altitude_m: float
    dem_m: float


def parse_place(text: str) -> tuple[float, float]:
    """ "LAT,LON" in degrees, normalised to -180 <= lon < 180. ``ValueError``, one sentence, for anything else."""
    try:
        lat_deg, lon_deg = (float(part) for part in text.split(","))
    except ValueError:
        raise ValueError(
            f"{text!r} is no place; give LAT,LON in degrees, for example 37.2012,-122.1034"
        ) from None
    if not (-90.0 <= lat_deg <= 90.0 and -360.0 <= lon_deg <= 360.0):
        raise ValueError(f"{text!r} is no place on Earth; latitude comes first")
    return lat_deg, wrapped_lon_deg(lon_deg)


def known_place(
    lat_deg: float, lon_deg: float, dem_paths: tuple[Path, ...], option: str = "--at"
) -> KnownPlace:
    """The place on the DEM. ``CalibrationError`` if the DEM does not cover it."""
    dem = load_dem(dem_paths)
    if not dem.shift.known:
        raise CalibrationError(
            f"{dem_paths[0]}: its datum is not known, so {option} may lie hundreds of metres off in it; write the CRS with its "
            "datum into the file, with gdal_edit -a_srs EPSG:..."
        )
    if dem.heights.altitude_sigma_m:
        raise CalibrationError(
            f"{dem_paths[0]}: its elevations count from the ellipsoid, an altimeter's from the sea; bring them there, with "
            "gdalwarp -t_srs EPSG:...+5773"
        )
    row, col = (float(x) for x in lonlat_to_rowcol(dem, lon_deg, lat_deg))
    ground_m = float(dem.ground_m(row, col))
    if not np.isfinite(ground_m):
        raise CalibrationError(
            f"{option} {lat_deg:.5f},{lon_deg:.5f}: {dem_paths[0]} has no height there; check the place or take another DEM"
        )
    return KnownPlace(lat_deg, lon_deg, dem, row, col, ground_m)
