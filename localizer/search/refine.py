"""Sub-cell refinement: position together with everything that all columns share (errata, gap 8).

Unknown are the place (east, north), the altitude of the eye, the biases of azimuth and tilt that all frames share, and each
frame's own errors of azimuth, tilt and roll. The sensors give each of them but the place a prior. The observations are the
contour's elevations; a robust least-squares fit (Gauss-Newton, damped, Geman-McClure weights) finds the most probable values
and their covariance.

A column's uncertainty is its own sigma in the image and the DEM's error seen from afar: s metres at a distance of d metres are
s / d radians. The error s is estimated from the residuals. Neighbouring columns see the same stretch of ridge, hence the same
error: the correlation along the contour says how many columns are worth one independent one.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from localizer.horizon.from_terrain import Terrain, horizon_around
from localizer.observation import Observation
from localizer.search.contours import FrameContour
from localizer.search.stage2 import SATURATION

Floats = NDArray[np.float64]

EAST, NORTH, ALTITUDE, AZIMUTH_BIAS, TILT_BIAS, FIRST_FRAME = range(6)
PER_FRAME = 3  # azimuth, tilt, roll
SLOPE_STEP_RAD = np.radians(0.06)
SETTLE_AT = (2, 4, 6, 9, 13)
"""Iterations at which the error model is estimated anew."""
SMALLEST_DEM_ERROR_M = 0.3
CHANCE_RAD = np.radians(3.0)
"""By how much skylines of unrelated places differ."""
STRAY_SHARE = 0.1
"""Columns that show something else than the terrain's skyline, to be expected anywhere."""
LEAST_CORRELATION = 0.05
"""Where the correlation has fallen to this it is lost in its own noise."""
LATERAL_SHARE = 0.5
"""A DEM errs sideways too; as a share of its vertical error."""
GROUND_SHARE = 1.5
"""The ground under the camera is known less well than a ridge, which the profile of a whole mountain carries."""


@dataclass(frozen=True)
class Refined:
    """A refined candidate.

    ``row``, ``col`` in lattice coordinates; ``covariance_enu_m2`` (2, 2) of true east and north; ``cost`` the negative
    logarithm of the posterior but for a constant, ``log_volume`` half the logarithm of the determinant of the whole covariance;
    ``evidence`` by how much (in logarithms) the terrain explains the contours better than chance does;
    ``misfit_per_column`` the mean of the columns' negative log-likelihood, which compares fits with different DEM errors;
    ``residual_px`` per frame label, over the columns that fit.
    """

    row: float
    col: float
    altitude_m: float
    azimuth_bias_deg: float
    tilt_bias_deg: float
    frame_errors_deg: Floats
    covariance_enu_m2: Floats
    cost: float
    log_volume: float
    dem_error_m: float
    correlation_columns: float
    inlier_share: float
    prior_chi2: float
    residual_px: dict[str, float]
    misfit_per_column: float
    evidence: float


class Problem:
    """The observations and priors of one standpoint, thinned to every ``stride``-th column."""

    def __init__(
        self, terrain: Terrain, observation: Observation, contours: tuple[FrameContour, ...], stride: int = 1
    ) -> None:
        self.terrain = terrain
        self.observation = observation
        self.contours = [
            FrameContour(c.frame, np.ascontiguousarray(c.rays[::stride]), c.sigma_rad[::stride])
            for c in contours
        ]
        self.frame_of = np.repeat(np.arange(len(contours)), [len(c.rays) for c in self.contours])
        self.sigma_rad = np.concatenate([c.sigma_rad for c in self.contours])
        self.size = FIRST_FRAME + PER_FRAME * len(contours)
        prior = np.full(self.size, np.inf)
        prior[AZIMUTH_BIAS] = observation.azimuth_bias_sigma_deg
        prior[TILT_BIAS] = observation.tilt_bias_sigma_deg
        for i, c in enumerate(contours):
            f = c.frame
            prior[FIRST_FRAME + PER_FRAME * i :][:PER_FRAME] = (
                f.azimuth_sigma_deg,
                f.tilt_sigma_deg,
                f.roll_sigma_deg,
            )
        # A sigma of zero is a promise nobody keeps; a millidegree keeps the equations solvable.
        self.prior_sigma_deg = np.maximum(prior, 1e-3)

    def directions(self, x: Floats) -> tuple[Floats, Floats, Floats]:
        """Azimuth and elevation (n,) in radians under the biases in ``x``, and their derivatives by tilt and roll (n, 4)."""
        azimuths, elevations, derivatives = [], [], []
        step = 0.01
        for i, contour in enumerate(self.contours):
            f = contour.frame
            own = x[FIRST_FRAME + PER_FRAME * i :][:PER_FRAME]
            attitude = (
                np.array([f.azimuth_deg - x[AZIMUTH_BIAS], f.tilt_deg - x[TILT_BIAS], f.roll_deg]) - own
            )
            azimuth, elevation = contour.directions(*attitude)
            tilted = contour.directions(attitude[0], attitude[1] - step, attitude[2])
            rolled = contour.directions(attitude[0], attitude[1], attitude[2] - step)
            azimuths.append(azimuth)
            elevations.append(elevation)
            derivatives.append(
                np.column_stack(
                    [
                        _wrapped(tilted[0] - azimuth),
                        tilted[1] - elevation,
                        _wrapped(rolled[0] - azimuth),
                        rolled[1] - elevation,
                    ]
                )
                / step
            )
        return (np.concatenate(azimuths), np.concatenate(elevations), np.concatenate(derivatives))


@dataclass(frozen=True)
class ErrorModel:
    """The DEM's error in metres, and how many neighbouring columns are worth one independent one."""

    dem_error_m: float
    correlation_columns: float


@dataclass
class _Evaluation:
    residual: Floats
    jacobian: Floats
    distance: Floats
    slope: Floats
    ground_m: float
    ground_gradient: Floats


def refine(
    problem: Problem,
    row: float,
    col: float,
    altitude_m: float,
    azimuth_bias_deg: float,
    *,
    iterations: int,
    dem_error_m: float,
    largest_dem_error_m: float,
    settle: bool,
    correlation_columns: float = 1.0,
) -> Refined:
    """Fit from a cell to the sub-cell optimum near it.

    ``dem_error_m`` is the DEM's error to begin with, ``correlation_columns`` how many columns are worth one. With ``settle``
    both are estimated from the residuals as the fit proceeds, the former up to ``largest_dem_error_m``; else they are held.
    """
    x = np.zeros(problem.size)
    x[ALTITUDE], x[AZIMUTH_BIAS] = altitude_m, azimuth_bias_deg
    origin = (row, col)
    frame = problem.terrain.frames.at(np.array([row]), np.array([col]))[0]
    model = ErrorModel(dem_error_m, correlation_columns)
    damping = 1e-3
    here = _evaluate(problem, x, origin, frame)
    for iteration in range(iterations):
        if settle and iteration in SETTLE_AT:
            model = _error_model(problem, here, largest_dem_error_m)
        sigma = _sigma(problem, here, model.dem_error_m)
        cost = _cost(problem, x, here, sigma, model)
        hessian, gradient = _normal_equations(problem, x, here, sigma, model)
        for _ in range(5):
            step = -np.linalg.solve(hessian + damping * np.diag(np.diag(hessian)), gradient)
            far = float(np.hypot(step[EAST], step[NORTH])) / (1.5 * problem.terrain.cell_m)
            trial = x + step / max(1.0, far)
            there = _evaluate(problem, trial, origin, frame)
            gain = cost - _cost(problem, trial, there, sigma, model)
            if gain > 0.0:
                break
            damping = max(damping, 1e-3) * 8.0
        else:
            break
        x, here = trial, there
        damping = max(damping * 0.2, 1e-6)
        if gain < 1e-3 and iteration > SETTLE_AT[-1]:
            break
    if settle:
        model = _error_model(problem, here, largest_dem_error_m)
    return _result(problem, x, here, model, origin, frame)


def _evaluate(problem: Problem, x: Floats, origin: tuple[float, float], frame: Floats) -> _Evaluation:
    """Residuals (n,) in radians and their derivatives (n, parameters) by metres and degrees."""
    terrain = problem.terrain
    row, col = _lattice(x, origin, frame)
    ground, gradient = _ground(problem, x, origin, frame)
    eye = max(x[ALTITUDE], ground + 0.3) if np.isfinite(ground) else x[ALTITUDE]
    azimuth, elevation, attitude = problem.directions(x)
    frame_of = problem.frame_of
    rays = np.concatenate([azimuth, azimuth + SLOPE_STEP_RAD])
    tangent, distance = horizon_around(terrain, row, col, eye, rays)
    n = len(azimuth)
    seen, beside = np.arctan(tangent).reshape(2, n)
    d = np.where(np.isfinite(distance[:n]), distance[:n], 1.0)
    slope = (beside - seen) / SLOPE_STEP_RAD
    residual = elevation - seen
    cos2 = np.cos(seen) ** 2
    nearing = cos2 * (np.tan(seen) + 2.0 * terrain.drop_per_m2 * d) / d
    jacobian = np.zeros((n, problem.size))
    # The horizon's point stays where it is: moving right shifts it left by 1 / d, moving towards it raises it.
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
    return _Evaluation(residual, jacobian, d, slope, ground, gradient)


def _lattice(x: Floats, origin: tuple[float, float], frame: Floats) -> tuple[float, float]:
    e, n = x[EAST], x[NORTH]
    terms = np.array([e, n, e * e, e * n, n * n])
    return origin[0] + float(frame[0] @ terms), origin[1] + float(frame[1] @ terms)


def _ground(problem: Problem, x: Floats, origin: tuple[float, float], frame: Floats) -> tuple[float, Floats]:
    """Height of the ground and its gradient (east, north) over half a cell; NaN beyond the DEM."""
    half = 0.25 * problem.terrain.cell_m
    steps = np.array([[0.0, 0.0], [half, 0.0], [-half, 0.0], [0.0, half], [0.0, -half]])
    places = []
    for east, north in steps:
        moved = np.array([x[EAST] + east, x[NORTH] + north])
        places.append(_lattice(moved, origin, frame))
    z = problem.terrain.dem.ground_m(np.array([p[0] for p in places]), np.array([p[1] for p in places]))
    gradient = np.array([z[1] - z[2], z[3] - z[4]]) / (2.0 * half)
    return float(z[0]), np.where(np.isfinite(gradient), gradient, 0.0)


def _sigma(problem: Problem, here: _Evaluation, s: float) -> Floats:
    """Standard deviations (n,) of the residuals: of the contour across itself, and of the DEM seen from afar."""
    slope2 = np.minimum(here.slope**2, 25.0)
    return np.asarray(
        np.sqrt(
            problem.sigma_rad**2 * (1.0 + slope2)
            + (s / here.distance) ** 2 * (1.0 + LATERAL_SHARE**2 * slope2)
        )
    )


def _weights(normalised: Floats) -> Floats:
    return np.asarray(1.0 / (1.0 + (normalised / SATURATION) ** 2) ** 2)


def _priors(problem: Problem, x: Floats, here: _Evaluation, s: float) -> tuple[Floats, Floats]:
    """Normalised misfits of the priors (k,) and their derivatives (k, parameters)."""
    known = np.isfinite(problem.prior_sigma_deg)
    misfit = [x[known] / problem.prior_sigma_deg[known]]
    rows = [np.diag(1.0 / problem.prior_sigma_deg)[known]]
    o = problem.observation
    if np.isfinite(here.ground_m):
        sigma = np.hypot(GROUND_SHARE * s, 0.3)
        misfit.append(np.array([(x[ALTITUDE] - o.mast_height_m - here.ground_m) / sigma]))
        row = np.zeros((1, problem.size))
        row[0, ALTITUDE], row[0, EAST], row[0, NORTH] = 1.0, *(-here.ground_gradient)
        rows.append(row / sigma)
    if o.altitude_m is not None:
        misfit.append(np.array([(x[ALTITUDE] - o.altitude_m) / o.altitude_sigma_m]))
        row = np.zeros((1, problem.size))
        row[0, ALTITUDE] = 1.0
        rows.append(row / o.altitude_sigma_m)
    return np.concatenate(misfit), np.vstack(rows)


def _robust(normalised: Floats) -> Floats:
    squared = normalised**2
    return np.asarray(0.5 * squared / (1.0 + squared / SATURATION**2))


def _cost(problem: Problem, x: Floats, here: _Evaluation, sigma: Floats, model: ErrorModel) -> float:
    misfit, _ = _priors(problem, x, here, model.dem_error_m)
    return float(_robust(here.residual / sigma).sum() / model.correlation_columns + 0.5 * (misfit**2).sum())


def _normal_equations(
    problem: Problem, x: Floats, here: _Evaluation, sigma: Floats, model: ErrorModel
) -> tuple[Floats, Floats]:
    weight = _weights(here.residual / sigma) / sigma**2 / model.correlation_columns
    misfit, rows = _priors(problem, x, here, model.dem_error_m)
    hessian = (here.jacobian * weight[:, None]).T @ here.jacobian + rows.T @ rows
    gradient = here.jacobian.T @ (weight * here.residual) + rows.T @ misfit
    return hessian + 1e-12 * np.eye(problem.size), gradient


def _evidence(normalised: Floats, sigma: Floats) -> float:
    """Sum over the columns of the logarithm of how much likelier they are from this place than by chance.

    A column may be a stray one, no matter where the camera stands; then it speaks neither for the place nor against it.
    """
    likelier = np.exp(-0.5 * normalised**2) * CHANCE_RAD / sigma
    return float(np.log((1.0 - STRAY_SHARE) * likelier + STRAY_SHARE).sum())


def _error_model(problem: Problem, here: _Evaluation, largest_dem_error_m: float) -> ErrorModel:
    s = _dem_error(problem, here, largest_dem_error_m)
    return ErrorModel(s, _correlation(problem, here.residual / _sigma(problem, here, s)))


def _dem_error(problem: Problem, here: _Evaluation, largest: float) -> float:
    """The DEM's error for which the median residual is what a Gaussian's is (0.6745 sigma)."""
    size = np.abs(here.residual)
    low, high = SMALLEST_DEM_ERROR_M, largest
    if np.median(size / _sigma(problem, here, low)) <= 0.6745:
        return low
    for _ in range(30):
        middle = np.sqrt(low * high)
        if np.median(size / _sigma(problem, here, middle)) > 0.6745:
            low = middle
        else:
            high = middle
    return float(high)


def _correlation(problem: Problem, normalised: Floats) -> float:
    """How many columns are worth one: one plus twice the sum of the correlations along the contours, 1 for white noise."""
    value = normalised * np.sqrt(_weights(normalised))
    frames = [value[problem.frame_of == i] for i in range(len(problem.contours))]
    power = float((value**2).mean())
    total = 1.0
    for lag in range(1, max(len(v) for v in frames) // 3):
        products = np.concatenate([v[lag:] * v[:-lag] for v in frames if len(v) > lag])
        rho = float(products.mean()) / power
        if rho < LEAST_CORRELATION:
            break
        total += 2.0 * rho
    return total


def _result(
    problem: Problem,
    x: Floats,
    here: _Evaluation,
    model: ErrorModel,
    origin: tuple[float, float],
    frame: Floats,
) -> Refined:
    sigma = _sigma(problem, here, model.dem_error_m)
    normalised = here.residual / sigma
    hessian, _ = _normal_equations(problem, x, here, sigma, model)
    covariance = np.asarray(np.linalg.inv(hessian), np.float64)
    misfit, _ = _priors(problem, x, here, model.dem_error_m)
    surprise = _robust(normalised) + np.log(sigma)
    row, col = _lattice(x, origin, frame)
    inside = np.abs(normalised) < 3.0
    residual_px = {}
    for i, contour in enumerate(problem.contours):
        mine = problem.frame_of == i
        fy = contour.frame.camera.fy_px
        kept = mine & inside
        chosen = kept if kept.any() else mine
        residual_px[contour.frame.label] = float(np.sqrt(np.mean((here.residual[chosen] * fy) ** 2)))
    return Refined(
        row=row,
        col=col,
        altitude_m=float(x[ALTITUDE]),
        azimuth_bias_deg=float(x[AZIMUTH_BIAS]),
        tilt_bias_deg=float(x[TILT_BIAS]),
        frame_errors_deg=x[FIRST_FRAME:].reshape(-1, PER_FRAME),
        covariance_enu_m2=covariance[:2, :2],
        cost=float(surprise.sum() / model.correlation_columns + 0.5 * (misfit**2).sum()),
        log_volume=0.5 * float(np.linalg.slogdet(covariance)[1]),
        dem_error_m=model.dem_error_m,
        correlation_columns=model.correlation_columns,
        inlier_share=float(inside.mean()),
        prior_chi2=float((misfit**2).sum()),
        residual_px=residual_px,
        misfit_per_column=float(surprise.mean()),
        evidence=_evidence(normalised, sigma) / model.correlation_columns,
    )


def _wrapped(radians: Floats) -> Floats:
    return (radians + np.pi) % (2.0 * np.pi) - np.pi
