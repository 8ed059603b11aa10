"""Stage 2 in rounds: a few columns of every cell, then more of the best ones, and what each round left out.

No round looks at where a cell lies in the DEM, only at how well it fits: two places with the same surroundings stay or go
together. A place that is as good as the one found in the end, but stands in its cell otherwise, has another disparity; how
probable it is that a round left such a place out follows from how far its limit lies above the disparity of the place found.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from localizer.dem.horizon import Terrain
from localizer.observation import Observation
from localizer.search.contours import STEP_DEG, MeasuredSkyline
from localizer.search.stage2 import ScoredCells, search_stage2

Floats = NDArray[np.float64]
Cells = NDArray[np.int64]

MANY_CELLS = 10000
"""Where stage 1 leaves more, all are compared by columns that are farther apart first, the farther the more cells there are."""
WIDEST_EVERY_DEG = 30.0
"""So far apart at most."""
LEAST_COLUMNS = 8
"""Of a narrow skyline columns are compared that are closer to each other, so that there are so many."""
HEADING_STEP_DEG = 2.0
"""Stage 2's hypotheses for the heading lie no further apart."""
SECTOR_DEG = 6.0
"""Columns closer to each other than this differ from a place's horizon by much the same."""
KEPT_SIGMAS = 6.0
"""Cells whose disparity lies within so many standard deviations of the best one go on to the next round."""
NEIGHBOUR_CELLS = 2.0


@dataclass(frozen=True)
class Round:
    """Columns ``every_deg`` apart are compared; at least ``least`` and at most ``most`` cells go on."""

    every_deg: float
    least: int
    most: int


EXTRA_ROUND = Round(12.0, 3000, 8000)
ROUNDS = (Round(6.0, 600, 2000), Round(2.0, 150, 600))


@dataclass(frozen=True)
class Cutoff:
    """The limit of one round.

    ``cells`` (n, 2) went on with their ``disparity`` (n,); the best one that did not has the disparity ``left_out``, infinite
    where all went on. ``sigma``: standard deviation of the difference between the disparities of two places that are equally
    good.
    """

    cells: Cells
    disparity: Floats
    best_rejected: float
    sigma: float

    def miss_probability(self, row: float, col: float) -> float:
        """Probability that a place as good as the one found at a position, if there is one, was left out."""
        if not np.isfinite(self.best_rejected) or len(self.cells) == 0:
            return 0.0
        off = np.hypot(*(self.cells - np.array([row, col])).T)
        here = float(self.disparity[off <= max(NEIGHBOUR_CELLS, float(off.min()) + 0.5)].min())
        return 0.5 * math.erfc((self.best_rejected - here) / (self.sigma * math.sqrt(2.0)))


@dataclass(frozen=True)
class RankedCells:
    """The best cells, and the limits of the rounds that they passed."""

    scored: ScoredCells
    cuts: tuple[Cutoff, ...]
    sigma: float
    """Of disparities by as many columns as the last round had; see ``Cut``."""


def likeliest_cells(
    terrain: Terrain,
    observation: Observation,
    skyline: MeasuredSkyline,
    cells: Cells,
    offsets: Floats,
) -> RankedCells:
    """The best of the cells (n, 2): few columns for all of them, many for the best of these."""
    relief = terrain.half_cell_relief_m
    if len(offsets) > 1 and offsets[1] - offsets[0] > HEADING_STEP_DEG:
        offsets = np.arange(offsets[0], offsets[-1], HEADING_STEP_DEG)
    seen_deg = np.count_nonzero(np.isfinite(skyline.elevation_deg)) * STEP_DEG
    sigma = 0.0
    cuts = []
    scored = ScoredCells(cells, np.zeros(0), np.zeros(0))
    for round_ in _rounds(len(cells)):
        every_deg = min(round_.every_deg, max(seen_deg / LEAST_COLUMNS, STEP_DEG))
        sigma = _disparity_sigma(seen_deg, every_deg)
        at = scored.cells[:, 0], scored.cells[:, 1]
        eye = terrain.height_m[at].astype(float) + observation.mast_height_m
        slack = relief[at].astype(float)
        if observation.altitude_m is not None:
            eye = np.clip(observation.altitude_m, eye - slack, eye + slack)
        scored = search_stage2(
            terrain,
            skyline,
            scored.cells,
            eye,
            slack,
            offsets,
            observation.azimuth_bias_sigma_deg,
            terrain.nominal_error_m,
            every_deg,
        )
        good = int(np.searchsorted(scored.disparity, scored.disparity[0] + KEPT_SIGMAS * sigma))
        keep = min(max(good, round_.least), round_.most)
        best_rejected = float(scored.disparity[keep]) if len(scored.cells) > keep else math.inf
        scored = ScoredCells(scored.cells[:keep], scored.disparity[:keep], scored.azimuth_bias_deg[:keep])
        cuts.append(Cutoff(scored.cells, scored.disparity, best_rejected, sigma))
    return RankedCells(scored, tuple(cuts), sigma)


def _disparity_sigma(seen_deg: float, every_deg: float) -> float:
    """By how much (one standard deviation) the disparities of two equally good places differ."""
    return math.sqrt(2.0 / max(seen_deg / max(every_deg, SECTOR_DEG), 1.0))


def _rounds(cells: int) -> tuple[Round, ...]:
    """One more where there are so many cells that each can be given a few columns only."""
    if cells <= MANY_CELLS:
        return ROUNDS
    every_deg = min(ROUNDS[0].every_deg * math.ceil(cells / MANY_CELLS), WIDEST_EVERY_DEG)
    return (replace(EXTRA_ROUND, every_deg=every_deg), *ROUNDS)
