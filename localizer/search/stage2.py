"""Stage 2, the paper's section IV-B: curve matching, the whole skyline against the horizon of each cell.

The paper's mean square disparity is replaced by a robust negative log-likelihood (errata, gap 7). With the difference d of
observed and predicted elevation, and its variance s^2, a column costs

    0.5 u / (1 + u / c^2) + 0.5 ln s^2,    u = d^2 / s^2    (Geman-McClure, scale c),

which is bounded, so that a tree or a cloud taken for a ridge cannot outweigh the rest. s^2 contains the position of the camera
within its cell, which matters for near terrain. The minimum over the hypotheses for the heading's bias counts: a bias
shifts the curve along the azimuth.
"""

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from localizer.dem.horizon import Heights, Terrain, ray_horizon
from localizer.jit import kernel
from localizer.search.contours import BINS, STEP_DEG, MeasuredSkyline

Floats = NDArray[np.float64]
Cells = NDArray[np.int64]

GEMAN_MCCLURE_SIGMAS = 4.0
"""Scale c of the Geman-McClure loss, in standard deviations. Tuned on the simulated cases of ``sim evaluate`` (clouds,
foreground). Sensitivity: halved, places move by 0.4 sigma, sigmas change by the factor 4.9; doubled, places move by 0.1
sigma, sigmas change by the factor 1.1 (docs/sensitivity.md)."""


@dataclass(frozen=True)
class ScoredCells:
    """Cells (n, 2) with their disparity (n,), lowest first, and the bias of the heading that gives it.

    The disparity is the mean negative log-likelihood of the columns.
    """

    cells: Cells
    disparity: Floats
    azimuth_bias_deg: Floats


def search_stage2(
    terrain: Terrain,
    skyline: MeasuredSkyline,
    cells: Cells,
    eye_m: Floats,
    eye_slack_m: Floats,
    offsets_deg: Floats,
    azimuth_bias_sigma_deg: float,
    dem_error_m: float,
    every_deg: float,
) -> ScoredCells:
    """Disparity of each cell over columns ``every_deg`` apart; ``eye_m`` (n,) the camera's altitude there."""
    shifts = np.round(offsets_deg / STEP_DEG).astype(np.int64)
    seen = np.isfinite(skyline.elevation_deg)
    # True azimuths at which some hypothesis has a measured column.
    reached = np.zeros(BINS, bool)
    for shift in shifts:
        reached |= np.roll(seen, -shift)
    stride = max(1, round(every_deg / STEP_DEG))
    world = np.nonzero(reached & (np.arange(BINS) % stride == 0))[0]
    prior = (
        0.5 * (offsets_deg / max(azimuth_bias_sigma_deg, 1e-6)) ** 2
        if azimuth_bias_sigma_deg < 90.0
        else 0.0 * offsets_deg
    )
    row, col = cells[:, 0].astype(float), cells[:, 1].astype(float)
    disparity, best = _disparities(
        terrain.height_m,
        terrain.cell_ceiling_m,
        terrain.row_blocks,
        terrain.col_blocks,
        terrain.highest_m,
        terrain.drop_per_m2,
        terrain.geodesics.at(row, col),
        row,
        col,
        eye_m,
        eye_slack_m + dem_error_m,
        np.radians(skyline.elevation_deg),
        np.radians(skyline.sigma_deg),
        world.astype(np.int64),
        shifts,
        prior,
        np.radians(STEP_DEG),
    )
    order = _by_disparity(cells, disparity)
    return ScoredCells(cells[order], disparity[order], offsets_deg[best[order]])


@kernel(parallel=True)
def _disparities(
    height: Heights,
    cell_ceilings: Heights,
    row_blocks: Heights,
    col_blocks: Heights,
    highest: float,
    drop: float,
    coefficients: Floats,
    row: Floats,
    col: Floats,
    eye: Floats,
    slack: Floats,
    elevation: Floats,
    sigma: Floats,
    world: NDArray[np.int64],
    shifts: NDArray[np.int64],
    prior: Floats,
    step: float,
) -> tuple[Floats, NDArray[np.int64]]:
    cells, columns, hypotheses = row.shape[0], world.shape[0], shifts.shape[0]
    bins = elevation.shape[0]
    lowest = np.empty(cells)
    which = np.zeros(cells, np.int64)
    for n in numba.prange(cells):
        horizon = np.empty(columns)
        distance = np.empty(columns)
        s = np.nan
        for m in range(columns):
            tangent, s = ray_horizon(
                height,
                cell_ceilings,
                row_blocks,
                col_blocks,
                highest,
                drop,
                coefficients[n],
                row[n],
                col[n],
                eye[n],
                world[m] * step,
                s,
                0.0,
            )
            horizon[m] = np.arctan(tangent)
            distance[m] = s
        lowest[n] = np.inf
        for k in range(hypotheses):
            total, count = 0.0, 0
            for m in range(columns):
                at = (world[m] + shifts[k]) % bins
                observed = elevation[at]
                if np.isnan(observed):
                    continue
                count += 1
                spread = slack[n] / distance[m] if distance[m] > 0.0 else 0.0
                variance = sigma[at] * sigma[at] + spread * spread
                residual = (observed - horizon[m]) ** 2 / variance
                # The normalisation: without it a place with a large variance would always fit.
                total += 0.5 * (
                    residual / (1.0 + residual / (GEMAN_MCCLURE_SIGMAS * GEMAN_MCCLURE_SIGMAS))
                    + np.log(variance)
                )
            if count == 0:
                continue
            disparity = total / count + prior[k] / count
            if disparity < lowest[n]:
                lowest[n], which[n] = disparity, k
    return lowest, which


def suppress_neighbours(scored: ScoredCells, keep: int, radius_cells: float) -> NDArray[np.int64]:
    """Non-maximum suppression: indices of the best cells, no two within ``radius_cells``, ``keep`` at most, the best first."""
    chosen: list[int] = []
    for i in _by_disparity(scored.cells, scored.disparity):
        if all(np.hypot(*(scored.cells[i] - scored.cells[j])) > radius_cells for j in chosen):
            chosen.append(int(i))
            if len(chosen) == keep:
                break
    return np.array(chosen, np.int64)


def _by_disparity(cells: Cells, disparity: Floats) -> NDArray[np.int64]:
    """Indices of the cells, the best first; ties are ordered by position, so that the order of the input does not matter."""
    return np.lexsort((cells[:, 1], cells[:, 0], disparity))
