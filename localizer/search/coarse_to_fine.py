"""Stage 2 from coarse to fine: all cells at few azimuths, then the best cells at more.

A round keeps cells by their disparity alone, never by their position: two places with the same surroundings stay or go
together. Disparities are noisy, because a camera can stand anywhere in its cell. How probable it is that a round cut a place
as good as the one found follows from the distance between the round's cutoff and the disparity of the place found:

    P = 0.5 erfc((cutoff - disparity) / (sqrt(2) sigma)),    sigma^2 = 2 / (number of independent sectors).
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
"""If stage 1 leaves more cells, an extra first round compares all of them at fewer azimuths, in proportion to their number."""
WIDEST_EVERY_DEG = 30.0
"""Largest spacing of the azimuths in that round."""
LEAST_COLUMNS = 8
"""A narrow skyline is compared at a closer spacing, so that it has at least so many columns."""
HEADING_STEP_DEG = 2.0
"""Largest spacing of the heading hypotheses."""
SECTOR_DEG = 6.0
"""Columns within such a sector have about the same residual and count as one sample. Tuned on the simulated cases of
``sim evaluate``. Sensitivity: not measured yet (``sim sensitivity``)."""
KEPT_SIGMAS = 6.0
"""Cells whose disparity lies within so many standard deviations of the best one go on to the next round. Tuned on the scenario
``twins``: a twin of the true place must not be cut. Sensitivity: not measured yet (``sim sensitivity``)."""
NEIGHBOUR_CELLS = 2.0
"""Kept cells within this distance of a place tell its disparity."""


@dataclass(frozen=True)
class Round:
    """Azimuths ``every_deg`` apart are compared; at least ``least`` and at most ``most`` cells go on."""

    every_deg: float
    least: int
    most: int


EXTRA_ROUND = Round(12.0, 3000, 8000)
ROUNDS = (Round(6.0, 600, 2000), Round(2.0, 150, 600))


@dataclass(frozen=True)
class Cutoff:
    """The cutoff of one round.

    ``cells`` (n, 2) went on with their ``disparity`` (n,). ``best_rejected`` is the lowest disparity of a cell that did not,
    infinite if all went on. ``sigma``: standard deviation of the difference between the disparities of two equally good places.
    """

    cells: Cells
    disparity: Floats
    best_rejected: float
    sigma: float

    def miss_probability(self, row: float, col: float) -> float:
        """Probability that a place as good as the one found at a position, if there is one, was cut."""
        if not np.isfinite(self.best_rejected) or len(self.cells) == 0:
            return 0.0
        off = np.hypot(*(self.cells - np.array([row, col])).T)
        here = float(self.disparity[off <= max(NEIGHBOUR_CELLS, float(off.min()) + 0.5)].min())
        return 0.5 * math.erfc((self.best_rejected - here) / (self.sigma * math.sqrt(2.0)))


@dataclass(frozen=True)
class RankedCells:
    """The best cells, and the cutoffs of the rounds that they passed."""

    scored: ScoredCells
    cutoffs: tuple[Cutoff, ...]
    sigma: float
    """As ``Cutoff.sigma``, for the columns of the last round."""


def likeliest_cells(
    terrain: Terrain,
    observation: Observation,
    skyline: MeasuredSkyline,
    cells: Cells,
    offsets: Floats,
) -> RankedCells:
    """The best of the cells (n, 2), in order."""
    relief = terrain.half_cell_relief_m
    if len(offsets) > 1 and offsets[1] - offsets[0] > HEADING_STEP_DEG:
        offsets = np.arange(offsets[0], offsets[-1], HEADING_STEP_DEG)
    seen_deg = np.count_nonzero(np.isfinite(skyline.elevation_deg)) * STEP_DEG
    sigma = 0.0
    cutoffs = []
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
        cutoffs.append(Cutoff(scored.cells, scored.disparity, best_rejected, sigma))
    return RankedCells(scored, tuple(cutoffs), sigma)


def _disparity_sigma(seen_deg: float, every_deg: float) -> float:
    """Standard deviation of the difference between the disparities of two equally good places."""
    return math.sqrt(2.0 / max(seen_deg / max(every_deg, SECTOR_DEG), 1.0))


def _rounds(cells: int) -> tuple[Round, ...]:
    """The rounds for a number of cells; an extra first one if there are very many."""
    if cells <= MANY_CELLS:
        return ROUNDS
    every_deg = min(ROUNDS[0].every_deg * math.ceil(cells / MANY_CELLS), WIDEST_EVERY_DEG)
    return (replace(EXTRA_ROUND, every_deg=every_deg), *ROUNDS)
