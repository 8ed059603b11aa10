"""Comparison of places by Bayesian evidence: with the same columns, from the same starts, each under its own error model."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from localizer.dem.horizon import Terrain
from localizer.search.decide import log_mass
from localizer.search.fit.local_optima import refit, rescaled_noise
from localizer.search.fit.outliers import informative_columns
from localizer.search.fit.problem import Problem
from localizer.search.fit.problems import Problems, has_edge_columns, problems_of
from localizer.search.fit.refine import Refined
from localizer.search.fit.residuals import evaluate, residual_sigma

Floats = NDArray[np.float64]

COMPARISON_ROUNDS = 2
"""How often each place is refitted from the offsets of the others. Tuned on the scenario ``twins``.
Sensitivity: not measured yet (``sim sensitivity``)."""
DECIDED_NATS = 15.0
"""A place that leads by this much needs no further comparison. Tuned on the scenario ``twins``. Sensitivity: not measured yet
(``sim sensitivity``)."""
EXPLAINED_SIGMAS = 3.0
"""A place explains a stretch of the horizon if the median residual is smaller."""
GROSS_SIGMAS = 6.0
"""A median residual larger than this and than GROSS_RAD is a gross error. Tuned on the scenario ``twins``.
Sensitivity: not measured yet (``sim sensitivity``)."""
GROSS_RAD = np.radians(1.0)
"""No error of a DEM is as large. Tuned on the scenario ``twins``. Sensitivity: not measured yet (``sim sensitivity``)."""
LEAST_INFORMATIVE_SHARE = 0.7
"""Only stretches with at least this share of informative columns are judged."""
PARTS_PER_SECTOR = 3
"""Stretches in a sector of SECTOR_RAD: a summit is narrower than a sector."""
GROSS_NATS = 10.0
"""Penalty for a gross error over a whole sector that another place explains. Tuned on the scenario ``twins``.
Sensitivity: not measured yet (``sim sensitivity``)."""


@dataclass(frozen=True)
class Compared:
    """A place with its unnormalised log-probability."""

    place: Refined
    log_mass: float


def compare_on_same_columns(problems: Problems, places: Sequence[Refined], largest: float) -> list[Compared]:
    """The places, the most probable first, by fits of each with the same columns.

    If the likelihood has several optima close together, it is a matter of chance which of them a fit reaches. Each place is
    therefore also fitted from the others' offsets within the cell and under their error models; its best fit counts.
    Columns at the DEM edge are either left out or used, whichever is more likely, so that a place near the edge has no
    disadvantage.
    """
    if len(places) == 1:
        return [Compared(places[0], 0.0)]
    starts = [(place, rescaled_noise(problems.middle.stride, place)) for place in places]

    def mass(fit: Refined) -> float:
        return log_mass(fit, problems.full.terrain.cell_m)

    best = list(places)
    column_sets = _with_and_without_edge_columns(problems, places)
    for _ in range(COMPARISON_ROUNDS):
        masses = sorted(map(mass, best), reverse=True)
        if masses[0] - masses[1] > DECIDED_NATS:
            break
        best = [
            max(
                (
                    refit(problem, with_offset_of(place, other, problem.terrain), largest, noise=noise)
                    for other, noise in starts
                    for problem in column_sets
                ),
                key=mass,
            )
            for place in places
        ]
        starts = [(fit, rescaled_noise(1.0, fit)) for fit in best]
    gross = _gross_errors(problems.middle, best)
    compared = [
        Compared(place, mass(fit) - GROSS_NATS * float(stretches))
        for place, fit, stretches in zip(places, best, gross, strict=True)
    ]
    return sorted(compared, key=lambda c: (-c.log_mass, c.place.row, c.place.col))


def _gross_errors(problem: Problem, fits: Sequence[Refined]) -> Floats:
    """Length of horizon, in sectors, (k,) with a gross error at each place that another place explains.

    No place explains a tree or a cloud. A stretch that one place explains and another misses by more than any DEM error
    is evidence that robust fitting alone would discard as an outlier.
    """
    stretches = [
        part for block in problem.sectors for part in np.array_split(block, PARTS_PER_SECTOR) if len(part)
    ]
    sigmas, off_rad = np.array([_stretch_medians(problem, stretches, fit) for fit in fits]).transpose(1, 0, 2)
    with np.errstate(invalid="ignore"):
        explained = (sigmas < EXPLAINED_SIGMAS).any(axis=0)
        missed = (sigmas > GROSS_SIGMAS) & (off_rad > GROSS_RAD)
    share = np.array([len(part) for part in stretches]) / problem.sector_columns
    return np.asarray((missed & explained) @ share)


def _stretch_medians(problem: Problem, stretches: list[NDArray[np.int64]], fit: Refined) -> Floats:
    """Absolute median residual of each stretch (2, n), in standard deviations and in radians.

    NaN for stretches with few informative columns.
    """
    coefficients = problem.terrain.geodesics.at(fit.row, fit.col)[0]
    evaluation = evaluate(problem, fit.parameters(), (fit.row, fit.col), coefficients)
    sigma = residual_sigma(problem, evaluation, fit.dem_error_m)
    informative = informative_columns(evaluation, sigma)
    off = np.abs(
        [[np.median((evaluation.residual / sigma)[s]), np.median(evaluation.residual[s])] for s in stretches]
    )
    informative_stretch = np.array(
        [informative[stretch].mean() > LEAST_INFORMATIVE_SHARE for stretch in stretches]
    )
    return np.asarray(np.where(informative_stretch, off.T, np.nan))


def _with_and_without_edge_columns(problems: Problems, places: Sequence[Refined]) -> tuple[Problem, ...]:
    """The problem without columns at the DEM edge, and, if any place has such columns, also with them."""
    full = problems.full
    if not any(has_edge_columns(full, place) for place in places):
        return (problems.middle,)
    with_edge = problems_of(full.terrain, full.observation, tuple(full.contours), uses_edge_columns=True)
    return (problems.middle, with_edge.middle)


def with_offset_of(place: Refined, other: Refined, terrain: Terrain) -> Refined:
    """A place moved to the offset within its cell that another place has in its own, at the same height above the ground."""
    row = other.row + round(place.row - other.row)
    col = other.col + round(place.col - other.col)
    rise_m = float(terrain.dem.ground_m(row, col)) - float(terrain.dem.ground_m(other.row, other.col))
    altitude_m = other.altitude_m + rise_m if np.isfinite(rise_m) else place.altitude_m
    return replace(place, row=row, col=col, altitude_m=altitude_m)
