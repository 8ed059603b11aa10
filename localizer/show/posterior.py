"""Posterior raster: the sum of the candidates' Gaussians, integrated over each cell of the DEM."""

from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO

import numpy as np
import rasterio
from affine import Affine
from numpy.typing import NDArray

from localizer.dem.geodesy import metric_to_rowcol
from localizer.dem.lattice import Dem
from localizer.show.candidates import CandidatePlace

Floats = NDArray[np.float64]

REACH_SIGMAS = 5.0
POINT_SPACING_CELLS = 0.2
FEWEST_POINTS, MOST_POINTS = 101, 1501
"""Per axis of an ellipse."""
MARGIN_CELLS = 8
"""Margin around the cells of non-negligible probability."""
SMALLEST_PROBABILITY = 1e-9
NODATA = -1.0


@dataclass(frozen=True)
class Posterior:
    """The part of the DEM's grid with non-negligible probability."""

    probability: NDArray[np.float32]
    """(rows, cols) of each cell; NODATA where the DEM is void."""
    first_row: int
    first_col: int

    @property
    def total(self) -> float:
        """Sum over all cells."""
        return float(self.probability[self.probability > 0.0].sum(dtype=np.float64))

    def transform(self, dem: Dem) -> Affine:
        """From (col, row) of a cell's corner in this part to x, y in the DEM's CRS."""
        return dem.transform @ Affine.translation(self.first_col, self.first_row)


def posterior(places: Sequence[CandidatePlace], dem: Dem) -> Posterior:
    """Integrate each place's Gaussian over the cells.

    Probability outside the DEM is omitted: the sum is the probability that the camera stands on the DEM.
    """
    cells, masses = zip(*(_spread(place, dem) for place in places), strict=True)
    rowcol, mass = np.concatenate(cells), np.concatenate(masses)
    if len(rowcol) == 0:  # all beyond the DEM: an empty part next to the most probable place
        rowcol = np.clip(np.round([[places[0].row, places[0].col]]), 0, (dem.rows - 1, dem.cols - 1))
        rowcol, mass = rowcol.astype(np.int64), np.zeros(1)
    first = np.maximum(rowcol.min(axis=0) - MARGIN_CELLS, 0)
    end = np.minimum(rowcol.max(axis=0) + MARGIN_CELLS + 1, (dem.rows, dem.cols))
    probability = np.zeros(end - first)
    np.add.at(probability, tuple((rowcol - first).T), mass)
    void = np.isnan(dem.z_m[first[0] : end[0], first[1] : end[1]])
    probability[void & (probability == 0.0)] = NODATA
    return Posterior(probability.astype(np.float32), int(first[0]), int(first[1]))


def _spread(place: CandidatePlace, dem: Dem) -> tuple[NDArray[np.int64], Floats]:
    """Cells (n, 2) of the DEM and the probability in each, by sampling a Gaussian along the axes of its ellipse.

    The spacing along each axis depends on the cells, so that very small and very elongated ellipses are integrated accurately.
    """
    step_m = 10.0
    row, col = metric_to_rowcol(
        dem,
        place.easting_m + step_m * np.array([1.0, -1.0, 0.0, 0.0]),
        place.northing_m + step_m * np.array([0.0, 0.0, 1.0, -1.0]),
    )
    to_cells = np.array([[row[0] - row[1], row[2] - row[3]], [col[0] - col[1], col[2] - col[3]]]) / (
        2 * step_m
    )
    variances, axes = np.linalg.eigh(to_cells @ place.here.map_covariance(place.covariance_m2) @ to_cells.T)
    axes = axes * np.sqrt(np.clip(variances, 0.0, None))
    along = []
    for i in range(2):
        points = 2.0 * REACH_SIGMAS * np.linalg.norm(axes[:, i]) / POINT_SPACING_CELLS
        along.append(
            np.linspace(-REACH_SIGMAS, REACH_SIGMAS, int(np.clip(points, FEWEST_POINTS, MOST_POINTS)))
        )
    first, second = np.meshgrid(*along, indexing="ij")
    mass = np.exp(-0.5 * (first**2 + second**2)).ravel()
    mass *= place.probability / mass.sum()
    points = axes @ np.stack([first.ravel(), second.ravel()]) + np.array([[place.row], [place.col]])
    cell = np.round(points).astype(np.int64)
    on_dem = ((cell >= 0) & (cell < [[dem.rows], [dem.cols]])).all(axis=0)
    if not on_dem.any():
        return np.zeros((0, 2), np.int64), np.zeros(0)
    cell, mass = cell[:, on_dem], mass[on_dem]
    low = cell.min(axis=1, keepdims=True)
    shape = tuple((cell.max(axis=1) - low[:, 0] + 1).tolist())
    sums = np.bincount(np.ravel_multi_index(tuple(cell - low), shape), mass)
    filled = np.flatnonzero(sums > SMALLEST_PROBABILITY)
    cells = np.stack(np.unravel_index(filled, shape), axis=1) + low.T
    return cells.astype(np.int64), np.asarray(sums[filled], np.float64)


def posterior_tif(posterior: Posterior, dem: Dem) -> bytes:
    """A GeoTIFF (float32, deflated) in the DEM's CRS."""
    buffer = BytesIO()
    rows, cols = posterior.probability.shape
    with rasterio.open(
        buffer,
        "w",
        driver="GTiff",
        height=rows,
        width=cols,
        count=1,
        dtype="float32",
        crs=rasterio.crs.CRS.from_user_input(dem.crs),
        transform=posterior.transform(dem),
        nodata=NODATA,
        compress="deflate",
        predictor=3,
    ) as dataset:
        dataset.write(posterior.probability, 1)
        dataset.set_band_description(1, "posterior probability of each cell")
    return buffer.getvalue()
