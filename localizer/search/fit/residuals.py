"""Residuals: observed minus predicted elevation of the skyline in each column, and their derivatives by the unknowns.

With the horizon's elevation e, its distance d and slope s = de/da over the azimuth a, and the residual r = observed - e:

    dr/d(east)     = -(s cos a / d + n sin a)         the horizon's point stays where it is
    dr/d(north)    = -(-s sin a / d + n cos a)        with n = cos^2 e (tan e + 2 D d) / d, D the drop by curvature
    dr/d(altitude) = cos^2 e / d
    dr/d(azimuth)  = s

The predicted horizon excludes terrain nearer than ``Terrain.near_m``, which the DEM does not resolve.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from localizer.dem.geodesy import geodesic_end
from localizer.dem.horizon import EXACT_ERROR_M, horizon_around
from localizer.search.fit.problem import (
    ALTITUDE,
    AZIMUTH_BIAS,
    EAST,
    FIRST_FRAME,
    NORTH,
    PER_FRAME,
    TILT_BIAS,
    Problem,
)

Floats = NDArray[np.float64]

SLOPE_STEP_RAD = np.radians(0.06)
"""Step of the difference quotient for the skyline's slope."""
DIFFERENCE_STEP_M = 0.5
"""Step of the central differences by place and altitude."""
INTERPOLATION_ERROR_SHARE = 0.1
"""Interpolation error between the cells, as a share of the second difference from cell to cell. Tuned on the scenario
``dem_error``. Sensitivity: halved, 1 of 5 statuses changes, places move by 0.5 sigma, sigmas change by the factor 0.7;
doubled, places move by 0.4 sigma, sigmas change by the factor 0.8 (docs/sensitivity.md)."""
SUMMIT_SMOOTHING_SHARE = 0.5
"""A DEM is too low at summits: standard deviation, as a share of the height of a cell above its four neighbours. Tuned on the
scenario ``twins``. Sensitivity: halved, places move by 0.4 sigma, sigmas change by the factor 0.8; doubled, places move by
0.2 sigma, sigmas change by the factor 0.9 (docs/sensitivity.md)."""
LARGEST_SLOPE = 5.0
"""Larger slopes of the skyline count as this in the variances. Tuned on ``sim evaluate --estimator-only``. Sensitivity:
halved, places move by 0.2 sigma; doubled, places move by 0.1 sigma, sigmas change by the factor 1.1 (docs/sensitivity.md)."""
LATERAL_ERROR_SHARE = 0.5
"""Horizontal error of a DEM as a share of its vertical error. Tuned on the simulated cases of ``sim evaluate``. Sensitivity:
halved, places move by 0.2 sigma; doubled, 1 of 5 statuses changes, places move by 0.5 sigma, sigmas change by the factor 0.7
(docs/sensitivity.md)."""


@dataclass
class Evaluation:
    """The prediction at one set of unknowns, compared with the observation in each column (n,), and the ground there."""

    residual: Floats
    jacobian: Floats
    distance: Floats
    """Distance of the horizon beyond ``Terrain.near_m``, metres. The residual refers to this horizon."""
    near: NDArray[np.bool_]
    """Whether the DEM has terrain nearer than ``Terrain.near_m`` that is higher."""
    near_excess: Floats
    """By how much the near terrain is higher, radians; 0 elsewhere."""
    dem_edge: NDArray[np.bool_]
    """Whether the predicted horizon lies at the DEM edge, where the true one is unknown."""
    guess_m: Floats
    """Distance of the horizon including near terrain: the initial guess for the next evaluation."""
    slope: Floats
    """Slope of the skyline, elevation by azimuth."""
    error_per_m: Floats
    """Radians per metre of the correlated error, in each column."""
    error_distance_m: Floats
    """Distance at which the correlated error is seen, metres; it is correlated along the ground there."""
    ground_m: float
    ground_gradient: Floats
    ground_sigma_m: float
    """Standard deviation of the ground under the camera by interpolation alone."""


def evaluate(
    problem: Problem,
    x: Floats,
    origin: tuple[float, float],
    coefficients: Floats,
    guess_m: Floats | None = None,
) -> Evaluation:
    """Residuals (n,) in radians and their derivatives (n, parameters) by metres and degrees.

    ``guess_m``: distances (n,) of the horizon at a place nearby, to save time.
    """
    terrain = problem.terrain
    row, col = place_of(x, origin, coefficients)
    ground, gradient = ground_at(problem, x, origin, coefficients)
    eye = max(x[ALTITUDE], ground + 0.3) if np.isfinite(ground) else x[ALTITUDE]
    azimuth, elevation, attitude = problem.directions(x)
    frame_of = problem.frame_of
    n = len(azimuth)
    beyond_m = terrain.near_m
    tangent, distance = horizon_around(terrain, row, col, eye, azimuth, guess_m)
    guess_m = distance.copy()
    near = distance < beyond_m
    highest = np.arctan(tangent[near])
    tangent[near], distance[near] = horizon_around(terrain, row, col, eye, azimuth[near], beyond_m=beyond_m)
    tangent_beside, _ = horizon_around(terrain, row, col, eye, azimuth + SLOPE_STEP_RAD, distance, beyond_m)
    seen, beside = np.arctan(tangent), np.arctan(tangent_beside)
    near_excess = np.zeros(n)
    near_excess[near] = highest - seen[near]
    d = np.where(np.isfinite(distance), distance, 1.0)
    slope = (beside - seen) / SLOPE_STEP_RAD
    residual = elevation - seen
    cos2 = np.cos(seen) ** 2
    nearing = cos2 * (np.tan(seen) + 2.0 * terrain.drop_per_m2 * d) / d
    jacobian = np.zeros((n, problem.size))
    # The point of the terrain on the horizon stays fixed: see the equations above.
    jacobian[:, EAST] = -(slope * np.cos(azimuth) / d + nearing * np.sin(azimuth))
    jacobian[:, NORTH] = -(-slope * np.sin(azimuth) / d + nearing * np.cos(azimuth))
    jacobian[:, ALTITUDE] = cos2 / d
    by_tilt = attitude[:, 1] - slope * attitude[:, 0]
    by_roll = attitude[:, 3] - slope * attitude[:, 2]
    per_degree = np.radians(1.0)
    jacobian[:, AZIMUTH_BIAS] = slope * per_degree
    jacobian[:, TILT_BIAS] = by_tilt
    index = np.arange(n)
    jacobian[index, FIRST_FRAME + PER_FRAME * frame_of] = slope * per_degree
    jacobian[index, FIRST_FRAME + PER_FRAME * frame_of + 1] = by_tilt
    jacobian[index, FIRST_FRAME + PER_FRAME * frame_of + 2] = by_roll
    row_h, col_h = geodesic_end(coefficients, row, col, d * np.sin(azimuth), d * np.cos(azimuth))
    dem_edge = np.zeros(n, bool) if problem.uses_edge_columns else terrain.is_dem_edge(row_h, col_h)
    slope2 = np.minimum(slope**2, LARGEST_SLOPE**2)
    if terrain.exact:
        error_distance_m, ground_sigma_m = np.full(n, problem.contour_distance_m), EXACT_ERROR_M
        error_per_m = np.sqrt(1.0 + slope2) / problem.contour_distance_m
    else:
        error_distance_m = d
        roughness2 = terrain.roughness_at(row_h, col_h) ** 2
        error_per_m = np.sqrt(1.0 + LATERAL_ERROR_SHARE**2 * slope2) * np.sqrt(1.0 + roughness2) / d
        bend_m = terrain.mean_second_difference_m * float(
            terrain.roughness_at(np.array([row]), np.array([col]))[0]
        )
        ground_sigma_m = float(
            np.linalg.norm(
                [
                    INTERPOLATION_ERROR_SHARE * bend_m,
                    0.1,
                    SUMMIT_SMOOTHING_SHARE * terrain.above_neighbours_m(row, col),
                ]
            )
        )
    return Evaluation(
        residual=residual,
        jacobian=jacobian,
        distance=d,
        near=near,
        near_excess=near_excess,
        dem_edge=dem_edge,
        guess_m=guess_m,
        slope=slope,
        error_per_m=error_per_m,
        error_distance_m=error_distance_m,
        ground_m=ground,
        ground_gradient=gradient,
        ground_sigma_m=ground_sigma_m,
    )


def central_differences(
    problem: Problem, x: Floats, origin: tuple[float, float], coefficients: Floats, guess_m: Floats
) -> Floats:
    """Derivatives (n, 3) of the residuals by east, north and altitude, as central differences."""
    columns = []
    for parameter in (EAST, NORTH, ALTITUDE):
        step = np.zeros(problem.size)
        step[parameter] = DIFFERENCE_STEP_M
        ahead = evaluate(problem, x + step, origin, coefficients, guess_m).residual
        behind = evaluate(problem, x - step, origin, coefficients, guess_m).residual
        columns.append((ahead - behind) / (2.0 * DIFFERENCE_STEP_M))
    return np.column_stack(columns)


def residual_sigma(problem: Problem, evaluation: Evaluation, s: float) -> Floats:
    """Standard deviations (n,) of the residuals: contour noise across the skyline, and a correlated error of ``s`` metres."""
    slope2 = np.minimum(evaluation.slope**2, LARGEST_SLOPE**2)
    return np.asarray(np.sqrt(problem.sigma_rad**2 * (1.0 + slope2) + (s * evaluation.error_per_m) ** 2))


def place_of(x: Floats, origin: tuple[float, float], coefficients: Floats) -> tuple[float, float]:
    """Row and column of the place in ``x``, whose metres count from ``origin``."""
    row, col = geodesic_end(coefficients, *origin, x[EAST], x[NORTH])
    return float(row), float(col)


def ground_at(
    problem: Problem, x: Floats, origin: tuple[float, float], coefficients: Floats
) -> tuple[float, Floats]:
    """Height of the ground and its gradient (east, north) over half a cell; NaN beyond the DEM."""
    half = 0.25 * problem.terrain.cell_m
    steps = np.array([[0.0, 0.0], [half, 0.0], [-half, 0.0], [0.0, half], [0.0, -half]])
    places = []
    for east, north in steps:
        moved = np.array([x[EAST] + east, x[NORTH] + north])
        places.append(place_of(moved, origin, coefficients))
    z = problem.terrain.dem.ground_m(np.array([p[0] for p in places]), np.array([p[1] for p in places]))
    gradient = np.array([z[1] - z[2], z[3] - z[4]]) / (2.0 * half)
    return float(z[0]), np.where(np.isfinite(gradient), gradient, 0.0)
