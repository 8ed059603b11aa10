"""How the DEM errs along a skyline: by so many metres, which near ridges show as large angles, and alike from point to point.

An error of a ridge lifts all points of it together, in every picture that shows it; a second picture of the same ridge says
nothing new about it, but much about how the camera sits. Both follow from the covariance of what is left after a fit.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

Vector = NDArray[np.float64]

ALIKE_M = 60.0
"""Over which heights of a DEM err alike: two cells of the usual DEM."""
COMMON_SHARE, COMMON_SPAN = 0.25, 0.7
"""Of the variance, what ridges of like distance have in common; and how much farther (natural logarithm) is no longer like."""
FACTORS = 1.5 ** np.arange(-2, 8)
"""By which the DEM may be better or worse than told. No better than half: a lucky fit is no survey."""
OUTLIER_SIGMAS = 1.5
LEAST_SPREAD = 0.3
"""A point that is off by more than so many times what the others are is distrusted, with the square of how much more.

In haze a far ridge is now and then traced along a nearer one below it: always to the same side, and at up to a third of it.
"""


@dataclass(frozen=True)
class RidgeErrors:
    """``whiten`` (n, n) makes independent misfits of unit variance of what is left at n points.

    ``dem_factor`` is how much worse the DEM is than told, as what is left has it.
    """

    whiten: Vector
    dem_factor: float


def covariance_deg2(sigma_deg: Vector, azimuth_deg: Vector, distance_m: Vector) -> Vector:
    """Of the DEM's error at points (n,) of the skyline, given its sigma there: alike where the ridge is the same.

    A part is alike at all ridges of like distance: a DEM smooths brows, and near ones otherwise than far ones.
    """
    azimuth = np.radians(azimuth_deg)
    where_m = np.column_stack([distance_m * np.sin(azimuth), distance_m * np.cos(azimuth)])
    apart_m = np.linalg.norm(where_m[:, None, :] - where_m[None, :, :], axis=-1)
    far = np.log(distance_m)
    common = COMMON_SHARE * np.exp(-np.abs(far[:, None] - far[None, :]) / COMMON_SPAN)
    alike = (1.0 - COMMON_SHARE) * np.exp(-apart_m / ALIKE_M) + common
    return np.asarray(alike * np.outer(sigma_deg, sigma_deg))


def ridge_errors(left_deg: Vector, image_deg: Vector, dem_deg: Vector, alike_deg2: Vector) -> RidgeErrors:
    """What is left at n points, the sigmas of image and DEM there, and the DEM's covariance (n, n) as told.

    The DEM's factor is the likeliest one; points far off have their image distrusted.
    """
    sigma_deg = np.hypot(image_deg, dem_deg)
    spread = max(1.4826 * float(np.median(np.abs(left_deg / sigma_deg))), LEAST_SPREAD)
    distrust = np.maximum(np.abs(left_deg) / (OUTLIER_SIGMAS * spread * sigma_deg), 1.0) ** 2
    of_image = np.diag((image_deg * distrust) ** 2)
    roots = [np.linalg.cholesky(alike_deg2 * factor**2 + of_image) for factor in FACTORS]
    best = int(np.argmax([_log_likelihood(root, left_deg) for root in roots]))
    whiten = solve_triangular(roots[best], np.eye(len(left_deg)), lower=True)
    return RidgeErrors(np.asarray(whiten), float(FACTORS[best]))


def _log_likelihood(root: Vector, left_deg: Vector) -> float:
    white = solve_triangular(root, left_deg, lower=True)
    return float(-np.log(np.diag(root)).sum() - 0.5 * white @ white)
