"""Stage 2 in rounds: a few columns of every cell, then more of the best ones."""

import numpy as np
from numpy.typing import NDArray

from localizer.horizon.from_terrain import Terrain
from localizer.observation import Observation
from localizer.search.contours import MeasuredSkyline
from localizer.search.stage2 import Scored, search_stage2

Floats = NDArray[np.float64]

COLUMNS_EVERY_DEG = ((6.0, 600), (2.0, 150))
"""Stage 2's rounds: the columns' spacing, and how many cells go on to the next."""
MOST_CELLS = 30000
"""Where stage 1 leaves more, stage 2 first looks at every second cell, or third, and so on, and ..."""
PROMISING_CELLS = 1500
"""... then at all around the best of those."""
HEADING_STEP_DEG = 2.0
"""Stage 2's hypotheses for the heading lie no further apart."""


def likeliest_cells(
    terrain: Terrain,
    observation: Observation,
    skyline: MeasuredSkyline,
    cells: NDArray[np.int64],
    offsets: Floats,
) -> Scored:
    """The best of the cells (n, 2): few columns for all of them, many for the best of these."""
    relief = terrain.half_cell_relief_m
    if len(offsets) > 1 and offsets[1] - offsets[0] > HEADING_STEP_DEG:
        offsets = np.arange(offsets[0], offsets[-1], HEADING_STEP_DEG)

    def best(cells: NDArray[np.int64], every_deg: float, keep: int, spread: float = 1.0) -> Scored:
        at = cells[:, 0], cells[:, 1]
        eye = terrain.height_m[at].astype(float) + observation.mast_height_m
        slack = spread * relief[at].astype(float)
        if observation.altitude_m is not None:
            eye = np.clip(observation.altitude_m, eye - slack, eye + slack)
        scored = search_stage2(
            terrain,
            skyline,
            cells,
            eye,
            slack,
            offsets,
            observation.azimuth_bias_sigma_deg,
            terrain.usual_error_m,
            every_deg,
        )
        return Scored(scored.cells[:keep], scored.disparity[:keep], scored.azimuth_bias_deg[:keep])

    if len(cells) > MOST_CELLS:
        stride = int(np.ceil(np.sqrt(len(cells) / MOST_CELLS)))
        sparse = cells[(cells % stride == stride // 2).all(axis=1)]
        promising = best(sparse, COLUMNS_EVERY_DEG[0][0], PROMISING_CELLS, spread=float(stride)).cells
        cells = _around(cells, promising, terrain.height_m.shape, stride)
    for every_deg, keep in COLUMNS_EVERY_DEG:
        scored = best(cells, every_deg, keep)
        cells = scored.cells
    return scored


def _around(
    cells: NDArray[np.int64], centres: NDArray[np.int64], shape: tuple[int, ...], stride: int
) -> NDArray[np.int64]:
    """Those of ``cells`` (n, 2) that lie in the squares of ``stride`` cells a side around the centres (m, 2)."""
    near = np.zeros((shape[0] // stride + 1, shape[1] // stride + 1), bool)
    near[centres[:, 0] // stride, centres[:, 1] // stride] = True
    return cells[near[cells[:, 0] // stride, cells[:, 1] // stride]]
