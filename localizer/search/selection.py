"""The contest of the places that stage 2 found likeliest: who takes part, on what terms, and what the winner is worth.

All are treated alike, whatever their order. Coarse fits choose the contenders; fits with more columns choose the rivals, those
that could still be the likeliest; the best place around each rival is found with all columns, its errors estimated there; these
places are compared by the same columns. What a limit left out keeps its probability: that of all places that were not compared.
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
    Problems,
    best_local_optimum,
    distinct,
    problems_of,
    refit,
    rescaled_noise,
)
from localizer.search.fit.noise import initial_noise
from localizer.search.fit.problem import SECTOR_RAD
from localizer.search.fit.refine import Refined, refine
from localizer.search.reasons import beyond_dem
from localizer.search.stage2 import suppress_neighbours

STARTS = 12
MOST_STARTS = 64
"""Cells from which coarse fits start, at least and at most."""
START_SIGMAS = 4.0
"""A cell whose disparity is worse than that of the winner's cell by so many standard deviations is no start."""
START_RADIUS_CELLS = 1.5
SHORTLIST = 5
MOST_SHORTLISTED = 12
SHORTLIST_COLUMN_NATS = 0.5
"""A start whose columns are less likely than the best one's by this much each (in logarithms) is no contender."""
SHORTLIST_NATS = 12.0
"""The same of all independent columns together, where that allows more."""
SHORTLIST_ODDS_SHARE = 0.3
"""Or one whose log-odds are at least so much of the best one's."""
MODE_NATS = 30.0
"""A contender whose log-odds are worse than the best one's by this much is no rival."""
UNREFINED_GAIN_NATS = 10.0
"""By so much the best place around one that was left out may be better."""
LEAST_LOG_ODDS = 5.0
"""Nor is one that explains hardly more than chance, unless it is the best."""
MOST_MODES = 4


@dataclass(frozen=True)
class _Selection:
    """Those who are still in the contest, the best first, and those who were left out by a limit."""

    fits: list[Refined]
    rejected: list[Refined]


def select_place(
    terrain: Terrain, observation: Observation, contours: tuple[FrameContour, ...], ranked: RankedCells
) -> tuple[Decision, Refined | None]:
    """Refine the best cells, coarsely all, then the contenders under one error model, then the rivals with all columns."""
    largest_error_m = terrain.largest_error_m
    problems = problems_of(terrain, observation, contours)
    fits, cuts = _coarse_fits(terrain, observation, problems, ranked)
    shortlist = _shortlist(problems, fits, largest_error_m)
    modes = _remaining_modes(problems, shortlist.fits, largest_error_m)
    optima = [best_local_optimum(problems, rival, largest_error_m) for rival in modes.fits]
    optima = distinct(sorted(optima, key=_by_column_nll), SAME_PLACE_CELLS)
    compared = compare_on_same_columns(problems, optima, largest_error_m)
    best = compared[0].place
    miss_probability = [cut.miss_probability(best.row, best.col) for cut in cuts]
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
    """The best place around one that was found with doubts about the DEM, by its word alone; the old one where that fits badly.

    What is close by shows the last metres of the way, and misleads whoever is farther off.
    """
    problems = problems_of(terrain, observation, contours)
    largest_error_m = problems.full.largest_error_m
    there = best_local_optimum(problems, best, largest_error_m)
    stays = np.hypot(there.row - best.row, there.col - best.col) <= SAME_PLACE_CELLS
    return (
        replace(there, dem_error_m=0.0)
        if stays and is_plausible(there, largest_error_m, _priors(contours))
        else best
    )


def _priors(contours: tuple[FrameContour, ...]) -> int:
    """How many readings there are: altitude, the ground's, both biases, and three for each frame."""
    return 2 + 2 + 3 * len(contours)


def _skyline_deg(problems: Problems) -> float:
    """How much of the horizon was seen."""
    return float(np.degrees(len(problems.full.sectors) * SECTOR_RAD))


def _coarse_fits(
    terrain: Terrain, observation: Observation, problems: Problems, ranked: RankedCells
) -> tuple[list[Refined], list[Cutoff]]:
    """Fits with few columns from the best cells, the best fit first, and all limits that cells had to pass on the way.

    From as many cells as are no worse than the winner's own by START_SIGMAS.
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
            _, here = min(fitted, key=lambda entry: _by_column_nll(entry[0]))
            wanted = _count_within(disparity, here, ranked.sigma)
    count = len(fitted)
    rejected = float(disparity[count]) if count < len(order) else math.inf
    cut = Cutoff(scored.cells[order[:count]], disparity[:count], rejected, ranked.sigma)
    return sorted((fit for fit, _ in fitted), key=_by_column_nll), [*ranked.cuts, cut]


def _count_within(disparity: NDArray[np.float64], than: float, sigma: float) -> int:
    return int(np.searchsorted(disparity, than + START_SIGMAS * sigma))


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
    """The places that the best coarse fits lead to when they are continued, the best first."""
    first_list = _within(
        distinct(fits, SAME_PLACE_CELLS), 2.0 * SHORTLIST_COLUMN_NATS, problems, MOST_SHORTLISTED, SHORTLIST
    )
    continued = [
        refit(problems.coarse, fit, largest_error_m, estimate_noise=True, iterations=8)
        for fit in first_list.fits
    ]
    places = distinct(sorted(continued, key=_by_column_nll), SAME_PLACE_CELLS)
    shortlist = _within(places, SHORTLIST_COLUMN_NATS, problems, MOST_SHORTLISTED)
    return _Selection(shortlist.fits, [*first_list.rejected, *shortlist.rejected])


def _within(fits: list[Refined], margin: float, problems: Problems, most: int, least: int = 1) -> _Selection:
    """Those of the fits (the best first) whose columns are little less likely than the best one's, or which explain a lot."""
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
    """Of a place that was not compared, where the winner's is 1; one no likelier than chance counts as chance."""
    behind = best.log_odds - UNREFINED_GAIN_NATS - max(rejected.log_odds, 0.0)
    return math.exp(-TEMPERING_EXPONENT * max(behind, 0.0))


def _remaining_modes(problems: Problems, shortlist: list[Refined], largest_error_m: float) -> _Selection:
    """The contenders that could still be the likeliest place, by a fit of each with more columns, the best first.

    A fit may have stopped at a lesser peak: each is also made from where the best of them lies in its cell.
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
