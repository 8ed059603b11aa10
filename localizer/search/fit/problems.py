"""The estimation problem of one standpoint at several numbers of columns, and without the columns at the DEM edge."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from localizer.dem.horizon import Terrain
from localizer.observation import Observation
from localizer.search.contours import FrameContour
from localizer.search.fit.problem import Problem
from localizer.search.fit.refine import Refined
from localizer.search.fit.residuals import evaluate

COARSE_COLUMNS = 120
"""Columns of all frames together in coarse fits and on grids. Tuned on time. Sensitivity: not measured yet (``sim
sensitivity``)."""
MIDDLE_COLUMNS = 480
"""Columns in comparisons of places. Tuned on time. Sensitivity: not measured yet (``sim sensitivity``)."""
FINE_COLUMNS = 1000
"""Columns in the fits that distinguish the optima around one place. Tuned on time. Sensitivity: not measured yet (``sim
sensitivity``)."""
LEAST_COLUMNS = 30
"""Fewer columns cannot determine a place."""


@dataclass(frozen=True)
class Problems:
    """The problem of one standpoint at four numbers of columns."""

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
    """The problems of one standpoint; the options are those of ``Problem``."""
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
    """The problems without the columns that lie at the DEM edge as seen from a place; unchanged if too few are left.

    Places close together are then compared on the same columns. A sector that lost columns keeps its nominal number of
    columns, so that the rest of it does not gain weight (effective sample size).
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
    """Whether the predicted horizon of any column lies at the DEM edge."""
    return bool(_edge_columns(problem, place).any())


def _edge_columns(problem: Problem, place: Refined) -> NDArray[np.bool_]:
    coefficients = problem.terrain.geodesics.at(place.row, place.col)[0]
    return evaluate(problem, place.parameters(), (place.row, place.col), coefficients).dem_edge
