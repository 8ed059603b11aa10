"""Places compared on the same terms: by the same columns, from the same starts, each under its own errors."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from localizer.dem.horizon import Terrain
from localizer.search.decide import log_mass
from localizer.search.fit.local_optima import Problems, has_edge_columns, problems_of, refit, rescaled_noise
from localizer.search.fit.outliers import informative_columns
from localizer.search.fit.problem import Problem
from localizer.search.fit.refine import Refined
from localizer.search.fit.residuals import evaluate, residual_sigma

Floats = NDArray[np.float64]

COMPARISON_ROUNDS = 2
"""How often each rival is fitted from where the others were fitted."""
DECIDED_NATS = 15.0
"""A place that is ahead by this much needs no further comparison."""
EXPLAINED_SIGMAS = 3.0
GROSS_SIGMAS = 6.0
GROSS_RAD = np.radians(1.0)
LEAST_INFORMATIVE_SHARE = 0.7
"""A stretch is explained, or missed by far, by its median in standard deviations and by angle, if so much of it is terrain."""
PARTS_PER_SECTOR = 3
"""Of a stretch of BLOCK_RAD: a summit is narrower."""
GROSS_NATS = 10.0
"""What it costs to miss BLOCK_RAD by far that another place explains."""


@dataclass(frozen=True)
class Compared:
    """A place with the logarithm of its probability but for a constant."""

    place: Refined
    log_mass: float


def compare_on_same_columns(problems: Problems, places: Sequence[Refined], largest: float) -> list[Compared]:
    """The places, the likeliest first, by fits of each with the same columns.

    Where the likelihood has several peaks close to each other, which of them a fit ends at is chance. So each place is also
    fitted from where the others lie in their cells and under their errors, and its likeliest fit counts. Where the DEM ends,
    the horizon is its last terrain or something behind it, whichever is likelier: no place pays for lying near the end.
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
    """How many stretches of the horizon (k,) each place misses by far that another one explains, in stretches of BLOCK_RAD.

    A stretch that shows a tree or a cloud is nobody's skyline. One that a place explains column by column is no accident, and
    no error of the DEM is as large.
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
    """By how much the middle column of each stretch is off (2, n), in standard deviations and in radians.

    NaN where few of its columns show terrain.
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
    """The columns without those whose horizon lies where the DEM ends, and with them where any place has such columns."""
    full = problems.full
    if not any(has_edge_columns(full, place) for place in places):
        return (problems.middle,)
    with_edge = problems_of(full.terrain, full.observation, tuple(full.contours), uses_edge_columns=True)
    return (problems.middle, with_edge.middle)


def with_offset_of(place: Refined, other: Refined, terrain: Terrain) -> Refined:
    """A place moved to where another one lies in its cell, as high above the ground."""
    row = other.row + round(place.row - other.row)
    col = other.col + round(place.col - other.col)
    rise_m = float(terrain.dem.ground_m(row, col)) - float(terrain.dem.ground_m(other.row, other.col))
    altitude_m = other.altitude_m + rise_m if np.isfinite(rise_m) else place.altitude_m
    return replace(place, row=row, col=col, altitude_m=altitude_m)
