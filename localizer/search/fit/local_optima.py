"""The best local optimum around a fit, and what the other optima nearby add to its covariance.

Near hills, or with a stretch of outliers, the posterior has many local optima a few metres apart, and a descent ends at any of
them. The steps: a grid search under several DEM errors; refits from the best grid points with more columns; a finer grid and
stricter outlier limits where the refits disagree; a final fit with all columns; then the average over the optima by their
tempered posterior. A temperature T > 1 divides the log-posterior, because the error model is only approximately right.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from localizer.dem.horizon import Terrain
from localizer.search.fit.correlated_errors import ErrorModel
from localizer.search.fit.local_grid import grid_optima, grid_second_moment
from localizer.search.fit.noise import INITIAL_LENGTH_CELLS, Noise
from localizer.search.fit.problem import Problem
from localizer.search.fit.problems import Problems, without_edge_columns
from localizer.search.fit.refine import LIKELIHOOD_FROM, Refined, refine

Floats = NDArray[np.float64]

GRID_CELLS = (2.4, 0.4)
"""Reach and step of the search grid around a fit. Tuned on the scenario ``dem_error``. Sensitivity: not measured yet (``sim
sensitivity``)."""
GRID_STARTS = 3
"""Refits from the grid under each DEM error. Tuned on time and on the scenario ``dem_error``.
Sensitivity: not measured yet (``sim sensitivity``)."""
GRID_ERROR_FACTORS = (0.2, 1.5)
"""DEM errors on the grid, as factors of the nominal one. Tuned on the scenario ``dem_error``.
Sensitivity: not measured yet (``sim sensitivity``)."""
FINE_GRID_CELLS = (0.6, 0.15)
"""Reach and step of the finer grid, used if the refits end at different optima. Tuned on the scenario ``dem_error``.
Sensitivity: not measured yet (``sim sensitivity``)."""
MOMENT_GRID_CELLS = (3.0, 0.6)
"""Reach and step of the grid for the second moment. Tuned on the scenario ``dem_error``.
Sensitivity: not measured yet (``sim sensitivity``)."""
MOMENT_NATS = 15.0
"""A point of that grid is plausible if a short refit from it stays there and its evidence is lower by at most this. Tuned on
the scenario ``dem_error``. Sensitivity: not measured yet (``sim sensitivity``)."""
MOMENT_ITERATIONS = 6
"""Iterations of that refit."""
MOST_FINE_FITS = 4
"""Optima that are refitted with fine columns. Tuned on time. Sensitivity: not measured yet (``sim sensitivity``)."""
LEAST_EVIDENCE_TO_REFINE = 0.0
"""A place with less evidence explains nothing and is not refined further."""
SAME_OPTIMUM_CELLS = 0.05
"""Fits this close together have reached the same optimum."""
CLEAN_INLIER_SHARE = 0.98
"""With a larger inlier share no stretch of outliers can bias the fit. Tuned on the scenario ``dem_error``.
Sensitivity: not measured yet (``sim sensitivity``)."""
STRICT_SIGMA_FACTOR = 0.3
"""Factor on the DEM error where outliers are identified in the strict fits: a stretch that biased the fit can then become an
outlier. Tuned on the scenario ``dem_error``. Sensitivity: not measured yet (``sim sensitivity``)."""
MOST_STRICT_FITS = 2
"""Number of strict fits."""
LIKELY_OPTIMUM_SHARE = 0.05
"""Optima with at least this share of the best one's posterior contribute to the evidence. Tuned on the scenario ``dem_error``.
Sensitivity: not measured yet (``sim sensitivity``)."""
SAME_PLACE_CELLS = 2.0
"""Fits this close together are one place."""
TEMPERATURE_PER_M = 10.0
"""Temperature of the posterior over optima, 1 + this per metre of smooth DEM error. The error model is only approximately
right: where one ridge occludes another, the horizon depends on details that the model lacks. Tuned on the scenario
``dem_error``. Sensitivity: halved, no change; doubled, sigmas change by the factor 1.2 (docs/sensitivity.md)."""


def best_local_optimum(problems: Problems, start: Refined, largest: float) -> Refined:
    """The best local optimum around a coarse fit, with all columns and its own noise.

    A fit in a wrong optimum may attribute its residuals to the DEM error, and with a large DEM error nothing moves it away. The
    grid search therefore assumes several DEM errors, each optimum gets its own noise, and the one with the best posterior
    under its own noise counts. A place without evidence is not refined further.
    """
    problems = without_edge_columns(problems, start)
    first_fit = refit(problems.middle, start, largest, estimate_noise=True)
    usual = problems.full.nominal_error_m
    length_m = INITIAL_LENGTH_CELLS * problems.full.terrain.cell_m
    correlation = first_fit.correlation_columns
    noises = [Noise(first_fit.dem_error_m, correlation, first_fit.error_model)] + [
        Noise(share * usual, correlation, ErrorModel(0.1 * share * usual, share * usual, length_m))
        for share in GRID_ERROR_FACTORS
    ]
    fits = _fits_from_grid(problems, first_fit, noises, largest, estimate_noise=True)
    if max(fit.evidence for fit in [first_fit, *fits]) < LEAST_EVIDENCE_TO_REFINE:
        thinned = len(problems.full.sigma_rad) / len(problems.middle.sigma_rad)
        return replace(first_fit, correlation_columns=first_fit.correlation_columns * thinned)
    starts = distinct([first_fit, *sorted(fits, key=lambda r: r.neg_log_posterior)], GRID_CELLS[1])[
        :MOST_FINE_FITS
    ]
    fine_fits = [_refit_with_noise(problems.fine, start, largest) for start in starts]
    strict_fits: list[Refined] = []
    best = min(fine_fits, key=lambda r: r.neg_log_posterior)
    if best.inlier_share < CLEAN_INLIER_SHARE or len(distinct(fine_fits, SAME_OPTIMUM_CELLS)) > 1:
        fine_fits += _fits_from_fine_grid(problems, best, largest)
        promising = sorted(fine_fits, key=lambda r: r.neg_log_posterior)[:MOST_STRICT_FITS]
        strict_fits = [
            _refit_with_noise(problems.fine, final, largest, sigma_factor=STRICT_SIGMA_FACTOR)
            for final in promising
        ]
    fine_fits = sorted([*fine_fits, *strict_fits], key=lambda r: r.neg_log_posterior)
    sigma_factor = STRICT_SIGMA_FACTOR if any(fine_fits[0] is fit for fit in strict_fits) else 1.0
    best = _refit_with_noise(problems.full, fine_fits[0], largest, sigma_factor=sigma_factor)
    return _averaged_over_optima(problems, best, fine_fits, fits, largest)


def refit(
    problem: Problem,
    start: Refined,
    largest: float,
    *,
    estimate_noise: bool = False,
    noise: Noise | None = None,
    iterations: int = 24,
    likelihood_from: int = LIKELIHOOD_FROM,
    sigma_factor: float = 1.0,
) -> Refined:
    """Refine from the result of another fit, with its noise unless ``noise`` is given."""
    return refine(
        problem,
        start.row,
        start.col,
        start.altitude_m,
        start.azimuth_bias_deg,
        iterations=iterations,
        noise=noise or Noise(start.dem_error_m, start.correlation_columns, start.error_model),
        largest_dem_error_m=largest,
        estimate_noise=estimate_noise,
        likelihood_from=likelihood_from,
        sigma_factor=sigma_factor,
    )


def rescaled_noise(thinning: float, fit: Refined) -> Noise:
    """The noise of a fit for a problem whose columns are fewer by the factor ``thinning``."""
    return Noise(fit.dem_error_m, max(1.0, fit.correlation_columns / thinning), fit.error_model)


def distinct(candidates: list[Refined], radius_cells: float) -> list[Refined]:
    """The first of each group of candidates that lie within ``radius_cells`` of each other."""
    kept: list[Refined] = []
    for c in candidates:
        if all(np.hypot(c.row - k.row, c.col - k.col) > radius_cells for k in kept):
            kept.append(c)
    return kept


def _fits_from_grid(
    problems: Problems, first_fit: Refined, noises: Sequence[Noise], largest: float, *, estimate_noise: bool
) -> list[Refined]:
    """Fits from the best grid points around another fit under each noise."""
    return [
        refit(
            problems.middle,
            replace(first_fit, row=row, col=col, altitude_m=altitude_m),
            largest,
            estimate_noise=estimate_noise,
            noise=noise,
            iterations=8,
            likelihood_from=0,
        )
        for row, col, altitude_m, noise in grid_optima(
            problems.coarse, first_fit, noises, *GRID_CELLS, GRID_STARTS
        )
    ]


def _fits_from_fine_grid(problems: Problems, best: Refined, largest: float) -> list[Refined]:
    """Fits from the best points of the fine grid around the best fit so far."""
    ratio = len(problems.middle.sigma_rad) / len(problems.fine.sigma_rad)
    noise = Noise(best.dem_error_m, max(1.0, best.correlation_columns * ratio), best.error_model)
    places = grid_optima(problems.middle, best, [noise], *FINE_GRID_CELLS, GRID_STARTS)
    return [
        _refit_with_noise(problems.fine, replace(best, row=row, col=col, altitude_m=altitude_m), largest)
        for row, col, altitude_m, _ in places
    ]


def _refit_with_noise(problem: Problem, start: Refined, largest: float, sigma_factor: float = 1.0) -> Refined:
    """A fit that starts with another one's noise and estimates its own."""
    return refit(problem, start, largest, estimate_noise=True, likelihood_from=0, sigma_factor=sigma_factor)


def _averaged_over_optima(
    problems: Problems, best: Refined, fine_fits: list[Refined], coarse_fits: list[Refined], largest: float
) -> Refined:
    """The best fit moved to the mean over the optima by their tempered posterior, with the total covariance.

    The covariance is that of the best fit, plus the spread of the optima, plus the second moment on a grid for optima that no
    fit reached. ``best``: with all columns; ``fine_fits``: with fewer, the best first; ``coarse_fits`` contribute only to
    the spread. The evidence is the largest among the likely optima.
    """
    terrain, coarse = problems.full.terrain, problems.coarse
    temperature = 1.0 if terrain.exact else 1.0 + TEMPERATURE_PER_M * best.error_model.smooth_m

    def likelihood(fits: list[Refined]) -> Floats:
        cost = np.array([r.neg_log_posterior for r in fits])
        return np.asarray(np.exp((cost.min() - cost) / temperature)) if fits else cost

    weight = likelihood(fine_fits)
    place = np.array([[r.row, r.col] for r in fine_fits])
    mean = weight @ place / weight.sum()
    near = np.hypot(*(place - [best.row, best.col]).T) <= SAME_PLACE_CELLS
    likely = [
        fit for fit, counts in zip(fine_fits, near & (weight >= LIKELY_OPTIMUM_SHARE), strict=True) if counts
    ]
    share = np.concatenate([weight, likelihood(coarse_fits)])
    share /= share.sum()
    off = np.vstack([place, *([[r.row, r.col]] for r in coarse_fits)]) - mean
    off_m = off[:, ::-1] * np.array([terrain.dem.spacing_ew_m, -terrain.dem.spacing_ns_m])
    row, col = np.array([best.row, best.col]) + mean - place[0]
    averaged = _at(best, float(row), float(col), terrain)
    noise = rescaled_noise(coarse.stride, best)
    # With independent noise, fewer columns carry less information: scale the temperature.
    fewer = len(coarse.sigma_rad) / len(problems.full.sigma_rad)
    reference = refit(coarse, averaged, largest, noise=noise, iterations=MOMENT_ITERATIONS)

    def plausible(row: float, col: float, altitude_m: float) -> bool:
        start = replace(averaged, row=row, col=col, altitude_m=altitude_m)
        refitted = refit(coarse, start, largest, noise=noise, iterations=MOMENT_ITERATIONS)
        stays = np.hypot(refitted.row - row, refitted.col - col) < np.hypot(
            refitted.row - averaged.row, refitted.col - averaged.col
        )
        return bool(stays and refitted.evidence >= reference.evidence - MOMENT_NATS)

    grid_moment_m2 = grid_second_moment(
        coarse, averaged, noise, *MOMENT_GRID_CELLS, fewer * temperature, plausible
    )
    return replace(
        averaged,
        covariance_enu_m2=best.covariance_enu_m2 + (share[:, None] * off_m).T @ off_m + grid_moment_m2,
        evidence=max(fit.evidence for fit in [best, *likely]),
    )


def _at(fit: Refined, row: float, col: float, terrain: Terrain) -> Refined:
    """The fit at a position nearby, at the same height above the ground."""
    rise_m = float(terrain.dem.ground_m(row, col)) - float(terrain.dem.ground_m(fit.row, fit.col))
    altitude_m = fit.altitude_m + (rise_m if np.isfinite(rise_m) else 0.0)
    return replace(fit, row=row, col=col, altitude_m=altitude_m)
