"""Elevation and horizon at places given in latitude and longitude."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from localizer.dem.geodesy import bounds_deg, lonlat_to_rowcol
from localizer.dem.horizon import REFRACTION
from localizer.dem.horizon import horizon as horizon_from_cells
from localizer.dem.lattice import Dem
from localizer.dem.open import DemError
from localizer.dem.prepared import prepared

Floats = NDArray[np.float64]


class Horizon(NamedTuple):
    """The horizon in some directions; what `horizon` returns.

    Attributes
    ----------
    elevation_deg : ndarray of float
        Angle above the horizontal; NaN where the ray meets no terrain within the DEM.
    distance_m : ndarray of float, same shape
        Distance along the ground of the terrain that forms the horizon; NaN likewise.
    """

    elevation_deg: Floats
    distance_m: Floats


def ground_elevation_m(dem: Dem, lat_deg: ArrayLike, lon_deg: ArrayLike) -> Floats:
    """Interpolate the elevation of the ground at places.

    Parameters
    ----------
    dem : Dem
        The elevation model.
    lat_deg, lon_deg : array_like of float
        Places, WGS84 degrees, broadcast against each other. Longitudes may be off by whole turns.

    Returns
    -------
    ndarray of float
        Metres above the DEM's vertical datum, bilinear between the cells' centres, in the shape of the places. NaN outside
        the DEM and in voids.

    Examples
    --------
    >>> dem = localizer.load_dem("terrain.tif")
    >>> localizer.ground_elevation_m(dem, [37.25, 37.26], -122.15).round(1)
    array([630., 462.])
    """
    return dem.ground_m(*lonlat_to_rowcol(dem, lon_deg, lat_deg))


def horizon(
    dem: Dem,
    lat_deg: ArrayLike,
    lon_deg: ArrayLike,
    altitude_m: ArrayLike,
    azimuth_deg: ArrayLike,
    *,
    refraction_coefficient: float = REFRACTION,
) -> Horizon:
    """Compute the horizon that the terrain has around places.

    Parameters
    ----------
    dem : Dem
        The elevation model. What can be seen only beyond its edge is unknown.
    lat_deg, lon_deg : array_like of float
        Places of the observer, WGS84 degrees.
    altitude_m : array_like of float
        Altitude of the eye above the DEM's vertical datum. Broadcast against the places.
    azimuth_deg : array_like of float
        True azimuths, clockwise from north, a number or (m,): the same for all places.
    refraction_coefficient : float, optional
        Curvature of the line of sight as a share of the Earth's, k. 0 is a straight line.

    Returns
    -------
    Horizon
        Arrays ``elevation_deg`` and ``distance_m``. Their shape is that of the places followed by that of the azimuths:
        (m,) for one place and m azimuths, (n, m) for n places.

    Raises
    ------
    DemError
        A place lies outside the DEM.
    ValueError
        A number is not finite, or the azimuths have more than one axis.

    See Also
    --------
    predict_skyline : The same from a mast on the ground, with the parts marked that the DEM cannot tell.

    Notes
    -----
    The surface is bilinear between cell centres, and the horizon on it is exact, not sampled. Rays are geodesics. A point at
    distance x appears lower by ``(1 - k) x**2 / (2 R)`` with R = 6371008.8 m.

    The first call for a DEM prepares it, which takes about a second for a million cells; the result is kept with the DEM. The
    first call on a machine compiles for some seconds.

    Examples
    --------
    >>> dem = localizer.load_dem("terrain.tif")
    >>> eye_m = localizer.ground_elevation_m(dem, 37.25, -122.15) + 2.0
    >>> elevation_deg, distance_m = localizer.horizon(dem, 37.25, -122.15, eye_m, [0.0, 90.0, 180.0])
    >>> elevation_deg.round(2)
    array([ 3.81,  6.66, 16.1 ])
    """
    lat, lon, eye_m = np.broadcast_arrays(
        *(np.asarray(values, np.float64) for values in (lat_deg, lon_deg, altitude_m))
    )
    azimuth = np.asarray(azimuth_deg, np.float64)
    for name, values in (
        ("lat_deg", lat),
        ("lon_deg", lon),
        ("altitude_m", eye_m),
        ("azimuth_deg", azimuth),
        ("refraction_coefficient", np.asarray(refraction_coefficient)),
    ):
        if not np.isfinite(values).all():
            raise ValueError(f"{name}: should be finite")
    if azimuth.ndim > 1:
        raise ValueError(f"azimuth_deg: has shape {azimuth.shape}; give a number or one axis")
    row, col = rowcol_inside(dem, lat, lon)
    elevation_deg, distance_m = horizon_from_cells(
        prepared(dem, refraction_coefficient), row.ravel(), col.ravel(), eye_m.ravel(), azimuth.ravel()
    )
    shape = lat.shape + azimuth.shape
    elevation_deg = np.where(np.isnan(distance_m), np.nan, elevation_deg)
    return Horizon(elevation_deg.reshape(shape), distance_m.reshape(shape))


def rowcol_inside(dem: Dem, lat_deg: Floats, lon_deg: Floats) -> tuple[Floats, Floats]:
    """Row and col of places. Raises ``DemError`` where one lies outside the DEM."""
    row, col = lonlat_to_rowcol(dem, lon_deg, lat_deg)
    outside = ~((row >= 0.0) & (row <= dem.rows - 1) & (col >= 0.0) & (col <= dem.cols - 1))
    if outside.any():
        south, west, north, east = bounds_deg(dem, [0.0, dem.rows - 1], [0.0, dem.cols - 1])
        first = int(np.argmax(outside))
        raise DemError(
            f"{lat_deg.flat[first]:.5f},{lon_deg.flat[first]:.5f} lies outside the DEM, which reaches from {south:.5f} to "
            f"{north:.5f} north and from {west:.5f} to {east:.5f} east; it is LAT,LON in degrees"
        )
    return row, col
