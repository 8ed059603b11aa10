"""Coordinate reference systems: transformations, longitudes, units and names."""

from functools import lru_cache

import numpy as np
from affine import Affine
from numpy.typing import ArrayLike, NDArray
from pyproj import CRS, Transformer, network

network.set_network_enabled(False)  # type: ignore[attr-defined]  # overrides PROJ_NETWORK: nothing is downloaded at run time

WGS84 = CRS.from_epsg(4326)
LONGEST_NAME = 30
"""Longest name of a CRS that is shown; WKT is longer."""


@lru_cache(maxsize=64)
def transformer(source: CRS, target: CRS) -> Transformer:
    """From ``source`` to ``target``; x (east, or longitude) always comes first."""
    return Transformer.from_crs(source, target, always_xy=True)


def lattice_xy(
    transform: Affine, row: ArrayLike, col: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """x, y of lattice positions: cell centres at whole numbers; ``transform`` counts from cells' corners."""
    row, col = np.asarray(row, np.float64), np.asarray(col, np.float64)
    x, y = transform.a * (col + 0.5) + transform.c, transform.e * (row + 0.5) + transform.f
    x, y = np.broadcast_arrays(x, y)
    return np.array(x), np.array(y)


def transform_xy(
    source: CRS, target: CRS, x: ArrayLike, y: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Coordinates in ``target``, elementwise; infinite outside its domain."""
    x, y = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
    if source == target:
        return x.copy(), y.copy()
    to_x, to_y = transformer(source, target).transform(x, y)
    return np.asarray(to_x, np.float64), np.asarray(to_y, np.float64)


def own_lonlat_deg(crs: CRS, x: ArrayLike, y: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Longitude and latitude in degrees on the CRS's own datum, from its own prime meridian."""
    geographic = geographic_crs(crs)
    lon, lat = transform_xy(crs, geographic, x, y)
    degrees = degrees_per_unit(geographic)
    return lon * degrees, lat * degrees


def own_xy(
    crs: CRS, lon_deg: ArrayLike, lat_deg: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The inverse of ``own_lonlat_deg``."""
    geographic = geographic_crs(crs)
    degrees = degrees_per_unit(geographic)
    return transform_xy(geographic, crs, np.asarray(lon_deg) / degrees, np.asarray(lat_deg) / degrees)


def degrees_per_unit(geographic: CRS) -> float:
    """Degrees per unit of a geographic CRS: 1, except for those in grads."""
    # by name, because pi / 180 converted back need not be exactly 1
    factor = geographic.axis_info[0].unit_conversion_factor
    return 1.0 if geographic.axis_info[0].unit_name == "degree" else float(np.degrees(factor))


@lru_cache(maxsize=64)
def geographic_crs(crs: CRS) -> CRS:
    """The two-dimensional geographic CRS that ``crs`` is based on; itself if it is geographic and not derived.

    The north of a derived CRS (a rotated pole) is not true north: its base CRS is returned.
    """
    geographic = crs if crs.is_geographic else crs.geodetic_crs
    while geographic is not None and "Derived" in geographic.type_name:
        geographic = geographic.source_crs
    if geographic is None:
        raise ValueError(f"{crs.name} has no geodetic datum")
    return geographic.to_2d()


def is_projected(crs: CRS) -> bool:
    """Whether the CRS is a map projection, or one derived from that."""
    return bool(crs.is_projected) or crs.type_name == "Derived Projected CRS"


def is_metric(crs: CRS) -> bool:
    """Whether the CRS is a map projection in metres."""
    return is_projected(crs) and all(axis.unit_conversion_factor == 1.0 for axis in crs.axis_info)


def wrapped_deg(lon_deg: ArrayLike) -> NDArray[np.float64]:
    """Longitudes wrapped to -180 <= lon < 180; values within that range are returned unchanged, bit by bit."""
    lon = np.asarray(lon_deg, np.float64)
    with np.errstate(invalid="ignore"):
        turned = (lon + 180.0) % 360.0 - 180.0
    # a value just below -180 can round to 180
    turned = np.where(turned >= 180.0, -180.0, turned)
    keep = ((lon >= -180.0) & (lon < 180.0)) | ~np.isfinite(lon)
    return np.asarray(np.where(keep, lon, turned))


def wrapped_lon_deg(lon_deg: float) -> float:
    """One longitude, -180 <= lon < 180."""
    return float(wrapped_deg(lon_deg))


@lru_cache(maxsize=64)
def x_period(crs: CRS) -> float | None:
    """Period of x over 360 degrees of longitude, for geographic CRS and cylindrical projections; None for all others."""
    if crs.is_geographic:
        return 360.0 / degrees_per_unit(crs)
    # tested at two places, because the map may be cut at one of them
    west = np.array([0.0, 1.0, 2.0, 0.0, 1.0, 2.0, 120.0, 121.0, 122.0, 120.0, 121.0, 122.0])
    south = np.array([0.0, 0.0, 0.0, 40.0, 40.0, 40.0] * 2)
    x, _ = own_xy(crs, west, south)
    if not np.isfinite(x).all():
        return None
    for part in x.reshape(2, 6):
        steps = np.diff(part.reshape(2, 3), axis=1)
        if (
            np.ptp(steps) < 1e-9 * abs(steps[0, 0])
            and np.ptp(part[:3] - part[3:]) == 0.0 == part[0] - part[3]
        ):
            return float(360.0 * steps[0, 0])
    return None


UTM_SOUTH_DEG, UTM_NORTH_DEG = -80.0, 84.0


def utm_crs(lon_deg: float, lat_deg: float) -> CRS:
    """The WGS84 UTM zone of a place; Universal Polar Stereographic beyond 84 degrees north and 80 south.

    With the exceptions of the grid (DMA TM 8358.2): zone 32 reaches over south-western Norway, and Svalbard has only
    the zones 31, 33, 35 and 37.
    """
    if not UTM_SOUTH_DEG <= lat_deg <= UTM_NORTH_DEG:
        return CRS.from_epsg(5041 if lat_deg > 0.0 else 5042)
    lon_deg = wrapped_lon_deg(lon_deg)
    zone = int((lon_deg + 180.0) // 6.0) + 1
    if 56.0 <= lat_deg < 64.0 and 3.0 <= lon_deg < 12.0:
        zone = 32
    if lat_deg >= 72.0 and 0.0 <= lon_deg < 42.0:
        zone = next(z for z, east in ((31, 9.0), (33, 21.0), (35, 33.0), (37, 42.0)) if lon_deg < east)
    return CRS.from_epsg((32600 if lat_deg >= 0.0 else 32700) + zone)


def short_name(crs: CRS) -> str:
    """``EPSG:26910`` where the CRS has such a code, else its WKT."""
    return crs.to_string()


def readable_name(crs: CRS) -> str:
    """A name for users: the code, or the CRS's name instead of WKT."""
    name = short_name(crs)
    return name if len(name) < LONGEST_NAME else str(crs.name)
