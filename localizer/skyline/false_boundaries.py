"""Boundaries that are sharp enough and yet no skyline: the top of a cloud on the ridge, the rim of the sun's glare."""

import numpy as np
from numpy.typing import NDArray

from localizer.skyline.reduced_image import ReducedImage
from localizer.skyline.sky_boundary import SkyBoundary

_CLOUD_ROWS, _CLOUD_GUESS = 8, -2.5
"""What is brighter than the sky above it is a cloud if so many rows of it look like sky by these log odds; snow does not."""
_BURNT_OUT = 97.0
"""Lightness L of what has no colour left."""
_GLARE_ROWS, _GLARE_STEP, _GLARE_SHARE = 12, 2, 0.5
"""At the rim of a glare the light falls off over more than that many rows: less than this share of it happens at the edge."""
_BESIDE = 3
"""Columns to either side that are in doubt as well."""


def false_boundary_columns(work: ReducedImage, boundary: SkyBoundary) -> NDArray[np.bool_]:
    """Columns (w,) of the reduced picture where the boundary is one of these."""
    doubtful = _cloud_top(work, boundary) | _rim_of_glare(work, boundary.row)
    return np.convolve(doubtful, np.ones(2 * _BESIDE + 1), "same") > 0.5


def _cloud_top(work: ReducedImage, boundary: SkyBoundary) -> NDArray[np.bool_]:
    h, w = boundary.guess.shape
    columns = np.arange(w)
    below = np.minimum(boundary.row[None, :] + np.arange(_CLOUD_ROWS)[:, None], h - 1)
    looks = boundary.guess[below, columns].mean(axis=0)
    return np.asarray((work.step[boundary.row, columns] < 0) & (looks < _CLOUD_GUESS))


def _rim_of_glare(work: ReducedImage, row: NDArray[np.int64]) -> NDArray[np.bool_]:
    h, w = work.texture.shape
    columns = np.arange(w)

    def lightness(offset: int) -> NDArray[np.float32]:
        return np.asarray(work.lab[np.clip(row + offset, 0, h - 1), columns, 0])

    above = lightness(-_GLARE_STEP - 1)
    at_edge, altogether = above - lightness(_GLARE_STEP), above - lightness(_GLARE_ROWS)
    return np.asarray((above > _BURNT_OUT) & (at_edge < _GLARE_SHARE * altogether))
