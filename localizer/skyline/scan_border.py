"""The uniform border of a scanned or framed picture, on all four sides. It must not be taken for sky."""

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]

_BORDER_LEVELS = 30
"""Largest difference, in each channel, of border pixels from the median colour of the border."""
_BORDER_SHARE = 0.97
"""Share of a row or column that must have the border's colour: borders have spots and captions."""
_LEAST_INSIDE = 0.25
_LEAST_SIDE_PX = 20
"""Least share of the picture, and least side in pixels, inside the border: else the picture is empty rather than framed."""


def inside_border(image_bgr: Image) -> tuple[slice, slice]:
    """Rows and columns of the picture within its border; all of them where it has none on one of its sides.

    Args:
        image_bgr: (height, width, 3).
    """
    height, width = image_bgr.shape[:2]
    everything = slice(0, height), slice(0, width)
    outermost = np.concatenate([image_bgr[0], image_bgr[-1], image_bgr[:, 0], image_bgr[:, -1]]).astype(
        np.int16
    )
    border_colour = np.median(outermost, axis=0).astype(np.int16)
    if _same_place(outermost, border_colour).mean() < _BORDER_SHARE:
        return everything
    is_border = _same_place(image_bgr.astype(np.int16), border_colour)
    rows = np.flatnonzero(is_border.mean(axis=1) < _BORDER_SHARE)
    if rows.size == 0:
        return everything
    top, bottom = int(rows[0]), int(rows[-1]) + 1
    columns = np.flatnonzero(is_border[top:bottom].mean(axis=0) < _BORDER_SHARE)
    if columns.size == 0:
        return everything
    left, right = int(columns[0]), int(columns[-1]) + 1
    framed = min(top, height - bottom, left, width - right) > 0
    share = (bottom - top) * (right - left) / (height * width)
    if not framed or share < _LEAST_INSIDE or min(bottom - top, right - left) < _LEAST_SIDE_PX:
        return everything
    # a pixel or two at the inner edge are a mixture of border and picture
    margin = min(2, (bottom - top) // 16, (right - left) // 16)
    return slice(top + margin, bottom - margin), slice(left + margin, right - margin)


def _same_place(colours: NDArray[np.int16], border_colour: NDArray[np.int16]) -> NDArray[np.bool_]:
    return np.asarray((np.abs(colours - border_colour) <= _BORDER_LEVELS).all(axis=-1))
