"""Foreground objects: narrow objects with steep sides (bush, tree, mast) that occlude the terrain's skyline."""

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_WIDTHS = (0.02, 0.045, 0.09, 0.16)
"""Widths of objects as shares of the image width, removed from narrow to wide; wider ones count as terrain."""
_LEAST_HEIGHT = 0.006
"""Least height of an object, as a share of the image width."""
_BOTH_STEEP = 1.2
_ONE_STEEP, _OTHER_STEEP = 2.0, 0.7
"""Slopes of the flanks, rows per column: both at least the first, or one at least the second and the other the third. A flank
outside the image has the third. Distant hillsides are rarely so steep."""


def foreground_columns(row_px: Floats) -> NDArray[np.bool_]:
    """Mask of the columns where a narrow object with two steep flanks rises above the skyline (morphological closing).

    Args:
        row_px: (width,) rows of the skyline, finite.
    """
    width = row_px.size
    flagged = np.zeros(width, np.bool_)
    row = row_px.astype(np.float32)
    least = max(2.5, _LEAST_HEIGHT * width)
    pad = 2 + round(0.003 * width)
    for share in _WIDTHS:
        span = max(3, round(share * width) | 1)
        closed = cv2.morphologyEx(row[None, :], cv2.MORPH_CLOSE, np.ones((1, span), np.uint8))[0]
        excess = np.asarray(closed - row, np.float64)
        bounds = np.flatnonzero(np.diff(np.concatenate(([False], excess > 0.5, [False])).astype(np.int8)))
        for start, stop in zip(bounds[::2], bounds[1::2], strict=True):
            part = excess[start:stop]
            left = _OTHER_STEEP if start == 0 else _flank(part)
            right = _OTHER_STEEP if stop == width else _flank(part[::-1])
            less, more = min(left, right), max(left, right)
            steep = less >= _BOTH_STEEP or (less >= _OTHER_STEEP and more >= _ONE_STEEP)
            if steep and part.max() >= least:
                flagged[max(0, start - pad) : stop + pad] = True
                row[start:stop] = closed[start:stop]
    return flagged


def _flank(height: Floats) -> float:
    """Slope of the left flank, over the steepest part that makes up half of its height."""
    rise = np.maximum.accumulate(np.concatenate(([0.0], height[: int(height.argmax()) + 1])))
    half = 0.5 * rise[-1]
    reached = np.searchsorted(rise, rise + half)
    inside = reached < rise.size
    return float((half / np.maximum(reached - np.arange(rise.size), 0.5))[inside].max())
