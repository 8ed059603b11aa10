"""Sharp boundaries that are no skyline: the top of a cloud on a ridge, the edge of the sun's glare."""

import numpy as np
from numpy.typing import NDArray

from localizer.skyline.reduced_image import ReducedImage
from localizer.skyline.sky_boundary import SkyBoundary

_CLOUD_ROWS, _CLOUD_ODDS = 8, -2.5
"""Pixels brighter than the sky above are a cloud if the mean log-odds of so many rows are below this; snow has higher ones."""
_BURNT_OUT = 97.0
"""Lightness L of saturated pixels."""
_GLARE_ROWS, _GLARE_STEP, _GLARE_SHARE = 12, 2, 0.5
"""At the edge of a glare the lightness falls over many rows: less than this share of the fall is at the boundary itself."""
_MARGIN_COLUMNS = 3
"""Columns on either side that are flagged as well."""


def false_boundary_columns(work: ReducedImage, boundary: SkyBoundary) -> NDArray[np.bool_]:
    """Mask (w,) of the columns of the reduced image with such a boundary."""
    uncertain = _cloud_top(work, boundary) | _edge_of_glare(work, boundary.row)
    return np.convolve(uncertain, np.ones(2 * _MARGIN_COLUMNS + 1), "same") > 0.5


def _cloud_top(work: ReducedImage, boundary: SkyBoundary) -> NDArray[np.bool_]:
    h, w = boundary.generic_odds.shape
    columns = np.arange(w)
    below = np.minimum(boundary.row[None, :] + np.arange(_CLOUD_ROWS)[:, None], h - 1)
    mean_odds = boundary.generic_odds[below, columns].mean(axis=0)
    return np.asarray((work.step[boundary.row, columns] < 0) & (mean_odds < _CLOUD_ODDS))


def _edge_of_glare(work: ReducedImage, row: NDArray[np.int64]) -> NDArray[np.bool_]:
    h, w = work.texture.shape
    columns = np.arange(w)

    def lightness(offset: int) -> NDArray[np.float32]:
        return np.asarray(work.lab[np.clip(row + offset, 0, h - 1), columns, 0])

    above = lightness(-_GLARE_STEP - 1)
    at_edge, altogether = above - lightness(_GLARE_STEP), above - lightness(_GLARE_ROWS)
    return np.asarray((above > _BURNT_OUT) & (at_edge < _GLARE_SHARE * altogether))
