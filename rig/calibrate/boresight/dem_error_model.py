"""Error model of the DEM along a skyline: correlated along a ridge, larger angles for nearer ridges.

A height error moves all points of a ridge together, in every picture that shows it. A second picture of the same ridge
thus adds nothing about the ridge, but determines the camera's mounting. Both follow from the covariance of the
residuals.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

Vector = NDArray[np.float64]

CORRELATION_M = 60.0
"""Correlation length of the DEM's height errors: two cells of a typical DEM."""
COMMON_VARIANCE_SHARE, COMMON_SPAN = 0.25, 0.7
"""Share of the variance common to ridges of similar distance, and the range of "similar" (natural logarithm of
distance).
"""
FACTORS = 1.5 ** np.arange(-2, 8)
"""Factors tried on the stated DEM error. Not below a half: a lucky fit does not prove a better DEM."""
OUTLIER_SIGMAS = 1.5
MIN_SPREAD = 0.3
"""A point whose residual exceeds this multiple of the others' spread is down-weighted, with the square of the excess.

In haze a far ridge is sometimes traced along a nearer one below it: always to the same side, for up to a third of it.
"""


@dataclass(frozen=True)
class DemErrorModel:
    """``whiten`` (n, n) turns residuals at n points into independent ones of unit variance.

    ``dem_factor`` is the actual DEM error over the stated one, estimated from the residuals.
    """

    whiten: Vector
    dem_factor: float


def covariance_deg2(sigma_deg: Vector, azimuth_deg: Vector, distance_m: Vector) -> Vector:
    """Covariance of the DEM's error at skyline points (n,), given its sigma there.

    A share is common to all ridges of similar distance: a DEM smooths crests, near and far ones differently.
    """
    azimuth = np.radians(azimuth_deg)
    where_m = np.column_stack([distance_m * np.sin(azimuth), distance_m * np.cos(azimuth)])
    apart_m = np.linalg.norm(where_m[:, None, :] - where_m[None, :, :], axis=-1)
    far = np.log(distance_m)
    common = COMMON_VARIANCE_SHARE * np.exp(-np.abs(far[:, None] - far[None, :]) / COMMON_SPAN)
    alike = (1.0 - COMMON_VARIANCE_SHARE) * np.exp(-apart_m / CORRELATION_M) + common
    return np.asarray(alike * np.outer(sigma_deg, sigma_deg))


def fit_dem_error_model(
    residual_deg: Vector, image_deg: Vector, dem_deg: Vector, dem_covariance_deg2: Vector
) -> DemErrorModel:
    """Fit the DEM's error factor to the residuals at n points, given image and DEM sigmas and the stated DEM covariance
    (n, n).

    The factor is the maximum-likelihood one; outliers get a larger image sigma.
    """
    sigma_deg = np.hypot(image_deg, dem_deg)
    spread = max(1.4826 * float(np.median(np.abs(residual_deg / sigma_deg))), MIN_SPREAD)
    distrust = np.maximum(np.abs(residual_deg) / (OUTLIER_SIGMAS * spread * sigma_deg), 1.0) ** 2
    of_image = np.diag((image_deg * distrust) ** 2)
    roots = [np.linalg.cholesky(dem_covariance_deg2 * factor**2 + of_image) for factor in FACTORS]
    best = int(np.argmax([_log_likelihood(root, residual_deg) for root in roots]))
    whiten = solve_triangular(roots[best], np.eye(len(residual_deg)), lower=True)
    return DemErrorModel(np.asarray(whiten), float(FACTORS[best]))


def _log_likelihood(root: Vector, residual_deg: Vector) -> float:
    white = solve_triangular(root, residual_deg, lower=True)
    return float(-np.log(np.diag(root)).sum() - 0.5 * white @ white)
