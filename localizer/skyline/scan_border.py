"""The border around a picture that was scanned or framed: even, of one colour, on all four sides. It is no sky."""

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]

_ALIKE = 30
"""Levels, in each channel, by which the paper differs from its median colour."""
_SHARE = 0.97
"""Of a row or column that are alike, for it to be border: paper has spots and captions."""
_LEAST_INSIDE = 0.25
_LEAST_SIDE_PX = 20
"""The share of the picture, and the pixels a side, that must remain: else it is empty rather than framed."""


def inside_border(image_bgr: Image) -> tuple[slice, slice]:
    """Rows and columns of the picture within its border; all of them where it has none on one of its sides.

    Args:
        image_bgr: (height, width, 3).
    """
    height, width = image_bgr.shape[:2]
    everything = slice(0, height), slice(0, width)
    rim = np.concatenate([image_bgr[0], image_bgr[-1], image_bgr[:, 0], image_bgr[:, -1]]).astype(np.int16)
    paper = np.median(rim, axis=0).astype(np.int16)
    if _same_place(rim, paper).mean() < _SHARE:
        return everything
    alike = _same_place(image_bgr.astype(np.int16), paper)
    rows = np.flatnonzero(alike.mean(axis=1) < _SHARE)
    if rows.size == 0:
        return everything
    top, bottom = int(rows[0]), int(rows[-1]) + 1
    columns = np.flatnonzero(alike[top:bottom].mean(axis=0) < _SHARE)
    if columns.size == 0:
        return everything
    left, right = int(columns[0]), int(columns[-1]) + 1
    framed = min(top, height - bottom, left, width - right) > 0
    share = (bottom - top) * (right - left) / (height * width)
    if not framed or share < _LEAST_INSIDE or min(bottom - top, right - left) < _LEAST_SIDE_PX:
        return everything
    # where paper and picture meet, a pixel or two are of neither
    margin = min(2, (bottom - top) // 16, (right - left) // 16)
    return slice(top + margin, bottom - margin), slice(left + margin, right - margin)


def _same_place(colours: NDArray[np.int16], paper: NDArray[np.int16]) -> NDArray[np.bool_]:
    return np.asarray((np.abs(colours - paper) <= _ALIKE).all(axis=-1))
