"""Selection among the cells of stage 2: multi-start fits, of which the less probable ones are eliminated step by step.

1. Coarse fits (few columns) start from the best cells.
2. The best of them are short-listed and continued.
3. A fit with more columns leaves the *modes*: places that could still be the most probable one.
4. Around each mode the best local optimum is found with all columns.
5. The optima are compared on the same columns (``compare``), and ``decide`` makes the result.

Every step treats all places alike, whatever their order. A place that a limit rejects keeps its probability: it is added to
``elsewhere``.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from localizer.dem.horizon import Terrain
from localizer.observation import Observation
from localizer.search.coarse_to_fine import Cutoff, RankedCells
from localizer.search.compare import compare_on_same_columns, with_offset_of
from localizer.search.contours import FrameContour
from localizer.search.decide import (
    TEMPERING_EXPONENT,
    Decision,
    decide,
    is_plausible,
    no_place,
    rejection_reason,
)
from localizer.search.fit.local_optima import (
    SAME_PLACE_CELLS,
    best_local_optimum,
    distinct,
    refit,
    rescaled_noise,
)
from localizer.search.fit.noise import initial_noise
from localizer.search.fit.problem import SECTOR_RAD
from localizer.search.fit.problems import Problems, problems_of
from localizer.search.fit.refine import Refined, refine
from localizer.search.reasons import beyond_dem
from localizer.search.stage2 import suppress_neighbours

STARTS = 12
MOST_STARTS = 64
"""Cells from which coarse fits start, at least and at most."""
START_SIGMAS = 4.0
"""A cell starts a fit if its disparity is within so many standard deviations of that of the best fit's cell. Tuned on the
scenario ``twins``. Sensitivity: not measured yet (``sim sensitivity``)."""
START_RADIUS_CELLS = 1.5
"""No two starts lie closer to each other."""
LEAST_SHORTLISTED = 5
MOST_SHORTLISTED = 12
"""Short-listed places, at least (if there are so many) and at most."""
SHORTLIST_COLUMN_NATS = 0.5
"""Largest deficit of the mean log-likelihood of a column for a place to be short-listed. Tuned on the simulated cases of
``sim evaluate``. Sensitivity: not measured yet (``sim sensitivity``)."""
SHORTLIST_NATS = 12.0
"""Largest deficit of the log-likelihood of all independent columns, if that admits more places. Tuned on the scenario
``twins``. Sensitivity: not measured yet (``sim sensitivity``)."""
SHORTLIST_ODDS_SHARE = 0.3
"""Or log-odds of at least this share of the best ones. Tuned on the scenario ``twins``. Sensitivity: not measured yet (``sim
sensitivity``)."""
MODE_NATS = 30.0
"""A short-listed place whose log-odds are behind the best ones by more is no mode. Tuned on the scenario ``twins``.
Sensitivity: not measured yet (``sim sensitivity``)."""
UNREFINED_GAIN_NATS = 10.0
"""How much refinement may raise the log-odds of a place that was rejected before it. Tuned on the scenario ``twins``.
Sensitivity: not measured yet (``sim sensitivity``)."""
LEAST_LOG_ODDS = 5.0
"""Least log-odds of a mode other than the best. Tuned on the simulated cases of ``sim evaluate``.
Sensitivity: not measured yet (``sim sensitivity``)."""
MOST_MODES = 4
"""Tuned on the time of a search: each mode costs a full refinement. Sensitivity: not measured yet (``sim sensitivity``)."""


@dataclass(frozen=True)
class _Selection:
    """Places that were kept, the best first, and those that a limit rejected."""

    fits: list[Refined]
    rejected: list[Refined]


def select_place(
    terrain: Terrain, observation: Observation, contours: tuple[FrameContour, ...], ranked: RankedCells
) -> tuple[Decision, Refined | None]:
    """The decision among the cells of stage 2, and its most probable place; None if no place is believed."""
    largest_error_m = terrain.largest_error_m
    problems = problems_of(terrain, observation, contours)
    fits, cutoffs = _coarse_fits(terrain, observation, problems, ranked)
    shortlist = _shortlist(problems, fits, largest_error_m)
    modes = _remaining_modes(problems, shortlist.fits, largest_error_m)
    optima = [best_local_optimum(problems, mode, largest_error_m) for mode in modes.fits]
    optima = distinct(sorted(optima, key=_by_column_nll), SAME_PLACE_CELLS)
    compared = compare_on_same_columns(problems, optima, largest_error_m)
    best = compared[0].place
    miss_probability = [cutoff.miss_probability(best.row, best.col) for cutoff in cutoffs]
    rejected = [_rejected_weight(place, best) for place in [*shortlist.rejected, *modes.rejected]]
    elsewhere = 1.0 - math.prod(1.0 - share for share in miss_probability) + sum(rejected)
    reason = rejection_reason(best, largest_error_m, _priors(contours), _skyline_deg(problems))
    if reason is None and not terrain.dem.covers(best.row, best.col):
        reason = beyond_dem()
    if reason is not None:
        return no_place(reason), None
    decision = decide([c.log_mass for c in compared], [c.place for c in compared], terrain.cell_m, elsewhere)
    return decision, decision.candidates[0]


def refined_on_exact_dem(
    terrain: Terrain, observation: Observation, contours: tuple[FrameContour, ...], best: Refined
) -> Refined:
    """The best place refitted with the DEM as exact; the place as it was if an exact DEM does not fit.

    In an exact DEM near terrain fixes the position to centimetres, but it misleads a fit that starts farther off. Therefore
    only this last fit uses it.
    """
    problems = problems_of(terrain, observation, contours)
    largest_error_m = problems.full.largest_error_m
    refitted = best_local_optimum(problems, best, largest_error_m)
    stays = np.hypot(refitted.row - best.row, refitted.col - best.col) <= SAME_PLACE_CELLS
    return (
        replace(refitted, dem_error_m=0.0)
        if stays and is_plausible(refitted, largest_error_m, _priors(contours))
        else best
    )


def _priors(contours: tuple[FrameContour, ...]) -> int:
    """Number of readings: altitude, height of the ground, both biases, and three for each frame."""
    return 2 + 2 + 3 * len(contours)


def _skyline_deg(problems: Problems) -> float:
    """How much of the horizon was observed."""
    return float(np.degrees(len(problems.full.sectors) * SECTOR_RAD))


def _coarse_fits(
    terrain: Terrain, observation: Observation, problems: Problems, ranked: RankedCells
) -> tuple[list[Refined], list[Cutoff]]:
    """Coarse fits from the best cells, the best fit first, and all cutoffs that cells had to pass.

    Cells are added until all within START_SIGMAS of the best fit's own cell have been fitted.
    """
    scored = ranked.scored
    order = suppress_neighbours(scored, len(scored.cells), START_RADIUS_CELLS)
    disparity = scored.disparity[order]
    fitted: list[tuple[Refined, float]] = []
    wanted, least = _count_within(disparity, float(disparity[0]), ranked.sigma), STARTS
    while len(fitted) < min(max(wanted, least), MOST_STARTS, len(order)):
        i = order[len(fitted)]
        fit = _coarse_fit(terrain, observation, problems, scored.cells[i], float(scored.azimuth_bias_deg[i]))
        fitted.append((fit, float(scored.disparity[i])))
        if len(fitted) >= max(wanted, least):
            _, best_disparity = min(fitted, key=lambda entry: _by_column_nll(entry[0]))
            wanted = _count_within(disparity, best_disparity, ranked.sigma)
    count = len(fitted)
    rejected = float(disparity[count]) if count < len(order) else math.inf
    cutoff = Cutoff(scored.cells[order[:count]], disparity[:count], rejected, ranked.sigma)
    return sorted((fit for fit, _ in fitted), key=_by_column_nll), [*ranked.cutoffs, cutoff]


def _count_within(disparity: NDArray[np.float64], disparity_of_best: float, sigma: float) -> int:
    return int(np.searchsorted(disparity, disparity_of_best + START_SIGMAS * sigma))


def _coarse_fit(
    terrain: Terrain,
    observation: Observation,
    problems: Problems,
    cell: NDArray[np.int64],
    azimuth_bias_deg: float,
) -> Refined:
    row, col = cell.astype(float)
    return refine(
        problems.coarse,
        row,
        col,
        _first_altitude(terrain, observation, row, col),
        azimuth_bias_deg,
        iterations=4,
        noise=initial_noise(terrain, 2.0 * terrain.nominal_error_m),
        largest_dem_error_m=terrain.largest_error_m,
        estimate_noise=True,
    )


def _shortlist(problems: Problems, fits: list[Refined], largest_error_m: float) -> _Selection:
    """The places at which the best coarse fits end when they are continued, the best first."""
    first_list = _within(
        distinct(fits, SAME_PLACE_CELLS),
        2.0 * SHORTLIST_COLUMN_NATS,
        problems,
        MOST_SHORTLISTED,
        LEAST_SHORTLISTED,
    )
    continued = [
        refit(problems.coarse, fit, largest_error_m, estimate_noise=True, iterations=8)
        for fit in first_list.fits
    ]
    places = distinct(sorted(continued, key=_by_column_nll), SAME_PLACE_CELLS)
    shortlist = _within(places, SHORTLIST_COLUMN_NATS, problems, MOST_SHORTLISTED)
    return _Selection(shortlist.fits, [*first_list.rejected, *shortlist.rejected])


def _within(fits: list[Refined], margin: float, problems: Problems, most: int, least: int = 1) -> _Selection:
    """Of the fits (the best first), those with nearly the best likelihood per column or with large log-odds."""
    best = fits[0]
    independent = len(problems.coarse.sigma_rad) / best.correlation_columns
    furthest = best.mean_column_nll + max(margin, SHORTLIST_NATS / independent)
    odds = max(LEAST_LOG_ODDS, SHORTLIST_ODDS_SHARE * max(fit.log_odds for fit in fits))
    stays = [
        i < least or fit.mean_column_nll <= furthest or fit.log_odds >= odds for i, fit in enumerate(fits)
    ]
    kept = [fit for fit, stay in zip(fits, stays, strict=True) if stay]
    rejected_fits = [fit for fit, stay in zip(fits, stays, strict=True) if not stay]
    return _Selection(kept[:most], [*kept[most:], *rejected_fits])


def _rejected_weight(rejected: Refined, best: Refined) -> float:
    """Posterior weight of a rejected place relative to the best one, at most 1; negative log-odds count as 0."""
    behind = best.log_odds - UNREFINED_GAIN_NATS - max(rejected.log_odds, 0.0)
    return math.exp(-TEMPERING_EXPONENT * max(behind, 0.0))


def _remaining_modes(problems: Problems, shortlist: list[Refined], largest_error_m: float) -> _Selection:
    """The short-listed places that could still be the most probable, by a fit of each with more columns, the best first.

    A fit may end in a minor optimum. Each is therefore repeated from the same offset within its cell as the best one has.
    """
    if len(shortlist) == 1:
        return _Selection(shortlist, [])
    found = [refit(problems.middle, listed, largest_error_m, estimate_noise=True) for listed in shortlist]
    best = min(found, key=_by_odds)
    noise = rescaled_noise(1.0, best)
    found = [
        fit
        if fit is best
        else min(
            fit,
            refit(
                problems.middle,
                with_offset_of(fit, best, problems.middle.terrain),
                largest_error_m,
                estimate_noise=True,
                noise=noise,
            ),
            key=_by_odds,
        )
        for fit in found
    ]
    found = distinct(sorted(found, key=_by_odds), SAME_PLACE_CELLS)
    least = max(found[0].log_odds - MODE_NATS, LEAST_LOG_ODDS)
    count = min(max(1, sum(fit.log_odds >= least for fit in found)), MOST_MODES)
    return _Selection(found[:count], found[count:])


def _by_column_nll(fit: Refined) -> tuple[float, float, float]:
    return fit.mean_column_nll, fit.row, fit.col


def _by_odds(fit: Refined) -> tuple[float, float, float]:
    return -fit.log_odds, fit.row, fit.col


def _first_altitude(terrain: Terrain, observation: Observation, row: float, col: float) -> float:
    ground = float(terrain.dem.ground_m(row, col)) + observation.mast_height_m
    if observation.altitude_m is None:
        return ground
    weight = 1.0 / np.array([terrain.nominal_error_m, observation.altitude_sigma_m]) ** 2
    return float(weight @ [ground, observation.altitude_m] / weight.sum())
