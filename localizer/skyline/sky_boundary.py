"""The boundary between sky and terrain in a reduced picture: what it costs, and the cheapest one.

A boundary is cheap where it runs along sharp edges, where what lies above it looks like sky and below like terrain, and
where it leaves no sharp edge above itself: of several ridges behind one another in the haze, the topmost is the skyline.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from localizer.jit import kernel
from localizer.skyline.boundary_path import min_marginals
from localizer.skyline.reduced_image import Floats, ReducedImage
from localizer.skyline.sky_colour import fitted_odds, generic_odds

# What follows was tuned on half of a set of photographs and rendered pictures. Costs are per column, or per pixel of one.
_NO_EDGE = 5.0
_FRAME_EDGE = 3.5
"""A boundary where there is no edge; a column without sky, or without terrain."""
_EDGE_POWER = 5.0
_LEFT_ABOVE = 1.77
_LEFT_ABOVE_FROM = 0.2
"""Each edge of full strength that lies above the boundary; how strong an edge has to be to count."""
_SIDE = 0.125
_SIDE_NO_EDGE = 4.1
"""The boundary going down the side of a pixel; as much again where there is no edge beside it."""
_STEP_NOISES = 3.9
_STEP_ACTIVITIES = 1.6
"""An edge of half strength is so many times the noise, plus so many times the mean step above it."""
_BRIGHTER_BELOW = 0.56
"""Factor on the strength of an edge that is brighter below: seldom a skyline, often the top of a cloud."""
_GUESS_ALONE = 0.006
_GUESS = 0.0216
_FITTED = 0.039
"""Per unit of log odds: the first guess in the first turn and in the later ones, the fitted models. Neighbouring pixels
say nearly the same, so each counts for little."""
_TURNS = 2
_LINE_FROM = 0.5
_LINE_SIDE = 0.5
_LEAVING = 0.05
"""A line above the boundary is followed where its edge is at least so strong; factor on the cost of its sides; what each
column costs on its way there."""
_FAINT_LINE_FROM, _FAINT, _FAINT_GAPS, _FAINT_COLUMNS = 0.15, 0.1, 0.2, 6
"""The same for faint lines, which count where the edge is stronger than the second number in all but the third's share of
a stretch of at least so many columns."""
_LONG_NOISES, _LONG_NOISE = 8.0, 1.2
_LONG_FROM, _LONG, _LONG_GAPS, _LONG_COLUMNS = 0.5, 0.4, 0.05, 40
"""The same for long lines, whose edge is held against the noise alone (at least so many grey levels): below a cloudy sky an
edge has to be strong to be taken for the skyline, but none that goes on so far can be passed over."""
_MEETING = 0.05
"""Share of the width that is in doubt as well to either side of a line above the boundary: it goes on closer to the boundary
than lines can be told apart."""
_SURELY_SKY, _SURELY_SKY_IN_DOUBT = 0.85, 0.5
"""The share of what lies above the boundary that the sky's model is fitted to; and when the boundary is put to the test."""


@dataclass(frozen=True)
class SkyBoundary:
    """The boundary in a reduced picture of h x w pixels.

    Attributes:
        row: (w,) it runs above this row: 0 is a column without sky, h one without terrain.
        margin: (w,) how much dearer the best boundary is that passes three rows off or more in this column.
        contested: (w,) whether the boundary moves when the sky's model is fitted to the upper half of its sky only, or
            a line leaves it that is sharp enough to be a farther ridge, pale as the sky in the haze or the glare.
        strength: (w,) how sharp the edge is that it follows, 0..1.
        odds: (h, w) log odds terrain : sky per pixel, the last used.
        guess: (h, w) the same before anything was learnt from the picture.
    """

    row: NDArray[np.int64]
    margin: Floats
    contested: NDArray[np.bool_]
    strength: Floats
    odds: Floats
    guess: Floats


def trace_boundary(work: ReducedImage) -> SkyBoundary:
    """Trace the boundary with the first guess of what sky looks like, then with models fitted to either side of it."""
    h, w = work.texture.shape
    strength, noise = edge_strength(work.step)
    side = _side_cost(work.lab, (4 * noise) ** 2)
    guess = generic_odds(work)

    def total_cost(odds: Floats) -> Floats:
        return min_marginals(_boundary_cost(strength, odds), side)

    def learnt(row: NDArray[np.int64], surely_sky: float) -> Floats:
        return np.float32(_GUESS) * guess + np.float32(_FITTED) * fitted_odds(work, row, surely_sky)

    odds = np.float32(_GUESS_ALONE) * guess
    total = total_cost(odds)
    row = total.argmin(axis=1)
    contested = np.zeros(w, np.bool_)
    if np.mean(row > 4) > 0.05 and np.mean(row < h - 4) > 0.05:
        for _ in range(_TURNS):
            odds = learnt(row, _SURELY_SKY)
            total = total_cost(odds)
            before, row = row, total.argmin(axis=1)
            if np.array_equal(row, before):
                break
        contested = np.abs(total_cost(learnt(row, _SURELY_SKY_IN_DOUBT)).argmin(axis=1) - row) > 2
        contested |= _farther_ridge(np.maximum(work.step, 0), noise, strength, side, row)
    columns = np.arange(w)
    best = total[columns, row].copy()
    total[np.abs(np.arange(h + 1)[None, :] - row[:, None]) < 3] = np.inf
    return SkyBoundary(row, total.min(axis=1) - best, contested, strength[row, columns], odds, guess)


def _farther_ridge(
    darker: Floats, noise: float, strength: Floats, side: Floats, row: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Columns (w,) where a line above the boundary may be the skyline: a sharp one, or a faint one that hardly breaks off.

    A ridge in the haze is faint all along; a streak of cloud is sharp here and gone there. ``darker`` is the colour step
    (h + 1, w) where it is darker below, as a ridge is, else 0.
    """
    edge = np.where(darker > 0, strength, 0)
    square, scale = darker * darker, np.float32(_LONG_NOISES * max(noise, _LONG_NOISE))
    plain = square / (square + scale * scale)
    beyond = row - _line_above(edge, side, row, _LINE_FROM) > 2
    beyond |= _unbroken(edge, side, row, _FAINT_LINE_FROM, _FAINT, _FAINT_GAPS, _FAINT_COLUMNS)
    beyond |= _unbroken(plain, side, row, _LONG_FROM, _LONG, _LONG_GAPS, _LONG_COLUMNS)
    beside = int(_MEETING * row.size)
    return np.asarray(np.convolve(beyond, np.ones(2 * beside + 1), "same") > 0.5)


def _unbroken(
    edge: Floats,
    side: Floats,
    row: NDArray[np.int64],
    line_from: float,
    least: float,
    gaps: float,
    columns: int,
) -> NDArray[np.bool_]:
    """Columns (w,) of the stretches, ``columns`` long or more, where the best line above hardly falls below ``least``."""
    found = np.zeros(row.size, np.bool_)
    line = _line_above(edge, side, row, line_from)
    ends = np.flatnonzero(np.diff(row - line > 2, prepend=False, append=False))
    for start, stop in zip(ends[::2], ends[1::2], strict=True):
        along = edge[line[start:stop], np.arange(start, stop)]
        found[start:stop] = stop - start >= columns and np.quantile(along, gaps) > least
    return found


def _line_above(strength: Floats, side: Floats, row: NDArray[np.int64], least: float) -> NDArray[np.int64]:
    """Rows (w,) of the best line that follows sharp edges above the boundary or, where there are none, the boundary itself.

    What lies between the two looks like sky, else the boundary would run there already; only the edge speaks against it.
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
    """Strength 0..1 of each boundary's colour step (h + 1, w) against noise and what goes on above; noise in grey levels."""
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
