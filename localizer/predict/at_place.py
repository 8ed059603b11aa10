"""The skyline that a camera would see from a place, as arrays."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from localizer.dem.at_place import rowcol_inside
from localizer.dem.lattice import Dem
from localizer.dem.prepared import prepared
from localizer.predict.views import Standpoint, Summit, standpoint, view, warnings

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]


@dataclass(frozen=True)
class PredictedSkyline:
    """The skyline that the terrain has from a place; what `predict_skyline` returns.

    Attributes
    ----------
    standpoint : Standpoint
        Where the camera is put.
    azimuth_deg : ndarray of float, shape (n,)
        True azimuths, 0 to 360, from left to right.
    offset_deg : ndarray of float, shape (n,)
        Azimuths counted from the middle of the view; they run on through north.
    elevation_deg : ndarray of float, shape (n,)
        Angle of the skyline above the horizontal; NaN where the ray meets no terrain.
    distance_m : ndarray of float, shape (n,)
        Distance along the ground of the terrain that forms the skyline; NaN likewise.
    at_dem_edge : ndarray of bool, shape (n,)
        The skyline lies within three cells of the DEM's edge or of a void, or there is none: the terrain beyond is unknown,
        and the search does not use it.
    below_resolution : ndarray of bool, shape (n,)
        The skyline is nearer than two cells: the DEM is too coarse to tell its shape.
    may_be_overtopped : ndarray of bool, shape (n,)
        Land beyond the DEM's edge, were it as high as the DEM's highest, would stand above the skyline.
    summits : tuple of Summit
        The most prominent points of the skyline, by azimuth.
    warnings : tuple of str
        What not to rely upon, in sentences.
    """

    standpoint: Standpoint
    azimuth_deg: Floats
    offset_deg: Floats
    elevation_deg: Floats
    distance_m: Floats
    at_dem_edge: Flags
    below_resolution: Flags
    may_be_overtopped: Flags
    summits: tuple[Summit, ...]
    warnings: tuple[str, ...]

    @property
    def reliable(self) -> Flags:
        """Where the DEM can tell the skyline, shape (n,): neither at its edge nor too near."""
        return ~(self.at_dem_edge | self.below_resolution)


def predict_skyline(
    dem: Dem,
    lat_deg: float,
    lon_deg: float,
    *,
    mast_height_m: float = 2.0,
    azimuth_deg: float = 180.0,
    fov_deg: float = 360.0,
) -> PredictedSkyline:
    """Predict the skyline that a camera would see from a place.

    Parameters
    ----------
    dem : Dem
        The elevation model.
    lat_deg, lon_deg : float
        The place, WGS84 degrees.
    mast_height_m : float, optional
        Height of the camera above the ground, metres.
    azimuth_deg : float, optional
        True azimuth of the middle of the view.
    fov_deg : float, optional
        Width of the view. The default view goes all round, from north to north.

    Returns
    -------
    PredictedSkyline
        The skyline every 0.05 degrees, and where it is not to be relied upon.

    Raises
    ------
    DemError
        The place lies outside the DEM.
    SkyfixError
        The place lies in a void of the DEM.
    ValueError
        A number is out of range.

    See Also
    --------
    horizon : In any directions, from any altitude, of many places at once.
    project : Directions to pixels of a camera.

    Examples
    --------
    >>> dem = localizer.load_dem("terrain.tif")
    >>> east = localizer.predict_skyline(dem, 37.25, -122.15, azimuth_deg=90.0, fov_deg=60.0)
    >>> highest = max(east.summits, key=lambda summit: summit.elevation_deg)
    >>> f"{highest.height_m:.0f} m high, {highest.distance_m / 1000:.1f} km away at {highest.azimuth_deg:.0f} deg"
    '806 m high, 1.1 km away at 101 deg'
    """
    if not (np.isfinite([lat_deg, lon_deg, azimuth_deg]).all() and 0.0 <= mast_height_m < np.inf):
        raise ValueError("lat_deg, lon_deg, azimuth_deg: should be finite; mast_height_m: not negative")
    if not 0.0 < fov_deg <= 360.0:
        raise ValueError(f"fov_deg: is {fov_deg:g}; should be more than 0 and at most 360")
    rowcol_inside(dem, np.asarray(lat_deg, float), np.asarray(lon_deg, float))
    place = standpoint(dem, lat_deg, lon_deg, mast_height_m)
    seen = view(prepared(dem), place, azimuth_deg % 360.0, fov_deg)
    return PredictedSkyline(
        standpoint=place,
        azimuth_deg=seen.azimuths_deg,
        offset_deg=seen.offset_deg,
        elevation_deg=np.where(np.isnan(seen.distance_m), np.nan, seen.elevation_deg),
        distance_m=seen.distance_m,
        at_dem_edge=seen.at_edge,
        below_resolution=seen.too_near,
        may_be_overtopped=seen.may_be_overtopped,
        summits=seen.summits,
        warnings=tuple(warnings(seen)),
    )
