"""Scale and convergence of a map projection at a place: map units against metres on the ground.

A map unit is a metre on the ground only where the scale is 1; in Web Mercator at 68 degrees north it is 0.38 m. Published
sigmas, distances and covariances are in metres on the ground. Those of (easting, northing) have the axes of the map, which
are rotated from true east and north by the convergence. Only drawings on a map use map units.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pyproj import CRS, Geod
from pyproj.exceptions import CRSError

from localizer.dem.crs import geographic_crs, own_lonlat_deg, own_xy, x_period
from localizer.errors import SkyfixError

Floats = NDArray[np.float64]

NEIGHBOUR_M = 100.0
"""Geodesics of this length measure the scale: curvature adds 1e-10 of it, rounding 1e-11."""


class MapError(SkyfixError):
    """An unknown name of a CRS; another version of PROJ may know it."""


@dataclass(frozen=True, eq=False)
class MapMetres:
    """Scale and convergence at one place of a map with eastings and northings in metres."""

    to_map: Floats
    """(2, 2): from metres to true east and north to metres of easting and northing."""

    @property
    def convergence_deg(self) -> float:
        """Meridian convergence: azimuth of grid north, clockwise from true north; grid_azimuth = true_azimuth - convergence."""
        return float(convergence_deg(self.to_map))

    @property
    def grid_from_true(self) -> Floats:
        """(2, 2), a rotation: from metres to true east and north to metres of the ground along the map's axes."""
        turn = np.radians(self.convergence_deg)
        return np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])

    @property
    def map_from_ground(self) -> Floats:
        """(2, 2): from metres of the ground along the map's axes to metres of the map."""
        return np.asarray(self.to_map @ self.grid_from_true.T)

    @property
    def scale(self) -> float:
        """Map units per metre on the ground; the geometric mean if it depends on the direction."""
        return float(np.sqrt(abs(np.linalg.det(self.to_map))))

    @property
    def axis_scales(self) -> tuple[float, float]:
        """The same along the map's east and along its north."""
        along = np.linalg.norm(np.linalg.inv(self.to_map), axis=0)
        return float(1.0 / along[0]), float(1.0 / along[1])

    def ground_covariance(self, of_true_m2: ArrayLike) -> Floats:
        """(2, 2) of easting and northing in metres of the ground, from one of true east and north."""
        return np.asarray(self.grid_from_true @ np.asarray(of_true_m2) @ self.grid_from_true.T)

    def true_covariance(self, of_ground_m2: ArrayLike) -> Floats:
        """The inverse of ``ground_covariance``."""
        return np.asarray(self.grid_from_true.T @ np.asarray(of_ground_m2) @ self.grid_from_true)

    def map_covariance(self, of_ground_m2: ArrayLike) -> Floats:
        """(2, 2) of easting and northing in the map's own metres, to be drawn on it."""
        return np.asarray(self.map_from_ground @ np.asarray(of_ground_m2) @ self.map_from_ground.T)


def map_metres(crs: CRS | str, easting_m: float, northing_m: float) -> MapMetres:
    """Scale and convergence at one place. ``crs``: projected, in metres, or the name of such a CRS.

    Raises ``MapError`` for an unknown name.
    """
    return MapMetres(to_map_metres(_crs(crs), easting_m, northing_m))


def to_map_metres(crs: CRS, easting_m: ArrayLike, northing_m: ArrayLike) -> Floats:
    """(..., 2, 2): from metres to true east and north to easting and northing at places of a map.

    North is that of the CRS's own datum.
    """
    easting, northing = np.broadcast_arrays(
        np.asarray(easting_m, np.float64), np.asarray(northing_m, np.float64)
    )
    lon_deg, lat_deg = own_lonlat_deg(crs, easting, northing)
    azimuths = np.array([90.0, 270.0, 0.0, 180.0])
    shape = (*easting.shape, len(azimuths))
    start_lon, start_lat = (np.broadcast_to(angle[..., None], shape).ravel() for angle in (lon_deg, lat_deg))
    to_lon, to_lat, _ = _geod(crs).fwd(
        start_lon, start_lat, np.broadcast_to(azimuths, shape).ravel(), np.full(start_lon.shape, NEIGHBOUR_M)
    )
    x, y = (np.reshape(end, shape) for end in own_xy(crs, to_lon, to_lat))
    ends = np.stack([_near(crs, x, easting[..., None]), y], axis=-1)  # (..., 4, 2)
    columns = [(ends[..., i, :] - ends[..., i + 1, :]) / (2.0 * NEIGHBOUR_M) for i in (0, 2)]
    return np.stack(columns, axis=-1)


def convergence_deg(to_map: Floats) -> Floats:
    """Of matrices (..., 2, 2) as ``to_map_metres`` gives them: the direction of the map's north, clockwise from true north."""
    return np.asarray(np.degrees(-np.arctan2(to_map[..., 0, 1], to_map[..., 1, 1])))


def ground_offset_m(crs: CRS | str, start: tuple[float, float], end: tuple[float, float]) -> Floats:
    """(2,): metres of the ground from one (easting, northing) to another, along the map's axes at ``start``.

    Its length is that of the geodesic, and its direction the geodesic's first one, turned by the convergence.
    """
    known = _crs(crs)
    lon_deg, lat_deg = own_lonlat_deg(known, [start[0], end[0]], [start[1], end[1]])
    azimuth_deg, _, distance_m = _geod(known).inv(lon_deg[0], lat_deg[0], lon_deg[1], lat_deg[1])
    azimuth = np.radians(azimuth_deg)
    of_true = distance_m * np.array([np.sin(azimuth), np.cos(azimuth)])
    return np.asarray(map_metres(known, *start).grid_from_true @ of_true)


def ground_distance_m(crs: CRS | str, start: tuple[float, float], end: tuple[float, float]) -> float:
    """Length of the geodesic between two (easting, northing)."""
    known = _crs(crs)
    lon_deg, lat_deg = own_lonlat_deg(known, [start[0], end[0]], [start[1], end[1]])
    return float(_geod(known).inv(lon_deg[0], lat_deg[0], lon_deg[1], lat_deg[1])[2])


@lru_cache(maxsize=64)
def _named(name: str) -> CRS:
    try:
        return CRS.from_user_input(name)
    except (CRSError, RecursionError):
        raise MapError(f"{name[:200]!r} is no coordinate reference system that is known here") from None


def _crs(crs: CRS | str) -> CRS:
    return _named(crs) if isinstance(crs, str) else crs


def _geod(crs: CRS) -> Geod:
    ellipsoid = geographic_crs(crs).get_geod()
    assert ellipsoid is not None  # a geographic CRS has one
    return ellipsoid


def _near(crs: CRS, x: Floats, near_x: Floats) -> Floats:
    """x shifted by whole periods to be nearest to ``near_x``: a cylindrical map is periodic in x."""
    turn = x_period(crs)
    return x if turn is None else np.asarray(x + turn * np.round((near_x - x) / turn))
