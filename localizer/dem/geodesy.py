"""Between lattice positions, map coordinates and true directions, for any coordinate reference system.

Rows and columns count cell centres and may be fractions. Grid north, true north and magnetic north are three
things: nothing here is magnetic, and where a direction is the grid's the name says so.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pyproj import Geod

from localizer.dem.crs import (
    WGS84,
    geographic_crs,
    lattice_xy,
    own_lonlat_deg,
    own_xy,
    transform_xy,
    wrapped_deg,
    x_period,
)
from localizer.dem.ground import MapMetres, convergence_deg, map_metres, to_map_metres
from localizer.dem.lattice import Dem

Floats = NDArray[np.float64]

LINEAR_M = 100.0
"""Geodesics of this length give the linear coefficients: curvature adds 1e-10 of it, rounding 1e-11."""
QUADRATIC_M = 20_000.0
"""Geodesics of this length give the quadratic coefficients: about the distance of most horizons."""
NODE_SPACING_M = 15_000.0
"""Largest distance between nodes: closer, the coefficients are linear in between to better than 1e-6."""
MIN_NODES, MAX_NODES = 3, 65


def rowcol_to_xy(dem: Dem, row: ArrayLike, col: ArrayLike) -> tuple[Floats, Floats]:
    """x, y in the DEM's own CRS."""
    return lattice_xy(dem.transform, row, col)


def xy_to_rowcol(dem: Dem, x: ArrayLike, y: ArrayLike) -> tuple[Floats, Floats]:
    """Row, col of coordinates in the DEM's own CRS. Longitudes, and x of a map on a cylinder, may be off by whole turns."""
    x, y = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
    turn = x_period(dem.crs)
    if turn is not None:
        centre_x = dem.transform.c + dem.transform.a * dem.cols / 2
        x = x + turn * np.round((centre_x - x) / turn)
    return (y - dem.transform.f) / dem.transform.e - 0.5, (x - dem.transform.c) / dem.transform.a - 0.5


def rowcol_to_metric(dem: Dem, row: ArrayLike, col: ArrayLike) -> tuple[Floats, Floats]:
    """Turn positions in the DEM's cells into map coordinates.

    Parameters
    ----------
    dem : Dem
        The elevation model.
    row, col : array_like of float
        Cell centres at whole numbers.

    Returns
    -------
    easting_m, northing_m : ndarray of float
        In ``dem.metric_crs``.

    Examples
    --------
    >>> dem = localizer.load_dem("terrain.tif")
    >>> easting_m, northing_m = localizer.rowcol_to_metric(dem, 400.0, [100.0, 101.0])
    >>> dem.metric_crs.name, easting_m.round(1)
    ('WGS 84 / UTM zone 10N', array([566525.7, 566550.3]))
    """
    return xy_to_metric(dem, *rowcol_to_xy(dem, row, col))


def xy_to_metric(dem: Dem, x: ArrayLike, y: ArrayLike) -> tuple[Floats, Floats]:
    """Easting, northing in ``dem.metric_crs`` of coordinates in the DEM's own CRS."""
    if dem.crs == dem.metric_crs:
        return transform_xy(dem.crs, dem.metric_crs, x, y)
    return transform_xy(WGS84, dem.metric_crs, *dem.to_lonlat_deg(x, y))


def metric_to_lonlat(dem: Dem, easting_m: ArrayLike, northing_m: ArrayLike) -> tuple[Floats, Floats]:
    """WGS84 longitude, -180 <= lon < 180, and latitude of coordinates in ``dem.metric_crs``."""
    if dem.crs == dem.metric_crs:
        return _wrapped(*dem.to_lonlat_deg(easting_m, northing_m))
    return _wrapped(*transform_xy(dem.metric_crs, WGS84, easting_m, northing_m))


def metric_to_rowcol(dem: Dem, easting_m: ArrayLike, northing_m: ArrayLike) -> tuple[Floats, Floats]:
    """Turn map coordinates into positions in the DEM's cells.

    Parameters
    ----------
    dem : Dem
        The elevation model.
    easting_m, northing_m : array_like of float
        In ``dem.metric_crs``.

    Returns
    -------
    row, col : ndarray of float
        Cell centres at whole numbers; also beyond the DEM's edge.

    Examples
    --------
    >>> dem = localizer.load_dem("terrain.tif")
    >>> row, col = localizer.metric_to_rowcol(dem, 570000.0, 4125000.0)
    >>> print(row.round(1), col.round(1))
    281.8 242.2
    """
    if dem.crs == dem.metric_crs:
        return xy_to_rowcol(dem, easting_m, northing_m)
    return xy_to_rowcol(
        dem, *dem.from_lonlat_deg(*transform_xy(dem.metric_crs, WGS84, easting_m, northing_m))
    )


def rowcol_to_lonlat(dem: Dem, row: ArrayLike, col: ArrayLike) -> tuple[Floats, Floats]:
    """Turn positions in the DEM's cells into longitude and latitude.

    Parameters
    ----------
    dem : Dem
        The elevation model.
    row, col : array_like of float
        Cell centres at whole numbers.

    Returns
    -------
    lon_deg, lat_deg : ndarray of float
        WGS84, -180 <= lon_deg < 180 whatever the DEM's own are.

    Examples
    --------
    >>> dem = localizer.load_dem("terrain.tif")
    >>> lon_deg, lat_deg = localizer.rowcol_to_lonlat(dem, 0.0, 0.0)  # the centre of the north-western cell
    >>> print(lon_deg.round(4), lat_deg.round(4))
    -122.2778 37.3472
    """
    return _wrapped(*dem.to_lonlat_deg(*rowcol_to_xy(dem, row, col)))


def _wrapped(lon_deg: Floats, lat_deg: Floats) -> tuple[Floats, Floats]:
    return wrapped_deg(lon_deg), lat_deg


def lonlat_to_rowcol(dem: Dem, lon_deg: ArrayLike, lat_deg: ArrayLike) -> tuple[Floats, Floats]:
    """Turn longitude and latitude into positions in the DEM's cells.

    Parameters
    ----------
    dem : Dem
        The elevation model.
    lon_deg, lat_deg : array_like of float
        WGS84; longitudes may be off by whole turns.

    Returns
    -------
    row, col : ndarray of float
        Cell centres at whole numbers; also beyond the DEM's edge.

    Examples
    --------
    >>> dem = localizer.load_dem("terrain.tif")
    >>> row, col = localizer.lonlat_to_rowcol(dem, [-122.15, -122.14], 37.25)
    >>> row.round(1), col.round(1)
    (array([350., 350.]), array([460., 496.]))
    """
    return xy_to_rowcol(dem, *dem.from_lonlat_deg(wrapped_deg(lon_deg), lat_deg))


def bounds_deg(
    dem: Dem, rows: Sequence[float] | Floats, cols: Sequence[float] | Floats
) -> tuple[float, float, float, float]:
    """South, west, north, east of the places at ``rows`` x ``cols``, WGS84. Across the date line west is more than east."""
    row, col = np.meshgrid(np.asarray(rows, np.float64), np.asarray(cols, np.float64))
    lon_deg, lat_deg = rowcol_to_lonlat(dem, row, col)
    centre_lon_deg, _ = rowcol_to_lonlat(dem, float(np.mean(rows)), float(np.mean(cols)))
    # relative to the centre, so that an area across the date line is not split
    from_centre = wrapped_deg(lon_deg - centre_lon_deg)
    west, east = wrapped_deg(centre_lon_deg + np.array([from_centre.min(), from_centre.max()]))
    return float(lat_deg.min()), float(west), float(lat_deg.max()), float(east)


def enu_to_metric_jacobian(dem: Dem, row: ArrayLike, col: ArrayLike) -> Floats:
    """(..., 2, 2): from metres to true east and north to easting and northing in ``dem.metric_crs``.

    A covariance C of (east, north) becomes J C J^T in map units. J contains the meridian convergence and the map scale;
    ``localizer.dem.ground`` separates them.
    """
    return to_map_metres(dem.metric_crs, *rowcol_to_metric(dem, row, col))


def map_metres_at(dem: Dem, row: float, col: float) -> MapMetres:
    """Scale and convergence of ``dem.metric_crs`` at a place."""
    easting_m, northing_m = rowcol_to_metric(dem, row, col)
    return map_metres(dem.metric_crs, float(easting_m), float(northing_m))


def meridian_convergence_deg(dem: Dem, row: ArrayLike, col: ArrayLike) -> Floats:
    """Direction of the grid north of ``dem.metric_crs``, degrees clockwise from true north.

    grid_azimuth = true_azimuth - convergence. In a UTM zone of the northern hemisphere it is positive east of
    the central meridian.
    """
    return convergence_deg(enu_to_metric_jacobian(dem, row, col))


@dataclass(frozen=True, eq=False)
class GeodesicExpansion:
    """Second-order expansion of geodesics in lattice coordinates, anywhere on a DEM.

    A geodesic that leaves (row, col) in true azimuth A reaches after s metres, with e = s sin A, n = s cos A,

        row + r_e e + r_n n + r_ee e^2 + r_en e n + r_nn n^2

    and likewise the column. The coefficients contain the convergence and scale of a map projection, and the convergence of
    the meridians in a geographic grid.
    """

    node_rows: Floats
    """(k,) rows of the nodes, ascending, evenly spaced."""
    node_cols: Floats
    """(l,)"""
    coefficients: Floats
    """(k, l, 2, 5): for row and column (axis 2) those of e, n, e^2, e n, n^2 (axis 3)."""

    def at(self, row: ArrayLike, col: ArrayLike) -> Floats:
        """Coefficients (n, 2, 5) at n positions, bilinear between the nodes and beyond the outermost."""
        row, col = np.broadcast_arrays(
            np.atleast_1d(np.asarray(row, np.float64)), np.atleast_1d(np.asarray(col, np.float64))
        )
        i, wi = _between(self.node_rows, row)
        j, wj = _between(self.node_cols, col)
        k, l = self.coefficients.shape[:2]  # noqa: E741
        nodes = self.coefficients.reshape(k * l, 10)
        first = i * l + j
        out: Floats = nodes[first] * ((1.0 - wi) * (1.0 - wj))[:, None]
        out += nodes[first + 1] * ((1.0 - wi) * wj)[:, None]
        out += nodes[first + l] * (wi * (1.0 - wj))[:, None]
        out += nodes[first + l + 1] * (wi * wj)[:, None]
        return np.reshape(out, (-1, 2, 5))


def geodesic_end(
    coefficients: Floats, row: float, col: float, east_m: ArrayLike, north_m: ArrayLike
) -> tuple[Floats, Floats]:
    """Row and col, elementwise, where geodesics from (row, col) end, given their components to true east and north.

    ``coefficients``: (2, 5), the coefficients there, or a few cells away.
    """
    e, n = np.asarray(east_m, np.float64), np.asarray(north_m, np.float64)
    steps = np.tensordot(coefficients, np.array([e, n, e * e, e * n, n * n]), axes=1)
    return row + steps[0], col + steps[1]


def geodesic_expansion(dem: Dem) -> GeodesicExpansion:
    """Fit the coefficients on a coarse grid of nodes over the DEM. Takes some milliseconds."""
    node_rows = np.linspace(0.0, dem.rows - 1, _node_count(dem.rows * dem.spacing_ns_m))
    node_cols = np.linspace(0.0, dem.cols - 1, _node_count(dem.cols * dem.spacing_ew_m))
    row, col = np.meshgrid(node_rows, node_cols, indexing="ij")
    start = np.stack([row, col], axis=-1)  # (k, l, 2)

    axes = np.array([90.0, 270.0, 0.0, 180.0])
    short = _along_geodesic(dem, row, col, axes, LINEAR_M)
    east, north = (short[..., a, :] - short[..., a + 1, :] for a in (0, 2))
    linear = np.stack([east, north], axis=-1) / (2.0 * LINEAR_M)

    # even parts, without odd orders
    diagonals = np.array([45.0, 225.0, 135.0, 315.0])
    far = _along_geodesic(dem, row, col, np.concatenate([axes, diagonals]), QUADRATIC_M)
    even = (far[..., 0::2, :] + far[..., 1::2, :]) / 2.0 - start[..., None, :]
    ee, nn, north_east, south_east = np.moveaxis(even, -2, 0) / QUADRATIC_M**2
    quadratic = np.stack([ee, north_east - south_east, nn], axis=-1)
    return GeodesicExpansion(node_rows, node_cols, np.concatenate([linear, quadratic], axis=-1))


def _node_count(extent_m: float) -> int:
    return int(np.clip(np.ceil(extent_m / NODE_SPACING_M) + 1, MIN_NODES, MAX_NODES))


def _between(nodes: Floats, position: Floats) -> tuple[NDArray[np.int64], Floats]:
    """Index of the node before each position and the weight of the one after it."""
    scaled = (position - nodes[0]) / (nodes[1] - nodes[0])
    before = np.clip(np.floor(scaled), 0, len(nodes) - 2).astype(np.int64)
    return before, scaled - before


def _along_geodesic(dem: Dem, row: Floats, col: Floats, azimuth_deg: Floats, distance_m: float) -> Floats:
    """End points of geodesics of one length, (..., azimuths, 2): row, col.

    They run on the ellipsoid of the DEM's own datum, on which true north is defined here.
    """
    lon_deg, lat_deg = own_lonlat_deg(dem.crs, *rowcol_to_xy(dem, row, col))
    shape = (*row.shape, len(azimuth_deg))
    lon_deg, lat_deg = (np.broadcast_to(angle[..., None], shape).ravel() for angle in (lon_deg, lat_deg))
    azimuths = np.broadcast_to(azimuth_deg, shape).ravel()
    to_lon, to_lat, _ = geod(dem).fwd(lon_deg, lat_deg, azimuths, np.full(azimuths.shape, distance_m))
    ends = xy_to_rowcol(dem, *own_xy(dem.crs, to_lon, to_lat))
    return np.stack(ends, axis=-1).reshape(*shape, 2)


def geod(dem: Dem) -> Geod:
    """The ellipsoid of the DEM's datum."""
    ellipsoid = geographic_crs(dem.crs).get_geod()
    assert ellipsoid is not None  # a geographic CRS has one
    return ellipsoid
