"""The paper's own estimate (section IV-B): the grid point whose horizon has the least mean square disparity from the contours.

Only ``sim paper`` uses it, to show what the refinement adds.
"""

import numpy as np
from numpy.typing import NDArray

from localizer.dem.horizon import Terrain, horizon_tangents
from localizer.observation import Observation
from localizer.search.contours import BINS, STEP_DEG, frame_contour, measured_skyline
from localizer.search.stage1 import heading_offsets_deg
from localizer.search.stage2 import search_stage2

CANDIDATES = 600
COLUMNS_EVERY_DEG = 6.0


def grid_only_estimate(
    terrain: Terrain, observation: Observation, cells: NDArray[np.int64]
) -> tuple[int, int]:
    """Row and column of the cell, among those that stage 1 left (n, 2), with the lowest mean square disparity.

    The camera is taken to stand on the grid point at the mast's height, with the measured heading. The CANDIDATES cells with
    the lowest robust disparity are compared in full.
    """
    skyline = measured_skyline(observation, tuple(frame_contour(f) for f in observation.frames))
    eye = terrain.height_m[cells[:, 0], cells[:, 1]].astype(float) + observation.mast_height_m
    near = search_stage2(
        terrain,
        skyline,
        cells,
        eye,
        np.full(len(cells), 3.0),
        heading_offsets_deg(0.0),
        0.0,
        0.0,
        COLUMNS_EVERY_DEG,
    ).cells[:CANDIDATES]
    seen = np.nonzero(np.isfinite(skyline.elevation_deg))[0]
    row, col = near[:, 0].astype(float), near[:, 1].astype(float)
    eye = terrain.height_m[near[:, 0], near[:, 1]].astype(float) + observation.mast_height_m
    azimuth = np.radians(np.broadcast_to(seen % BINS * STEP_DEG, (len(near), len(seen))))
    tangent, _ = horizon_tangents(terrain, row, col, eye, azimuth)
    disparity = ((np.degrees(np.arctan(tangent)) - skyline.elevation_deg[seen]) ** 2).mean(axis=1)
    best = int(np.argmin(disparity))
    return int(near[best, 0]), int(near[best, 1])
