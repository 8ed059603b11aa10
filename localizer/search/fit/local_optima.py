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
from localizer.search.fit.lattice import places_around, spread_around
from localizer.search.fit.noise import FIRST_LENGTH_CELLS, Noise
from localizer.search.fit.problem import Problem
from localizer.search.fit.refine import LIKELY_FROM, Refined, refine
from localizer.search.fit.residuals import evaluate

Floats = NDArray[np.float64]

COARSE_COLUMNS = 120
"""Columns of all frames together in the first refinement of each start, and ..."""
CONTEST_COLUMNS = 480
"""... in the comparison of the contenders, and ..."""
FINE_COLUMNS = 1000
"""... where the peaks around the best of them are told apart."""
LOOK_ABOUT_CELLS = (2.4, 0.4)
"""How far around a fit other places are tried for a better one, and how far apart these are."""
LOOK_ABOUT_STARTS = 3
LOOK_ABOUT_ERRORS = (0.2, 1.5)
"""What is taken for a DEM's error in that, in terms of what is usual."""
LOOK_CLOSER_CELLS = (0.6, 0.15)
"""The same around the best of the places found, where these are not one and the same."""
SPREAD_CELLS = (3.0, 0.6)
"""The same for how far places reach that are hardly less likely than the best one."""
SPREAD_NATS, SPREAD_ITERATIONS = 15.0, 6
"""A place with so much less evidence, fitted a little, is less likely. So is one whose fit goes back."""
FINALISTS = 4
HOPELESS_EVIDENCE = 0.0
ONE_PLACE_CELLS = 0.05
CLEAN_INLIERS = 0.98
"""Share of columns that fit, from which there is no stretch that could bend the fit."""
STRICT_SHARE, STRICT_FINALISTS = 0.3, 2
"""Factor on the DEM's error that tells stray columns in a last attempt: a stretch that bent the fit may let go of it."""
LIKELY_PEAK = 0.05
"""Share of the best peak's likelihood."""
LEAST_COLUMNS = 30
"""Fewer cannot tell a place."""
SAME_PLACE_CELLS = 2.0
BLUNTING_PER_M = 10.0
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
    believes_rim: bool = False,
    block_columns: int | None = None,
) -> Problems:
    """The observations and priors of one standpoint; the options are those of ``Problem``."""
    columns = sum(len(c.rays) for c in contours)

    def thinned(most: int) -> Problem:
        stride = max(1, columns // most)
        return Problem(
            terrain, observation, contours, stride, believes_rim=believes_rim, block_columns=block_columns
        )

    return Problems(*(thinned(most) for most in (COARSE_COLUMNS, CONTEST_COLUMNS, FINE_COLUMNS, columns)))


def within_the_dem(problems: Problems, place: Refined) -> Problems:
    """The same without the columns whose horizon lies, from a place, where the DEM ends; as they are where too few are left.

    Places close to each other are compared by the same columns: else one would win that has less of its horizon there. What
    is left of a stretch of the horizon speaks for no more than it did.
    """
    full = problems.full
    inside = ~_rim_from(full, place)
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
        believes_rim=True,
        block_columns=full.block_columns,
    )


def sees_rim(problem: Problem, place: Refined) -> bool:
    """Whether any column has its horizon, as seen from a place, where the DEM ends."""
    return bool(_rim_from(problem, place).any())


def _rim_from(problem: Problem, place: Refined) -> NDArray[np.bool_]:
    frame = problem.terrain.frames.at(place.row, place.col)[0]
    return evaluate(problem, place.parameters(), (place.row, place.col), frame).rim


def best_nearby(problems: Problems, start: Refined, largest: float) -> Refined:
    """The best place around a coarse fit, with all columns, its noise estimated there.

    A fit beside the best place may have taken its misfit for the DEM's error, and a larger error leaves it no reason to move.
    So the search about it takes several sizes for granted, each of the places found has its own noise estimated, and the
    likeliest under its own counts. Where nothing explains the contours better than chance does, it is not looked for closer.
    """
    problems = within_the_dem(problems, start)
    found = again(problems.middle, start, largest, settle=True)
    usual = problems.full.usual_error_m
    length_m = FIRST_LENGTH_CELLS * problems.full.terrain.cell_m
    correlation = found.correlation_columns
    noises = [Noise(found.dem_error_m, correlation, found.error_model)] + [
        Noise(share * usual, correlation, ErrorModel(0.1 * share * usual, share * usual, length_m))
        for share in LOOK_ABOUT_ERRORS
    ]
    fits = _looked_about(problems, found, noises, largest, settle=True)
    if max(fit.evidence for fit in [found, *fits]) < HOPELESS_EVIDENCE:
        thinned = len(problems.full.sigma_rad) / len(problems.middle.sigma_rad)
        return replace(found, correlation_columns=found.correlation_columns * thinned)
    starts = distinct([found, *sorted(fits, key=lambda r: r.fit_cost)], LOOK_ABOUT_CELLS[1])[:FINALISTS]
    finals = [_settled(problems.fine, start, largest) for start in starts]
    strictly: list[Refined] = []
    best = min(finals, key=lambda r: r.fit_cost)
    if best.inlier_share < CLEAN_INLIERS or len(distinct(finals, ONE_PLACE_CELLS)) > 1:
        finals += _looked_closer(problems, best, largest)
        promising = sorted(finals, key=lambda r: r.fit_cost)[:STRICT_FINALISTS]
        strictly = [_settled(problems.fine, final, largest, strict=STRICT_SHARE) for final in promising]
    finals = sorted([*finals, *strictly], key=lambda r: r.fit_cost)
    strict = STRICT_SHARE if any(finals[0] is fit for fit in strictly) else 1.0
    best = _settled(problems.full, finals[0], largest, strict=strict)
    return _weighed(problems, best, finals, fits, largest)


def again(
    problem: Problem,
    start: Refined,
    largest: float,
    *,
    settle: bool = False,
    noise: Noise | None = None,
    iterations: int = 24,
    likely_from: int = LIKELY_FROM,
    strict: float = 1.0,
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
        settle=settle,
        likely_from=likely_from,
        strict=strict,
    )


def noise_for(thinning: float, fit: Refined) -> Noise:
    """The noise of a fit, for a problem with fewer columns by a factor."""
    return Noise(fit.dem_error_m, max(1.0, fit.correlation_columns / thinning), fit.error_model)


def distinct(candidates: list[Refined], radius_cells: float) -> list[Refined]:
    """The first of each group of candidates that lie within ``radius_cells`` of each other."""
    kept: list[Refined] = []
    for c in candidates:
        if all(np.hypot(c.row - k.row, c.col - k.col) > radius_cells for k in kept):
            kept.append(c)
    return kept


def _looked_about(
    problems: Problems, found: Refined, noises: Sequence[Noise], largest: float, *, settle: bool
) -> list[Refined]:
    """Fits from the likeliest places around another under each noise, which is held unless they ``settle`` their own."""
    return [
        again(
            problems.middle,
            replace(found, row=row, col=col, altitude_m=altitude_m),
            largest,
            settle=settle,
            noise=noise,
            iterations=8,
            likely_from=0,
        )
        for row, col, altitude_m, noise in places_around(
            problems.coarse, found, noises, *LOOK_ABOUT_CELLS, LOOK_ABOUT_STARTS
        )
    ]


def _looked_closer(problems: Problems, best: Refined, largest: float) -> list[Refined]:
    """Fits from the likeliest places close around the best one so far."""
    ratio = len(problems.middle.sigma_rad) / len(problems.fine.sigma_rad)
    noise = Noise(best.dem_error_m, max(1.0, best.correlation_columns * ratio), best.error_model)
    places = places_around(problems.middle, best, [noise], *LOOK_CLOSER_CELLS, LOOK_ABOUT_STARTS)
    return [
        _settled(problems.fine, replace(best, row=row, col=col, altitude_m=altitude_m), largest)
        for row, col, altitude_m, _ in places
    ]


def _settled(problem: Problem, start: Refined, largest: float, strict: float = 1.0) -> Refined:
    """A fit that starts from another one's noise and settles its own."""
    return again(problem, start, largest, settle=True, likely_from=0, strict=strict)


def _weighed(
    problems: Problems, best: Refined, finals: list[Refined], others: list[Refined], largest: float
) -> Refined:
    """The best fit, moved to the mean of all finals by their likelihoods, its covariance widened by how far the fits lie apart.

    And by how far around it the likelihood is flat, or has peaks that no fit ended in. ``best`` has all columns, ``finals``,
    the best of them first, fewer; ``others``, of fewer still, only widen it. Whichever of the likely peaks explains the
    contours best, by so much the place does.
    """
    terrain, coarse = problems.full.terrain, problems.coarse
    blunting = 1.0 if terrain.exact else 1.0 + BLUNTING_PER_M * best.error_model.smooth_m

    def likelihood(fits: list[Refined]) -> Floats:
        cost = np.array([r.fit_cost for r in fits])
        return np.asarray(np.exp((cost.min() - cost) / blunting)) if fits else cost

    weight = likelihood(finals)
    place = np.array([[r.row, r.col] for r in finals])
    mean = weight @ place / weight.sum()
    near = np.hypot(*(place - [best.row, best.col]).T) <= SAME_PLACE_CELLS
    likely = [fit for fit, counts in zip(finals, near & (weight >= LIKELY_PEAK), strict=True) if counts]
    share = np.concatenate([weight, likelihood(others)])
    share /= share.sum()
    off = np.vstack([place, *([[r.row, r.col]] for r in others)]) - mean
    off_m = off[:, ::-1] * np.array([terrain.dem.spacing_ew_m, -terrain.dem.spacing_ns_m])
    row, col = np.array([best.row, best.col]) + mean - place[0]
    moved = _moved(best, float(row), float(col), terrain)
    noise = noise_for(coarse.stride, best)
    # Where the noise is each column's own, few columns tell as much less; the DEM's is blunted anyway.
    fewer = len(coarse.sigma_rad) / len(problems.full.sigma_rad)
    here = again(coarse, moved, largest, noise=noise, iterations=SPREAD_ITERATIONS)

    def plausible(row: float, col: float, altitude_m: float) -> bool:
        start = replace(moved, row=row, col=col, altitude_m=altitude_m)
        there = again(coarse, start, largest, noise=noise, iterations=SPREAD_ITERATIONS)
        stays = np.hypot(there.row - row, there.col - col) < np.hypot(
            there.row - moved.row, there.col - moved.col
        )
        return bool(stays and there.evidence >= here.evidence - SPREAD_NATS)

    flat = spread_around(coarse, moved, noise, *SPREAD_CELLS, fewer * blunting, plausible)
    return replace(
        moved,
        covariance_enu_m2=best.covariance_enu_m2 + (share[:, None] * off_m).T @ off_m + flat,
        evidence=max(fit.evidence for fit in [best, *likely]),
    )


def _moved(fit: Refined, row: float, col: float, terrain: Terrain) -> Refined:
    """The same a little way off, as high above the ground."""
    rise_m = float(terrain.dem.ground_m(row, col)) - float(terrain.dem.ground_m(fit.row, fit.col))
    altitude_m = fit.altitude_m + (rise_m if np.isfinite(rise_m) else 0.0)
    return replace(fit, row=row, col=col, altitude_m=altitude_m)
