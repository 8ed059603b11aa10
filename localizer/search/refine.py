"""Sub-cell refinement: position together with everything that all columns share (errata, gap 8).

Unknown are the place (east, north), the altitude of the eye, the biases of azimuth and tilt that all frames share, and each
frame's own errors of azimuth, tilt and roll. The sensors give each of them but the place a prior. The observations are the
contour's elevations; a robust least-squares fit (Gauss-Newton, damped, Geman-McClure weights) finds the most probable values
and their covariance.

A column's uncertainty is its own sigma in the image and the DEM's error seen from afar, which neighbouring columns share
(`error_model`). How large that error is, is estimated from the residuals: robustly at first, from their median, to tell stray
columns from others; then by its likelihood, together with how far it reaches along the ground.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from localizer.horizon.from_terrain import Terrain, horizon_around
from localizer.observation import Observation
from localizer.search.contours import FrameContour
from localizer.search.error_model import (
    SMALLEST_SMOOTH_M,
    Columns,
    ErrorModel,
    Normal,
    Range,
    likely_models,
    log_scale,
    normal_equations,
    whitened_cost,
)
from localizer.search.stage2 import SATURATION

Floats = NDArray[np.float64]

EAST, NORTH, ALTITUDE, AZIMUTH_BIAS, TILT_BIAS, FIRST_FRAME = range(6)
PER_FRAME = 3  # azimuth, tilt, roll
SLOPE_STEP_RAD = np.radians(0.06)
SETTLE_AT = (2, 4, 6, 8, 10)
"""Iterations at which the noise is estimated anew."""
LIKELY_FROM = 8
"""From this iteration on by its likelihood. Before, an error that reaches far would explain a place that is some way off."""
SMALLEST_DEM_ERROR_M = 0.1
LEAST_DAMPING, MOST_DAMPING = 1e-6, 50.0
ENOUGH_GAIN = 2e-2
"""A step that lowers the cost by less ends the fit."""
SECANT_STEP_M = 0.5
CHANCE_RAD = np.radians(3.0)
"""By how much skylines of unrelated places differ."""
BLOCK_RAD = np.radians(6.0)
"""By how much skylines of unrelated places differ, and over which stretch of the horizon by the same."""
STRAY_RAD = np.radians(15.0)
"""How much of the horizon a cloud or a tree hides."""
STRAY_SHARE = 0.1
"""Stretches that show something else than the terrain's skyline, to be expected anywhere."""
FIRST_LENGTH_CELLS = 8.0
"""How far a DEM's error is taken to reach along the ground until its likelihood tells: hardly, so that all columns count."""
NEAR_CELLS = 2.0
"""What rises above all else nearer than this no DEM can tell. It can only hide what is farther, never lower it."""
LEAST_CORRELATION = 0.05
"""Where the correlation has fallen to this it is lost in its own noise."""
LATERAL_SHARE = 0.5
"""A DEM errs sideways too; as a share of its vertical error."""
BETWEEN_CELLS = 0.1
"""How far the ground between a DEM's cells lies from its surface, as a share of what that bends from cell to cell."""
SHIFT_PER_M = 2.25
"""How far the place moves per metre of a DEM's smooth error, beyond what the fit tells."""
LATTICE_SHARE = 0.015
"""By so much of a cell the best place moves when the same cells are made into another surface."""
GROUND_SHARE = 1.5
"""The ground under the camera is known less well than a ridge, which the profile of a whole mountain carries."""


@dataclass(frozen=True)
class Refined:
    """A refined candidate.

    ``row``, ``col`` in lattice coordinates; ``covariance_enu_m2`` (2, 2) of true east and north; ``cost`` the negative
    logarithm of the posterior but for a constant, ``fit_cost`` the same under the error model that weighs the columns;
    ``log_volume`` half the logarithm of the determinant of the whole covariance;
    ``evidence`` by how much (in logarithms) the terrain explains the contours better than chance does;
    ``misfit_per_column`` the mean of the columns' negative log-likelihood, which compares fits with different DEM errors;
    ``residual_px`` per frame label, over the columns that fit.
    """

    row: float
    col: float
    altitude_m: float
    azimuth_bias_deg: float
    azimuth_bias_sigma_deg: float
    tilt_bias_deg: float
    frame_errors_deg: Floats
    covariance_enu_m2: Floats
    cost: float
    fit_cost: float
    log_volume: float
    dem_error_m: float
    correlation_columns: float
    inlier_share: float
    prior_chi2: float
    residual_px: dict[str, float]
    misfit_per_column: float
    evidence: float
    error_model: ErrorModel


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
        self.order, self.step_rad = self._along_the_horizon()
        self.blocks = self._blocks()
        self.block_columns = max(len(block) for block in self.blocks)
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

    def _along_the_horizon(self) -> tuple[NDArray[np.int64], Floats]:
        """All columns in the order of their azimuths, whichever frame they are in, and the steps between them (infinite first).

        Frames that overlap see the same ridge, so that their columns are neighbours.
        """
        azimuth = np.concatenate(
            [
                c.directions(c.frame.azimuth_deg, c.frame.tilt_deg, c.frame.roll_deg)[0] % (2.0 * np.pi)
                for c in self.contours
            ]
        )
        order = np.argsort(azimuth, kind="stable")
        step = np.diff(azimuth[order], prepend=azimuth[order[-1]] - 2.0 * np.pi)
        widest = int(step.argmax())
        order, step = np.roll(order, -widest), np.roll(step, -widest)
        step[0] = np.inf
        return order, step

    def _blocks(self) -> list[NDArray[np.int64]]:
        """The columns (indices) in each stretch of BLOCK_RAD that any frame sees."""
        place = np.cumsum(np.where(np.isfinite(self.step_rad), self.step_rad, 0.0)) // BLOCK_RAD
        return np.split(self.order, np.flatnonzero(np.diff(place)) + 1)

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
class Noise:
    """What the residuals are made of.

    ``spread_m`` is the DEM's error for which the median residual is what it should be, ``correlation_columns`` how many
    neighbouring columns are worth one independent one: they tell stray columns and chance. ``model`` weighs the columns.
    """

    spread_m: float
    correlation_columns: float
    model: ErrorModel


@dataclass
class _Evaluation:
    residual: Floats
    jacobian: Floats
    distance: Floats
    """Of the horizon beyond NEAR_CELLS, which is what the residual is of."""
    near: NDArray[np.bool_]
    """Whether the DEM has something nearer that is higher."""
    guess_m: Floats
    """Where the horizon is, near or far."""
    slope: Floats
    dem_error_share: Floats
    """What the DEM's error is to be multiplied by where the horizon lies."""
    ground_m: float
    ground_gradient: Floats
    ground_sigma_m: float
    """How uncertain the ground under the camera is even where the DEM's cells are right."""


def refine(
    problem: Problem,
    row: float,
    col: float,
    altitude_m: float,
    azimuth_bias_deg: float,
    *,
    iterations: int,
    noise: Noise,
    largest_dem_error_m: float,
    settle: bool,
    likely_from: int = LIKELY_FROM,
) -> Refined:
    """Fit from a cell to the sub-cell optimum near it.

    ``noise`` is what the residuals are taken for to begin with. With ``settle`` it is estimated from them as the fit proceeds,
    the DEM's error up to ``largest_dem_error_m``, from iteration ``likely_from`` on by its likelihood; else it is held.
    """
    x = np.zeros(problem.size)
    x[ALTITUDE], x[AZIMUTH_BIAS] = altitude_m, azimuth_bias_deg
    origin = (row, col)
    frame = problem.terrain.frames.at(np.array([row]), np.array([col]))[0]
    damping = LEAST_DAMPING
    here = _evaluate(problem, x, origin, frame)
    for iteration in range(iterations):
        if settle and iteration in SETTLE_AT:
            noise = _noise(problem, x, here, noise, largest_dem_error_m, iteration >= likely_from)
        sigma = _sigma(problem, here, noise.spread_m)
        weight = _weights(_telling(here, sigma), here.residual / sigma)
        forgiving = iteration >= likely_from or not settle
        gain = 0.0
        for by_secants in (False, True):
            if by_secants:
                # Where the horizon leaps from ridge to ridge the tangent misleads.
                here.jacobian[:, :AZIMUTH_BIAS] = _secants(problem, x, origin, frame, here.guess_m)
                damping = LEAST_DAMPING
            columns = _columns(problem, x, here, noise.model, weight)
            normal = normal_equations(columns, noise.model, forgiving=forgiving)
            cost = normal.cost + _prior_cost(problem, x, here, noise.model)
            while damping < MOST_DAMPING:
                damped = normal.curvature + damping * np.diag(np.diag(normal.curvature))
                step = -np.linalg.solve(damped, normal.slope)
                far = float(np.hypot(step[EAST], step[NORTH])) / (1.5 * problem.terrain.cell_m)
                trial = x + step / max(1.0, far)
                there = _evaluate(problem, trial, origin, frame, here.guess_m)
                columns = _columns(problem, trial, there, noise.model, weight)
                gain = (
                    cost
                    - whitened_cost(columns, noise.model, forgiving=forgiving)
                    - _prior_cost(problem, trial, there, noise.model)
                )
                if gain > 0.0:
                    break
                damping *= 8.0
            if gain > ENOUGH_GAIN or iterations <= LIKELY_FROM or iteration < SETTLE_AT[-1]:
                break
        if gain > 0.0:
            x, here = trial, there
        damping = max(damping * 0.1, LEAST_DAMPING) if damping < MOST_DAMPING else LEAST_DAMPING
        if gain < ENOUGH_GAIN and not (settle and iterations > LIKELY_FROM and iteration < SETTLE_AT[-1]):
            break
    finish = iterations > LIKELY_FROM
    if settle:
        noise = _noise(problem, x, here, noise, largest_dem_error_m, finish)
    return _result(problem, x, here, noise, origin, frame, largest_dem_error_m if settle and finish else None)


def places_around(
    problem: Problem,
    start: Refined,
    noises: Sequence[Noise],
    reach_cells: float,
    step_cells: float,
    keep: int,
) -> list[tuple[float, float, float, Noise]]:
    """Row, column, altitude and noise of the ``keep`` likeliest places under each noise on a lattice around a fit.

    Close to hills the horizon leaps from rise to rise as one moves, and each leap may stop a descent: so one looks about. At
    each place all but the place itself is fitted in one step. No two places under one noise are neighbours.
    """
    terrain = problem.terrain
    frame = terrain.frames.at(np.array([start.row]), np.array([start.col]))[0]
    x = np.concatenate(
        [
            [0.0, 0.0, start.altitude_m, start.azimuth_bias_deg, start.tilt_bias_deg],
            start.frame_errors_deg.ravel(),
        ]
    )
    origin = (start.row, start.col)
    ticks = np.arange(-reach_cells, reach_cells + 1e-9, step_cells) * terrain.cell_m
    here = _evaluate(problem, x, origin, frame)
    found: list[list[tuple[float, Floats]]] = [[] for _ in noises]
    for east in ticks:
        for north in ticks:
            moved = x.copy()
            moved[EAST], moved[NORTH] = east, north
            ground, _ = _ground(problem, moved, origin, frame)
            if not np.isfinite(ground):
                continue
            if np.isfinite(here.ground_m):
                moved[ALTITUDE] += ground - here.ground_m
            there = _evaluate(problem, moved, origin, frame, here.guess_m)
            for noise, costs in zip(noises, found, strict=True):
                costs.append(_fitted_there(problem, moved, there, noise))
    places = []
    for noise, costs in zip(noises, found, strict=True):
        kept: list[Floats] = []
        for _, place in sorted(costs, key=lambda entry: entry[0]):
            apart_m = [float(np.hypot(place[EAST] - k[EAST], place[NORTH] - k[NORTH])) for k in kept]
            if min(apart_m, default=np.inf) > 1.5 * step_cells * terrain.cell_m:
                kept.append(place)
            if len(kept) == keep:
                break
        places += [(*_place(k, origin, frame), float(k[ALTITUDE]), noise) for k in kept]
    return places


def _fitted_there(problem: Problem, x: Floats, here: _Evaluation, noise: Noise) -> tuple[float, Floats]:
    """Cost, and the parameters with all but the place itself fitted in one step."""
    sigma = _sigma(problem, here, noise.spread_m)
    normalised, telling = here.residual / sigma, _telling(here, sigma)
    columns = _columns(problem, x, here, noise.model, _weights(telling, normalised))
    normal = normal_equations(columns, noise.model)
    step = np.linalg.solve(normal.curvature[ALTITUDE:, ALTITUDE:], normal.slope[ALTITUDE:])
    cost = (
        normal.cost
        + _prior_cost(problem, x, here, noise.model)
        - 0.5 * float(normal.slope[ALTITUDE:] @ step)
        + _loss(problem, telling, normalised, sigma)
        + _log_scale(problem, x, here, noise.model)
    )
    fitted = x.copy()
    fitted[ALTITUDE:] -= step
    return cost, fitted


def usual_noise(terrain: Terrain, dem_error_m: float) -> Noise:
    """What the residuals are taken for before there are any."""
    return Noise(
        dem_error_m, 1.0, ErrorModel(dem_error_m, SMALLEST_SMOOTH_M, FIRST_LENGTH_CELLS * terrain.cell_m)
    )


def _evaluate(
    problem: Problem, x: Floats, origin: tuple[float, float], frame: Floats, guess_m: Floats | None = None
) -> _Evaluation:
    """Residuals (n,) in radians and their derivatives (n, parameters) by metres and degrees.

    ``guess_m``: distances (n,) of the horizon from a place nearby.
    """
    terrain = problem.terrain
    row, col = _place(x, origin, frame)
    ground, gradient = _ground(problem, x, origin, frame)
    eye = max(x[ALTITUDE], ground + 0.3) if np.isfinite(ground) else x[ALTITUDE]
    azimuth, elevation, attitude = problem.directions(x)
    frame_of = problem.frame_of
    n = len(azimuth)
    beyond_m = NEAR_CELLS * terrain.cell_m
    tangent, distance = horizon_around(terrain, row, col, eye, azimuth, guess_m)
    guess_m = distance.copy()
    near = distance < beyond_m
    tangent[near], distance[near] = horizon_around(terrain, row, col, eye, azimuth[near], beyond_m=beyond_m)
    tangent_beside, _ = horizon_around(terrain, row, col, eye, azimuth + SLOPE_STEP_RAD, distance, beyond_m)
    seen, beside = np.arctan(tangent), np.arctan(tangent_beside)
    d = np.where(np.isfinite(distance), distance, 1.0)
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
    row_h, col_h = _lattice(d * np.sin(azimuth), d * np.cos(azimuth), (row, col), frame)
    share = np.sqrt(1.0 + terrain.roughness_at(row_h, col_h) ** 2)
    bend_m = terrain.mean_bend_m * float(terrain.roughness_at(np.array([row]), np.array([col]))[0])
    own = float(np.hypot(BETWEEN_CELLS * bend_m, 0.1))
    return _Evaluation(residual, jacobian, d, near, guess_m, slope, share, ground, gradient, own)


def _secants(
    problem: Problem, x: Floats, origin: tuple[float, float], frame: Floats, guess_m: Floats
) -> Floats:
    """Derivatives (n, 3) of the residuals by place and altitude, over steps of SECANT_STEP_M to either side."""
    columns = []
    for parameter in (EAST, NORTH, ALTITUDE):
        step = np.zeros(problem.size)
        step[parameter] = SECANT_STEP_M
        ahead = _evaluate(problem, x + step, origin, frame, guess_m).residual
        behind = _evaluate(problem, x - step, origin, frame, guess_m).residual
        columns.append((ahead - behind) / (2.0 * SECANT_STEP_M))
    return np.column_stack(columns)


def _lattice(e: Floats, n: Floats, origin: tuple[float, float], frame: Floats) -> tuple[Floats, Floats]:
    """Row and column of what lies e metres east and n north of a place; frames a few cells away are the same."""
    terms = np.array([e, n, e * e, e * n, n * n])
    return origin[0] + frame[0] @ terms, origin[1] + frame[1] @ terms


def _place(x: Floats, origin: tuple[float, float], frame: Floats) -> tuple[float, float]:
    row, col = _lattice(x[EAST], x[NORTH], origin, frame)
    return float(row), float(col)


def _ground(problem: Problem, x: Floats, origin: tuple[float, float], frame: Floats) -> tuple[float, Floats]:
    """Height of the ground and its gradient (east, north) over half a cell; NaN beyond the DEM."""
    half = 0.25 * problem.terrain.cell_m
    steps = np.array([[0.0, 0.0], [half, 0.0], [-half, 0.0], [0.0, half], [0.0, -half]])
    places = []
    for east, north in steps:
        moved = np.array([x[EAST] + east, x[NORTH] + north])
        places.append(_place(moved, origin, frame))
    z = problem.terrain.dem.ground_m(np.array([p[0] for p in places]), np.array([p[1] for p in places]))
    gradient = np.array([z[1] - z[2], z[3] - z[4]]) / (2.0 * half)
    return float(z[0]), np.where(np.isfinite(gradient), gradient, 0.0)


def _sigma(problem: Problem, here: _Evaluation, s: float) -> Floats:
    """Standard deviations (n,) of the residuals: of the contour across itself, and of the DEM seen from afar."""
    slope2 = np.minimum(here.slope**2, 25.0)
    return np.asarray(
        np.sqrt(
            problem.sigma_rad**2 * (1.0 + slope2)
            + (s * here.dem_error_share / here.distance) ** 2 * (1.0 + LATERAL_SHARE**2 * slope2)
        )
    )


def _telling(here: _Evaluation, sigma: Floats) -> NDArray[np.bool_]:
    """Columns (n,) that show what the DEM knows: all but those where what stands near probably hides it."""
    hides = here.near & (here.residual > 0.0)
    return np.asarray(~hides | (_robust(here.residual / sigma) < np.log(CHANCE_RAD / sigma)))


def _loss(problem: Problem, telling: NDArray[np.bool_], normalised: Floats, sigma: Floats) -> float:
    """What stray and hidden columns cost beyond what their weights leave of them in the sum of squares.

    They come in stretches of about STRAY_RAD, each of which is one accident.
    """
    weighted = 0.5 * normalised**2 * _weights(telling, normalised)
    lost = np.where(telling, _robust(normalised) - weighted, np.log(CHANCE_RAD / sigma))
    return float(lost.sum() / (problem.block_columns * STRAY_RAD / BLOCK_RAD))


def _log_scale(problem: Problem, x: Floats, here: _Evaluation, model: ErrorModel) -> float:
    """Half the logarithm of the determinant of the covariance that the residuals are expected to have.

    A place whose horizon is near explains almost anything; that it had to be expected to be so far off counts against it.
    """
    return log_scale(_columns(problem, x, here, model, np.ones(len(here.residual))), model)


def _weights(telling: NDArray[np.bool_], normalised: Floats) -> Floats:
    """Between 1 for a column that fits and nothing for a stray one (Geman-McClure)."""
    return np.asarray(telling / (1.0 + (normalised / SATURATION) ** 2) ** 2)


def _priors(problem: Problem, x: Floats, here: _Evaluation, s: float) -> tuple[Floats, Floats]:
    """Normalised misfits of the priors (k,) and their derivatives (k, parameters)."""
    known = np.isfinite(problem.prior_sigma_deg)
    misfit = [x[known] / problem.prior_sigma_deg[known]]
    rows = [np.diag(1.0 / problem.prior_sigma_deg)[known]]
    o = problem.observation
    if np.isfinite(here.ground_m):
        sigma = np.hypot(GROUND_SHARE * s, here.ground_sigma_m)
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


def _prior_cost(problem: Problem, x: Floats, here: _Evaluation, model: ErrorModel) -> float:
    misfit, _ = _priors(problem, x, here, model.size_m)
    return 0.5 * float((misfit**2).sum())


def _columns(problem: Problem, x: Floats, here: _Evaluation, model: ErrorModel, weight: Floats) -> Columns:
    """The columns along the horizon and the priors, for the error model; stray columns (of small ``weight``) count as noisy."""
    order = problem.order
    slope2 = np.minimum(here.slope**2, 25.0)
    distance = here.distance[order]
    across = 0.5 * (distance + np.roll(distance, 1)) * problem.step_rad
    misfit, rows = _priors(problem, x, here, model.size_m)
    return Columns(
        residual=here.residual[order],
        jacobian=here.jacobian[order],
        white=(problem.sigma_rad**2 * (1.0 + slope2) / np.maximum(weight, 1e-6))[order],
        per_m=(np.sqrt(1.0 + LATERAL_SHARE**2 * slope2) * here.dem_error_share / here.distance)[order],
        step_m=np.hypot(across, distance - np.roll(distance, 1)),
        cell_m=problem.terrain.cell_m,
        prior=rows.T @ rows + 1e-12 * np.eye(problem.size),
        pull=rows.T @ misfit,
    )


def _evidence(problem: Problem, here: _Evaluation, telling: NDArray[np.bool_], sigma: Floats) -> float:
    """Logarithm of how much likelier the contours are from this place than from an unrelated one.

    From an unrelated place a skyline is off by CHANCE_RAD, and by about the same over a BLOCK_RAD of the horizon: each block is
    one witness. It may be a stray one, no matter where the camera stands; then it speaks neither for the place nor against it.
    """
    normalised = here.residual / sigma
    total = 0.0
    for block in problem.blocks:
        known = block[telling[block]]
        if len(known) == 0:
            continue
        size = float(np.median(np.abs(normalised[known])))
        likelier = CHANCE_RAD / np.exp(np.log(sigma[known]).mean()) * np.exp(-0.5 * (size / 0.6745) ** 2)
        total += (
            len(known) / problem.block_columns * float(np.log((1.0 - STRAY_SHARE) * likelier + STRAY_SHARE))
        )
    return total


def _noise(
    problem: Problem,
    x: Floats,
    here: _Evaluation,
    before: Noise,
    largest_dem_error_m: float,
    by_likelihood: bool,
) -> Noise:
    telling = _telling(here, _sigma(problem, here, before.spread_m))
    spread_m = _dem_error(problem, here, telling, largest_dem_error_m)
    normalised = here.residual / _sigma(problem, here, spread_m)
    within = _range(problem, largest_dem_error_m)
    if not by_likelihood:
        # All of it taken for rough, so that no stretch of the horizon is explained away.
        length_m = FIRST_LENGTH_CELLS * problem.terrain.cell_m
        model = ErrorModel(max(spread_m, within.least_rough_m), SMALLEST_SMOOTH_M, length_m)
    else:
        columns = _columns(problem, x, here, before.model, _weights(telling, normalised))
        start = ErrorModel(
            max(0.5 * before.model.rough_m, within.least_rough_m),
            max(before.model.smooth_m, 0.5 * spread_m, SMALLEST_SMOOTH_M),
            before.model.length_m,
        )
        model = likely_models(columns, start, within)[0][0]
    return Noise(spread_m, _correlation(problem, telling, normalised), model)


def _range(problem: Problem, largest_dem_error_m: float) -> Range:
    """No DEM is better than what the terrain does between its cells."""
    terrain = problem.terrain
    return Range(terrain.cell_m, 0.5 * BETWEEN_CELLS * terrain.mean_bend_m + 0.01, largest_dem_error_m)


def _dem_error(problem: Problem, here: _Evaluation, telling: NDArray[np.bool_], largest: float) -> float:
    """The DEM's error for which the median residual is what a Gaussian's is (0.6745 sigma)."""
    if not telling.any():
        return largest
    size = np.abs(here.residual[telling])
    low, high = SMALLEST_DEM_ERROR_M, largest
    if np.median(size / _sigma(problem, here, low)[telling]) <= 0.6745:
        return low
    for _ in range(30):
        middle = np.sqrt(low * high)
        if np.median(size / _sigma(problem, here, middle)[telling]) > 0.6745:
            low = middle
        else:
            high = middle
    return float(high)


def _correlation(problem: Problem, telling: NDArray[np.bool_], normalised: Floats) -> float:
    """How many columns are worth one: one plus twice the sum of the correlations along the contours, 1 for white noise."""
    value = normalised * np.sqrt(_weights(telling, normalised))
    frames = [value[problem.frame_of == i] for i in range(len(problem.contours))]
    power = max(float((value**2).mean()), 1e-12)
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
    noise: Noise,
    origin: tuple[float, float],
    frame: Floats,
    largest_dem_error_m: float | None,
) -> Refined:
    sigma = _sigma(problem, here, noise.spread_m)
    normalised, telling = here.residual / sigma, _telling(here, sigma)
    columns = _columns(problem, x, here, noise.model, _weights(telling, normalised))
    if largest_dem_error_m is None:
        normal = normal_equations(columns, noise.model)
        covariance = np.asarray(np.linalg.inv(normal.curvature), np.float64)
    else:
        covariance = _averaged_covariance(
            likely_models(columns, noise.model, _range(problem, largest_dem_error_m))
        )
    misfit, _ = _priors(problem, x, here, noise.spread_m)
    fit_cost = (
        whitened_cost(columns, noise.model)
        + _prior_cost(problem, x, here, noise.model)
        + _loss(problem, telling, normalised, sigma)
        + _log_scale(problem, x, here, noise.model)
    )
    surprise = np.where(telling, _robust(normalised) + np.log(sigma), np.log(CHANCE_RAD))
    row, col = _place(x, origin, frame)
    inside = telling & (np.abs(normalised) < 3.0)
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
        azimuth_bias_sigma_deg=float(np.sqrt(covariance[AZIMUTH_BIAS, AZIMUTH_BIAS])),
        tilt_bias_deg=float(x[TILT_BIAS]),
        frame_errors_deg=x[FIRST_FRAME:].reshape(-1, PER_FRAME),
        covariance_enu_m2=covariance[:2, :2] + np.eye(2) * _shift_sigma_m(problem, noise.model) ** 2,
        cost=float(surprise.sum() / noise.correlation_columns + 0.5 * (misfit**2).sum()),
        fit_cost=fit_cost,
        log_volume=0.5 * float(np.linalg.slogdet(covariance)[1]),
        dem_error_m=noise.spread_m,
        correlation_columns=noise.correlation_columns,
        inlier_share=float(inside.sum() / max(telling.sum(), 1)),
        prior_chi2=float((misfit**2).sum()),
        residual_px=residual_px,
        misfit_per_column=float(surprise.mean()),
        evidence=_evidence(problem, here, telling, sigma),
        error_model=noise.model,
    )


def _shift_sigma_m(problem: Problem, model: ErrorModel) -> float:
    """By how much a DEM's errors shift the best place beyond what the linearised fit says: one sigma in each direction.

    A smooth error tilts all that is near, the ground under the camera too.
    """
    return float(np.hypot(LATTICE_SHARE * problem.terrain.cell_m, SHIFT_PER_M * model.smooth_m))


def _averaged_covariance(models: list[tuple[ErrorModel, Normal]]) -> Floats:
    """Of the parameters, over the models that the residuals leave possible: the fit moves with the model, too."""
    evidence = np.array([normal.log_evidence for _, normal in models])
    share = np.exp(evidence - evidence.max())
    share /= share.sum()
    covariance = np.array([np.linalg.inv(normal.curvature) for _, normal in models])
    shift = np.array([-c @ normal.slope for c, (_, normal) in zip(covariance, models, strict=True)])
    shift -= share @ shift
    return np.asarray(np.einsum("m,mij->ij", share, covariance) + (share[:, None] * shift).T @ shift)


def _wrapped(radians: Floats) -> Floats:
    return (radians + np.pi) % (2.0 * np.pi) - np.pi
