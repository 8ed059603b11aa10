"""Narrow things with steep sides on the skyline: a bush, a tree, a mast. The terrain's skyline is behind them."""

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_WIDTHS = (0.02, 0.045, 0.09, 0.16)
"""Of the picture's width: what is wider than the last counts as terrain. Narrow things are taken off before wider ones."""
_LOWEST = 0.006
"""Of the picture's width: what stands out less is left alone."""
_BOTH_STEEP = 1.2
_ONE_STEEP, _OTHER_STEEP = 2.0, 0.7
"""Rows per column of the flanks: both, or one of them more and the other less; a flank outside the picture counts as the
lesser. Hillsides from afar are rarely so steep."""


def foreground_columns(row_px: Floats) -> NDArray[np.bool_]:
    """Columns where something narrow with two steep flanks rises above the rest of the skyline.

    Args:
        row_px: (width,) rows of the skyline, finite.
    """
    width = row_px.size
    flagged = np.zeros(width, np.bool_)
    row = row_px.astype(np.float32)
    least = max(2.5, _LOWEST * width)
    pad = 2 + round(0.003 * width)
    for share in _WIDTHS:
        span = max(3, round(share * width) | 1)
        without = cv2.morphologyEx(row[None, :], cv2.MORPH_CLOSE, np.ones((1, span), np.uint8))[0]
        excess = np.asarray(without - row, np.float64)
        bounds = np.flatnonzero(np.diff(np.concatenate(([False], excess > 0.5, [False])).astype(np.int8)))
        for start, stop in zip(bounds[::2], bounds[1::2], strict=True):
            part = excess[start:stop]
            left = _OTHER_STEEP if start == 0 else _flank(part)
            right = _OTHER_STEEP if stop == width else _flank(part[::-1])
            less, more = min(left, right), max(left, right)
            steep = less >= _BOTH_STEEP or (less >= _OTHER_STEEP and more >= _ONE_STEEP)
            if steep and part.max() >= least:
                flagged[max(0, start - pad) : stop + pad] = True
                row[start:stop] = without[start:stop]
    return flagged


def _flank(height: Floats) -> float:
    """Slope of the rise from the left foot to the top, over the steepest stretch that makes up half of it."""
    rise = np.maximum.accumulate(np.concatenate(([0.0], height[: int(height.argmax()) + 1])))
    half = 0.5 * rise[-1]
    reached = np.searchsorted(rise, rise + half)
    inside = reached < rise.size
    return float((half / np.maximum(reached - np.arange(rise.size), 0.5))[inside].max())
