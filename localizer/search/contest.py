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
from localizer.search.compare import compared_alike, moved_to
from localizer.search.contours import FrameContour
from localizer.search.decide import SHARPNESS, Decision, decide, explains, nowhere, objection
from localizer.search.fit.local_optima import (
    SAME_PLACE_CELLS,
    Problems,
    again,
    best_nearby,
    distinct,
    noise_for,
    problems_of,
)
from localizer.search.fit.noise import usual_noise
from localizer.search.fit.problem import BLOCK_RAD
from localizer.search.fit.refine import Refined, refine
from localizer.search.reasons import off_the_dem
from localizer.search.rounds import Cut, Ranked
from localizer.search.stage2 import apart

STARTS, MOST_STARTS = 12, 64
"""Cells from which coarse fits start, at least and at most."""
START_SIGMAS = 4.0
"""A cell whose disparity is worse than that of the winner's cell by so many standard deviations is no start."""
START_RADIUS_CELLS = 1.5
CONTENDERS, MOST_CONTENDERS = 5, 12
CONTEST_MARGIN = 0.5
"""A start whose columns are less likely than the best one's by this much each (in logarithms) is no contender."""
CONTENDER_NATS = 12.0
"""The same of all independent columns together, where that allows more."""
CONTENDER_SHARE = 0.3
"""Or one whose log-odds are at least so much of the best one's."""
RIVAL_NATS = 30.0
"""A contender whose log-odds are worse than the best one's by this much is no rival."""
HIDDEN_NATS = 10.0
"""By so much the best place around one that was left out may be better."""
LEAST_LOG_ODDS = 5.0
"""Nor is one that explains hardly more than chance, unless it is the best."""
MOST_RIVALS = 4


@dataclass(frozen=True)
class _Field:
    """Those who are still in the contest, the best first, and those who were left out by a limit."""

    fits: list[Refined]
    left_out: list[Refined]


def contest(
    terrain: Terrain, observation: Observation, contours: tuple[FrameContour, ...], ranked: Ranked
) -> tuple[Decision, Refined | None]:
    """Refine the best cells, coarsely all, then the contenders under one error model, then the rivals with all columns."""
    largest = terrain.largest_error_m
    problems = problems_of(terrain, observation, contours)
    fits, cuts = _coarse_fits(terrain, observation, problems, ranked)
    contenders = _contenders(problems, fits, largest)
    rivals = _rivals(problems, contenders.fits, largest)
    best_of = [best_nearby(problems, rival, largest) for rival in rivals.fits]
    best_of = distinct(sorted(best_of, key=_by_misfit), SAME_PLACE_CELLS)
    compared = compared_alike(problems, best_of, largest)
    winner = compared[0].place
    missed = [cut.missed(winner.row, winner.col) for cut in cuts]
    left_out = [_weight(place, winner) for place in [*contenders.left_out, *rivals.left_out]]
    elsewhere = 1.0 - math.prod(1.0 - share for share in missed) + sum(left_out)
    against = objection(winner, largest, _priors(contours), _skyline_deg(problems))
    if against is None and not terrain.dem.covers(winner.row, winner.col):
        against = off_the_dem()
    if against is not None:
        return nowhere(against), None
    decision = decide([c.log_mass for c in compared], [c.place for c in compared], terrain.cell_m, elsewhere)
    return decision, decision.candidates[0]


def sharpened(
    terrain: Terrain, observation: Observation, contours: tuple[FrameContour, ...], best: Refined
) -> Refined:
    """The best place around one that was found with doubts about the DEM, by its word alone; the old one where that fits badly.

    What is close by shows the last metres of the way, and misleads whoever is farther off.
    """
    problems = problems_of(terrain, observation, contours)
    largest = problems.full.largest_error_m
    there = best_nearby(problems, best, largest)
    stays = np.hypot(there.row - best.row, there.col - best.col) <= SAME_PLACE_CELLS
    return replace(there, dem_error_m=0.0) if stays and explains(there, largest, _priors(contours)) else best


def _priors(contours: tuple[FrameContour, ...]) -> int:
    """How many readings there are: altitude, the ground's, both biases, and three for each frame."""
    return 2 + 2 + 3 * len(contours)


def _skyline_deg(problems: Problems) -> float:
    """How much of the horizon was seen."""
    return float(np.degrees(len(problems.full.blocks) * BLOCK_RAD))


def _coarse_fits(
    terrain: Terrain, observation: Observation, problems: Problems, ranked: Ranked
) -> tuple[list[Refined], list[Cut]]:
    """Fits with few columns from the best cells, the best fit first, and all limits that cells had to pass on the way.

    From as many cells as are no worse than the winner's own by START_SIGMAS.
    """
    scored = ranked.scored
    order = apart(scored, len(scored.cells), START_RADIUS_CELLS)
    disparity = scored.disparity[order]
    fitted: list[tuple[Refined, float]] = []
    wanted, least = _no_worse(disparity, float(disparity[0]), ranked.sigma), STARTS
    while len(fitted) < min(max(wanted, least), MOST_STARTS, len(order)):
        i = order[len(fitted)]
        fit = _coarse_fit(terrain, observation, problems, scored.cells[i], float(scored.azimuth_bias_deg[i]))
        fitted.append((fit, float(scored.disparity[i])))
        if len(fitted) >= max(wanted, least):
            _, here = min(fitted, key=lambda entry: _by_misfit(entry[0]))
            wanted = _no_worse(disparity, here, ranked.sigma)
    count = len(fitted)
    left_out = float(disparity[count]) if count < len(order) else math.inf
    cut = Cut(scored.cells[order[:count]], disparity[:count], left_out, ranked.sigma)
    return sorted((fit for fit, _ in fitted), key=_by_misfit), [*ranked.cuts, cut]


def _no_worse(disparity: NDArray[np.float64], than: float, sigma: float) -> int:
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
        noise=usual_noise(terrain, 2.0 * terrain.usual_error_m),
        largest_dem_error_m=terrain.largest_error_m,
        settle=True,
    )


def _contenders(problems: Problems, fits: list[Refined], largest: float) -> _Field:
    """The places that the best coarse fits lead to when they are continued, the best first."""
    promising = _within(
        distinct(fits, SAME_PLACE_CELLS), 2.0 * CONTEST_MARGIN, problems, MOST_CONTENDERS, CONTENDERS
    )
    continued = [again(problems.coarse, fit, largest, settle=True, iterations=8) for fit in promising.fits]
    places = distinct(sorted(continued, key=_by_misfit), SAME_PLACE_CELLS)
    contenders = _within(places, CONTEST_MARGIN, problems, MOST_CONTENDERS)
    return _Field(contenders.fits, [*promising.left_out, *contenders.left_out])


def _within(fits: list[Refined], margin: float, problems: Problems, most: int, least: int = 1) -> _Field:
    """Those of the fits (the best first) whose columns are little less likely than the best one's, or which explain a lot."""
    best = fits[0]
    independent = len(problems.coarse.sigma_rad) / best.correlation_columns
    furthest = best.misfit_per_column + max(margin, CONTENDER_NATS / independent)
    odds = max(LEAST_LOG_ODDS, CONTENDER_SHARE * max(fit.log_odds for fit in fits))
    stays = [
        i < least or fit.misfit_per_column <= furthest or fit.log_odds >= odds for i, fit in enumerate(fits)
    ]
    kept = [fit for fit, stay in zip(fits, stays, strict=True) if stay]
    rest = [fit for fit, stay in zip(fits, stays, strict=True) if not stay]
    return _Field(kept[:most], [*kept[most:], *rest])


def _weight(left_out: Refined, winner: Refined) -> float:
    """Of a place that was not compared, where the winner's is 1; one no likelier than chance counts as chance."""
    behind = winner.log_odds - HIDDEN_NATS - max(left_out.log_odds, 0.0)
    return math.exp(-SHARPNESS * max(behind, 0.0))


def _rivals(problems: Problems, contenders: list[Refined], largest: float) -> _Field:
    """The contenders that could still be the likeliest place, by a fit of each with more columns, the best first.

    A fit may have stopped at a lesser peak: each is also made from where the best of them lies in its cell.
    """
    if len(contenders) == 1:
        return _Field(contenders, [])
    found = [again(problems.middle, contender, largest, settle=True) for contender in contenders]
    best = min(found, key=_by_odds)
    noise = noise_for(1.0, best)
    found = [
        fit
        if fit is best
        else min(
            fit,
            again(
                problems.middle,
                moved_to(fit, best, problems.middle.terrain),
                largest,
                settle=True,
                noise=noise,
            ),
            key=_by_odds,
        )
        for fit in found
    ]
    found = distinct(sorted(found, key=_by_odds), SAME_PLACE_CELLS)
    least = max(found[0].log_odds - RIVAL_NATS, LEAST_LOG_ODDS)
    count = min(max(1, sum(fit.log_odds >= least for fit in found)), MOST_RIVALS)
    return _Field(found[:count], found[count:])


def _by_misfit(fit: Refined) -> tuple[float, float, float]:
    return fit.misfit_per_column, fit.row, fit.col


def _by_odds(fit: Refined) -> tuple[float, float, float]:
    return -fit.log_odds, fit.row, fit.col


def _first_altitude(terrain: Terrain, observation: Observation, row: float, col: float) -> float:
    ground = float(terrain.dem.ground_m(row, col)) + observation.mast_height_m
    if observation.altitude_m is None:
        return ground
    weight = 1.0 / np.array([terrain.usual_error_m, observation.altitude_sigma_m]) ** 2
    return float(weight @ [ground, observation.altitude_m] / weight.sum())
