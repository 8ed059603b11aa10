"""The sky-terrain boundary in the reduced image: its cost function, and the boundary of minimum cost.

The cost is low along strong edges, with sky-like pixels above and terrain-like pixels below, and without strong edges above: of
several ridges behind one another in haze, the topmost is the skyline.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from localizer.jit import kernel
from localizer.skyline.boundary_path import min_marginals
from localizer.skyline.reduced_image import Floats, ReducedImage
from localizer.skyline.sky_colour import fitted_odds, generic_log_odds

# Tuned on half of a set of photographs and rendered images (docs/photographs.md). Costs are per column or per pixel.
_NO_EDGE = 5.0
_FRAME_EDGE = 3.5
"""Cost of a boundary without an edge; cost of a column without sky or without terrain."""
_EDGE_POWER = 5.0
_LEFT_ABOVE = 1.77
_LEFT_ABOVE_FROM = 0.2
"""Cost of each edge of full strength above the boundary; least strength of an edge that counts."""
_SIDE = 0.125
_SIDE_NO_EDGE = 4.1
"""Cost of a vertical pixel side of the boundary; additional cost without a vertical edge there."""
_STEP_NOISES = 3.9
_STEP_ACTIVITIES = 1.6
"""An edge has strength 0.5 if its step is the first number times (noise + the second number times the mean step above it)."""
_BRIGHTER_BELOW = 0.56
"""Factor on the strength of an edge that is brighter below: rarely a skyline, often the top of a cloud."""
_GENERIC_ALONE = 0.006
_GENERIC = 0.0216
_FITTED = 0.039
"""Cost per unit of log-odds: generic odds in the first iteration and in later ones, fitted odds. The weights are small because
neighbouring pixels are highly correlated."""
_ITERATIONS = 2
_LINE_FROM = 0.5
_LINE_SIDE = 0.5
_LEAVING = 0.05
"""A line above the boundary: least edge strength, factor on the cost of vertical sides, cost per column of the transition to
it."""
_FAINT_LINE_FROM, _FAINT, _FAINT_GAPS, _FAINT_COLUMNS = 0.15, 0.1, 0.2, 6
"""Faint lines: least edge strength to follow one; strength that must be exceeded except for this share of gaps, in a stretch
of at least so many columns."""
_LONG_NOISES, _LONG_NOISE = 8.0, 1.2
_LONG_FROM, _LONG, _LONG_GAPS, _LONG_COLUMNS = 0.5, 0.4, 0.05, 40
"""Long lines: the same with edge strength relative to the noise alone (at least so many grey levels). Below a cloudy sky an
edge must be strong to be the skyline, but a line of this length is significant even if it is weak."""
_UNCERTAIN_MARGIN = 0.05
"""Share of the width on either side of such a line that is uncertain as well: there the line is too close to the boundary to be
resolved."""
_SKY_SHARE, _SKY_SHARE_TEST = 0.85, 0.5
"""Share of the pixels above the boundary that the sky's model is fitted to: when tracing, and when testing the boundary's
stability."""


@dataclass(frozen=True)
class SkyBoundary:
    """The boundary in a reduced picture of h x w pixels.

    Attributes:
        row: (w,) it runs above this row: 0 is a column without sky, h one without terrain.
        margin: (w,) additional cost of the best boundary that is three or more rows away in this column.
        uncertain: (w,) whether the boundary moves if the sky's model is fitted to the upper half of the sky only, or a line
            above it may be a more distant ridge, pale in haze or glare.
        strength: (w,) strength of the edge along the boundary, 0..1.
        odds: (h, w) log odds terrain : sky per pixel, the last used.
        generic_odds: (h, w) the same by the generic model.
    """

    row: NDArray[np.int64]
    margin: Floats
    uncertain: NDArray[np.bool_]
    strength: Floats
    odds: Floats
    generic_odds: Floats


def trace_boundary(work: ReducedImage) -> SkyBoundary:
    """Trace the boundary with the generic model, then with models fitted to either side of it."""
    h, w = work.texture.shape
    strength, noise = edge_strength(work.step)
    side = _side_cost(work.lab, (4 * noise) ** 2)
    generic_odds = generic_log_odds(work)

    def total_cost(odds: Floats) -> Floats:
        return min_marginals(_boundary_cost(strength, odds), side)

    def fitted(row: NDArray[np.int64], sky_share: float) -> Floats:
        return np.float32(_GENERIC) * generic_odds + np.float32(_FITTED) * fitted_odds(work, row, sky_share)

    odds = np.float32(_GENERIC_ALONE) * generic_odds
    total = total_cost(odds)
    row = total.argmin(axis=1)
    uncertain = np.zeros(w, np.bool_)
    if np.mean(row > 4) > 0.05 and np.mean(row < h - 4) > 0.05:
        for _ in range(_ITERATIONS):
            odds = fitted(row, _SKY_SHARE)
            total = total_cost(odds)
            previous, row = row, total.argmin(axis=1)
            if np.array_equal(row, previous):
                break
        uncertain = np.abs(total_cost(fitted(row, _SKY_SHARE_TEST)).argmin(axis=1) - row) > 2
        uncertain |= _farther_ridge(np.maximum(work.step, 0), noise, strength, side, row)
    columns = np.arange(w)
    best = total[columns, row].copy()
    total[np.abs(np.arange(h + 1)[None, :] - row[:, None]) < 3] = np.inf
    return SkyBoundary(row, total.min(axis=1) - best, uncertain, strength[row, columns], odds, generic_odds)


def _farther_ridge(
    darker: Floats, noise: float, strength: Floats, side: Floats, row: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Mask (w,) of columns where a line above the boundary may be the skyline: a sharp one, or a faint one without gaps.

    A ridge in haze is faint but continuous; a streak of cloud has gaps. ``darker``: the colour step (h + 1, w) where it is
    darker below, as at a ridge, else 0.
    """
    edge = np.where(darker > 0, strength, 0)
    square, scale = darker * darker, np.float32(_LONG_NOISES * max(noise, _LONG_NOISE))
    plain = square / (square + scale * scale)
    above_boundary = row - _line_above(edge, side, row, _LINE_FROM) > 2
    above_boundary |= _unbroken(edge, side, row, _FAINT_LINE_FROM, _FAINT, _FAINT_GAPS, _FAINT_COLUMNS)
    above_boundary |= _unbroken(plain, side, row, _LONG_FROM, _LONG, _LONG_GAPS, _LONG_COLUMNS)
    beside = int(_UNCERTAIN_MARGIN * row.size)
    return np.asarray(np.convolve(above_boundary, np.ones(2 * beside + 1), "same") > 0.5)


def _unbroken(
    edge: Floats,
    side: Floats,
    row: NDArray[np.int64],
    line_from: float,
    least: float,
    gaps: float,
    columns: int,
) -> NDArray[np.bool_]:
    """Mask (w,) of stretches, ``columns`` or longer, where the best line above exceeds ``least`` but for a share ``gaps``."""
    found = np.zeros(row.size, np.bool_)
    line = _line_above(edge, side, row, line_from)
    ends = np.flatnonzero(np.diff(row - line > 2, prepend=False, append=False))
    for start, stop in zip(ends[::2], ends[1::2], strict=True):
        along = edge[line[start:stop], np.arange(start, stop)]
        found[start:stop] = stop - start >= columns and np.quantile(along, gaps) > least
    return found


def _line_above(strength: Floats, side: Floats, row: NDArray[np.int64], least: float) -> NDArray[np.int64]:
    """Rows (w,) of the best line along edges above the boundary, or of the boundary itself where there are none.

    The pixels between the two look like sky, otherwise the boundary would be there; only the edge is evidence for terrain.
    """
    h, w = strength.shape[0] - 1, row.size
    gain = strength.T - np.float32(least)
    cost = np.where(gain > 0, -gain, -2 * gain)
    up = row[:, None] - np.arange(h + 1)[None, :]
    cost[up < 3] = 1e4
    cost[:, :3] = 1e4
    cost[(up == 1) | (up == 2)] = _LEAVING
    cost[np.arange(w), row] = 0
    cost32 = np.ascontiguousarray(cost, dtype=np.float32)
    return np.asarray(min_marginals(cost32, np.float32(_LINE_SIDE) * side).argmin(axis=1))


def edge_strength(step: Floats) -> tuple[Floats, float]:
    """Strength 0..1 of each colour step (h + 1, w) relative to the noise and to the steps above it; noise in grey levels."""
    size = np.abs(step)
    noise = max(float(np.percentile(size[1 : max(2, step.shape[0] // 2)], 25)), 0.5)
    around = np.asarray(cv2.blur(size, (9, 9)), np.float32)
    above = np.vstack([np.repeat(around[:1], 7, axis=0), around[:-7]])
    scale = np.float32(_STEP_NOISES) * (np.float32(noise) + np.float32(_STEP_ACTIVITIES) * above)
    square = size * size
    strength = square / (square + scale * scale)
    return np.where(step < 0, np.float32(_BRIGHTER_BELOW) * strength, strength), noise


@kernel()
def _boundary_cost(strength: Floats, odds: Floats) -> Floats:
    """Cost of the boundary at each row of each column, (w, h + 1); `strength` (h + 1, w), `odds` (h, w)."""
    h, w = odds.shape
    out = np.empty((w, h + 1), np.float32)
    for x in range(w):
        above = np.float32(0)
        left = np.float32(0)
        out[x, 0] = _FRAME_EDGE
        for r in range(1, h + 1):
            above += odds[r - 1, x] + left
            left = np.float32(0)
            s = strength[r - 1, x]
            # an edge counts as left above by boundaries two rows below it or more
            if r >= 2 and s > _LEFT_ABOVE_FROM and s >= strength[r - 2, x] and s > strength[r, x]:
                left = np.float32(_LEFT_ABOVE * (s - _LEFT_ABOVE_FROM) / (1 - _LEFT_ABOVE_FROM))
            own = _FRAME_EDGE if r == h else _NO_EDGE * (1 - strength[r, x]) ** _EDGE_POWER
            out[x, r] = above + np.float32(own)
    return out


@kernel()
def _side_cost(lab: Floats, scale: float) -> Floats:
    """Cost of the boundary running down between two columns, per row: (w - 1, h); less where their colours differ."""
    h, w = lab.shape[:2]
    out = np.empty((w - 1, h), np.float32)
    for x in range(w - 1):
        for r in range(h):
            square = np.float32(0)
            for c in range(3):
                square += (lab[r, x + 1, c] - lab[r, x, c]) ** 2
            out[x, r] = _SIDE + _SIDE_NO_EDGE * scale / (scale + square)
    return out
