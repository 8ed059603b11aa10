"""Places compared on the same terms: by the same columns, from the same starts, each under its own errors."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from localizer.horizon.from_terrain import Terrain
from localizer.search.decide import log_mass
from localizer.search.nearby import Problems, again, problems_of, sees_rim
from localizer.search.noise import Noise
from localizer.search.problem import Problem
from localizer.search.refine import Refined

COMPARISONS = 2
"""How often each rival is fitted from where the others were fitted."""
DECIDED_NATS = 15.0
"""A place that is ahead by this much needs no further comparison."""


def compared_alike(
    problems: Problems, places: Sequence[Refined], largest: float
) -> list[tuple[Refined, Refined]]:
    """The places, the likeliest first, each behind its fit with the columns that all of them are compared by.

    Where the likelihood has several peaks close to each other, which of them a fit ends at is chance. So each place is also
    fitted from where the others lie in their cells and under their errors, and its likeliest fit counts. Where the DEM ends,
    the horizon is its last terrain or something behind it, whichever is likelier: no place pays for lying near the end.
    """
    cell_m = problems.full.terrain.cell_m

    def mass(fit: Refined) -> float:
        return log_mass(fit, cell_m)

    best = list(places)
    starts = [(place, noise_for(problems.middle.stride, place)) for place in places]
    by_columns = _with_and_without_rim(problems, places)
    for _ in range(COMPARISONS):
        masses = sorted(map(mass, best), reverse=True)
        if len(masses) == 1 or masses[0] - masses[1] > DECIDED_NATS:
            break
        best = [
            max(
                (
                    again(problem, moved_to(place, other, problem.terrain), largest, noise=noise)
                    for other, noise in starts
                    for problem in by_columns
                ),
                key=mass,
            )
            for place in places
        ]
        starts = [(fit, noise_for(1.0, fit)) for fit in best]
    pairs = list(zip(best, places, strict=True))
    return sorted(pairs, key=lambda pair: (-mass(pair[0]), pair[1].row, pair[1].col))


def _with_and_without_rim(problems: Problems, places: Sequence[Refined]) -> tuple[Problem, ...]:
    """The columns without those whose horizon lies where the DEM ends, and with them where any place has such columns."""
    full = problems.full
    if not any(sees_rim(full, place) for place in places):
        return (problems.middle,)
    believing = problems_of(full.terrain, full.observation, tuple(full.contours), believes_rim=True)
    return (problems.middle, believing.middle)


def moved_to(place: Refined, other: Refined, terrain: Terrain) -> Refined:
    """A place moved to where another one lies in its cell, as high above the ground."""
    row = other.row + round(place.row - other.row)
    col = other.col + round(place.col - other.col)
    rise_m = float(terrain.dem.ground_m(row, col)) - float(terrain.dem.ground_m(other.row, other.col))
    altitude_m = other.altitude_m + rise_m if np.isfinite(rise_m) else place.altitude_m
    return replace(place, row=row, col=col, altitude_m=altitude_m)


def noise_for(thinning: float, fit: Refined) -> Noise:
    """The noise of a fit, for a problem with fewer columns by a factor."""
    return Noise(fit.dem_error_m, max(1.0, fit.correlation_columns / thinning), fit.error_model)
