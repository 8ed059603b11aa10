"""The prior circle of a bundle as a mask of DEM cells."""

import numpy as np
from numpy.typing import NDArray

from localizer.dem.datum import UNKNOWN_DATUM_M
from localizer.dem.geodesy import lonlat_to_rowcol
from localizer.dem.horizon import Terrain
from localizer.observation import Observation


def cells_within_prior(terrain: Terrain, observation: Observation) -> NDArray[np.bool_] | None:
    """Mask (rows, cols) of the cells inside the prior's circle; None without a prior."""
    prior = observation.prior
    if prior is None:
        return None
    dem = terrain.dem
    row, col = (float(value) for value in lonlat_to_rowcol(dem, prior.lon_deg, prior.lat_deg))
    inside = np.zeros((dem.rows, dem.cols), bool)
    if not np.isfinite([row, col]).all():
        return inside
    coefficients = terrain.geodesics.at(np.clip(row, 0, dem.rows), np.clip(col, 0, dem.cols))[0]
    to_ground = np.linalg.inv(
        coefficients[:, :2]
    )  # from rows and columns to metres east and north, as it is at the centre
    datum_error_m = 0.0 if dem.shift.known else UNKNOWN_DATUM_M  # the circle is given on WGS84
    radius_m = prior.radius_m + datum_error_m
    reach = 1.5 * radius_m * np.abs(coefficients[:, :2]).sum(axis=1) + 2.0
    first = np.clip(np.floor([row - reach[0], col - reach[1]]), 0, (dem.rows, dem.cols)).astype(int)
    end = np.clip(np.ceil([row + reach[0], col + reach[1]]) + 1, 0, (dem.rows, dem.cols)).astype(int)
    if (end <= first).any():
        return inside
    steps = np.stack(
        np.meshgrid(np.arange(first[0], end[0]) - row, np.arange(first[1], end[1]) - col, indexing="ij")
    )
    off_m = np.tensordot(to_ground, steps, axes=1)
    for _ in range(2):  # of a circle of many kilometres the second order counts
        e, n = off_m
        bent = np.tensordot(coefficients[:, 2:], np.array([e * e, e * n, n * n]), axes=1)
        off_m = np.tensordot(to_ground, steps - bent, axes=1)
    inside[first[0] : end[0], first[1] : end[1]] = np.hypot(*off_m) <= radius_m
    return inside
