"""The best place around a fit: looking about for rival peaks, and what these leave of the certainty.

Close to hills, and where a stretch of the contours is wrong, the likelihood has many peaks a few metres apart, and a descent
ends at any of them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from localizer.dem.horizon import Terrain
from localizer.observation import Observation
from localizer.search.contours import FrameContour
from localizer.search.fit.correlated_errors import ErrorModel
from localizer.search.fit.local_grid import grid_optima, grid_second_moment
from localizer.search.fit.noise import INITIAL_LENGTH_CELLS, Noise
from localizer.search.fit.problem import Problem
from localizer.search.fit.refine import LIKELIHOOD_FROM, Refined, refine
from localizer.search.fit.residuals import evaluate

Floats = NDArray[np.float64]

COARSE_COLUMNS = 120
"""Columns of all frames together in the first refinement of each start, and ..."""
MIDDLE_COLUMNS = 480
"""... in the comparison of the contenders, and ..."""
FINE_COLUMNS = 1000
"""... where the peaks around the best of them are told apart."""
GRID_CELLS = (2.4, 0.4)
"""How far around a fit other places are tried for a better one, and how far apart these are."""
GRID_STARTS = 3
GRID_ERROR_FACTORS = (0.2, 1.5)
"""What is taken for a DEM's error in that, in terms of what is usual."""
FINE_GRID_CELLS = (0.6, 0.15)
"""The same around the best of the places found, where these are not one and the same."""
MOMENT_GRID_CELLS = (3.0, 0.6)
"""The same for how far places reach that are hardly less likely than the best one."""
MOMENT_NATS = 15.0
MOMENT_ITERATIONS = 6
"""A place with so much less evidence, fitted a little, is less likely. So is one whose fit goes back."""
MOST_FINE_FITS = 4
LEAST_EVIDENCE_TO_REFINE = 0.0
SAME_OPTIMUM_CELLS = 0.05
CLEAN_INLIER_SHARE = 0.98
"""Share of columns that fit, from which there is no stretch that could bend the fit."""
STRICT_SIGMA_FACTOR = 0.3
MOST_STRICT_FITS = 2
"""Factor on the DEM's error that tells stray columns in a last attempt: a stretch that bent the fit may let go of it."""
LIKELY_OPTIMUM_SHARE = 0.05
"""Share of the best peak's likelihood."""
LEAST_COLUMNS = 30
"""Fewer cannot tell a place."""
SAME_PLACE_CELLS = 2.0
TEMPERATURE_PER_M = 10.0
"""By how much the log-likelihood of peaks close to each other is divided for each metre of the DEM's error: the error model is
only about right, and what a horizon does where one ridge hides another depends on details that it does not have."""


@dataclass(frozen=True)
class Problems:
    """One standpoint with few columns for many attempts, and with more for fewer of them."""

    coarse: Problem
    middle: Problem
    fine: Problem
    full: Problem


def problems_of(
    terrain: Terrain,
    observation: Observation,
    contours: tuple[FrameContour, ...],
    *,
    uses_edge_columns: bool = False,
    sector_columns: int | None = None,
) -> Problems:
    """The observations and priors of one standpoint; the options are those of ``Problem``."""
    columns = sum(len(c.rays) for c in contours)

    def thinned(most: int) -> Problem:
        stride = max(1, columns // most)
        return Problem(
            terrain,
            observation,
            contours,
            stride,
            uses_edge_columns=uses_edge_columns,
            sector_columns=sector_columns,
        )

    return Problems(*(thinned(most) for most in (COARSE_COLUMNS, MIDDLE_COLUMNS, FINE_COLUMNS, columns)))


def without_edge_columns(problems: Problems, place: Refined) -> Problems:
    """The same without the columns whose horizon lies, from a place, where the DEM ends; as they are where too few are left.

    Places close to each other are compared by the same columns: else one would win that has less of its horizon there. What
    is left of a stretch of the horizon speaks for no more than it did.
    """
    full = problems.full
    inside = ~_edge_columns(full, place)
    if np.count_nonzero(inside) < LEAST_COLUMNS:
        return problems
    contours = []
    for i, contour in enumerate(full.contours):
        mine = inside[full.frame_of == i]
        contours.append(FrameContour(contour.frame, contour.rays[mine], contour.sigma_rad[mine]))
    return problems_of(
        full.terrain,
        full.observation,
        tuple(contours),
        uses_edge_columns=True,
        sector_columns=full.sector_columns,
    )


def has_edge_columns(problem: Problem, place: Refined) -> bool:
    """Whether any column has its horizon, as seen from a place, where the DEM ends."""
    return bool(_edge_columns(problem, place).any())


def _edge_columns(problem: Problem, place: Refined) -> NDArray[np.bool_]:
    coefficients = problem.terrain.geodesics.at(place.row, place.col)[0]
    return evaluate(problem, place.parameters(), (place.row, place.col), coefficients).dem_edge


def best_local_optimum(problems: Problems, start: Refined, largest: float) -> Refined:
    """The best place around a coarse fit, with all columns, its noise estimated there.

    A fit beside the best place may have taken its misfit for the DEM's error, and a larger error leaves it no reason to move.
    So the search about it takes several sizes for granted, each of the places found has its own noise estimated, and the
    likeliest under its own counts. Where nothing explains the contours better than chance does, it is not looked for closer.
    """
    problems = without_edge_columns(problems, start)
    found = refit(problems.middle, start, largest, estimate_noise=True)
    usual = problems.full.nominal_error_m
    length_m = INITIAL_LENGTH_CELLS * problems.full.terrain.cell_m
    correlation = found.correlation_columns
    noises = [Noise(found.dem_error_m, correlation, found.error_model)] + [
        Noise(share * usual, correlation, ErrorModel(0.1 * share * usual, share * usual, length_m))
        for share in GRID_ERROR_FACTORS
    ]
    fits = _fits_from_grid(problems, found, noises, largest, estimate_noise=True)
    if max(fit.evidence for fit in [found, *fits]) < LEAST_EVIDENCE_TO_REFINE:
        thinned = len(problems.full.sigma_rad) / len(problems.middle.sigma_rad)
        return replace(found, correlation_columns=found.correlation_columns * thinned)
    starts = distinct([found, *sorted(fits, key=lambda r: r.neg_log_posterior)], GRID_CELLS[1])[
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
    """Refine once more from where another refinement ended, with its ``noise`` to begin with where no other is given."""
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
    """The noise of a fit, for a problem with fewer columns by a factor."""
    return Noise(fit.dem_error_m, max(1.0, fit.correlation_columns / thinning), fit.error_model)


def distinct(candidates: list[Refined], radius_cells: float) -> list[Refined]:
    """The first of each group of candidates that lie within ``radius_cells`` of each other."""
    kept: list[Refined] = []
    for c in candidates:
        if all(np.hypot(c.row - k.row, c.col - k.col) > radius_cells for k in kept):
            kept.append(c)
    return kept


def _fits_from_grid(
    problems: Problems, found: Refined, noises: Sequence[Noise], largest: float, *, estimate_noise: bool
) -> list[Refined]:
    """Fits from the likeliest places around another under each noise, which is held unless they ``settle`` their own."""
    return [
        refit(
            problems.middle,
            replace(found, row=row, col=col, altitude_m=altitude_m),
            largest,
            estimate_noise=estimate_noise,
            noise=noise,
            iterations=8,
            likelihood_from=0,
        )
        for row, col, altitude_m, noise in grid_optima(
            problems.coarse, found, noises, *GRID_CELLS, GRID_STARTS
        )
    ]


def _fits_from_fine_grid(problems: Problems, best: Refined, largest: float) -> list[Refined]:
    """Fits from the likeliest places close around the best one so far."""
    ratio = len(problems.middle.sigma_rad) / len(problems.fine.sigma_rad)
    noise = Noise(best.dem_error_m, max(1.0, best.correlation_columns * ratio), best.error_model)
    places = grid_optima(problems.middle, best, [noise], *FINE_GRID_CELLS, GRID_STARTS)
    return [
        _refit_with_noise(problems.fine, replace(best, row=row, col=col, altitude_m=altitude_m), largest)
        for row, col, altitude_m, _ in places
    ]


def _refit_with_noise(problem: Problem, start: Refined, largest: float, sigma_factor: float = 1.0) -> Refined:
    """A fit that starts from another one's noise and settles its own."""
    return refit(problem, start, largest, estimate_noise=True, likelihood_from=0, sigma_factor=sigma_factor)


def _averaged_over_optima(
    problems: Problems, best: Refined, fine_fits: list[Refined], coarse_fits: list[Refined], largest: float
) -> Refined:
    """The best fit, moved to the mean of all finals by their likelihoods, its covariance widened by how far the fits lie apart.

    And by how far around it the likelihood is flat, or has peaks that no fit ended in. ``best`` has all columns, ``finals``,
    the best of them first, fewer; ``others``, of fewer still, only widen it. Whichever of the likely peaks explains the
    contours best, by so much the place does.
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
    # Where the noise is each column's own, few columns tell as much less; the DEM's is blunted anyway.
    fewer = len(coarse.sigma_rad) / len(problems.full.sigma_rad)
    evaluation = refit(coarse, averaged, largest, noise=noise, iterations=MOMENT_ITERATIONS)

    def plausible(row: float, col: float, altitude_m: float) -> bool:
        start = replace(averaged, row=row, col=col, altitude_m=altitude_m)
        refitted = refit(coarse, start, largest, noise=noise, iterations=MOMENT_ITERATIONS)
        stays = np.hypot(refitted.row - row, refitted.col - col) < np.hypot(
            refitted.row - averaged.row, refitted.col - averaged.col
        )
        return bool(stays and refitted.evidence >= evaluation.evidence - MOMENT_NATS)

    grid_moment_m2 = grid_second_moment(
        coarse, averaged, noise, *MOMENT_GRID_CELLS, fewer * temperature, plausible
    )
    return replace(
        averaged,
        covariance_enu_m2=best.covariance_enu_m2 + (share[:, None] * off_m).T @ off_m + grid_moment_m2,
        evidence=max(fit.evidence for fit in [best, *likely]),
    )


def _at(fit: Refined, row: float, col: float, terrain: Terrain) -> Refined:
    """The same a little way off, as high above the ground."""
    rise_m = float(terrain.dem.ground_m(row, col)) - float(terrain.dem.ground_m(fit.row, fit.col))
    altitude_m = fit.altitude_m + (rise_m if np.isfinite(rise_m) else 0.0)
    return replace(fit, row=row, col=col, altitude_m=altitude_m)
