"""Skyline detection: the sub-pixel row of the sky-terrain boundary in each column, with a confidence.

The boundary is traced in a reduced image (`sky_boundary`) and located to sub-pixels in the full image (`edge_position`). Then
it is classified: whether the image has a skyline at all, whether foreground objects occlude it (`foreground_objects`),
whether the boundary is of another kind (`false_boundaries`).
"""

import math
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from localizer.skyline.edge_position import refine_edge
from localizer.skyline.false_boundaries import false_boundary_columns
from localizer.skyline.foreground_objects import foreground_columns
from localizer.skyline.reduced_image import ReducedImage, reduce_image
from localizer.skyline.scan_border import inside_border
from localizer.skyline.sky_boundary import SkyBoundary, trace_boundary

CONFIDENT = 0.5
"""Columns with at least this confidence are what the search uses."""
LEAST_PX = 16
"""Least width and height of an image that is examined."""


class ColumnState(IntEnum):
    """What a column of the picture shows.

    ``OK``: a skyline. ``NO_SKY`` and ``NO_TERRAIN``: only the other. ``DOUBTFUL``: a boundary that may be something else, a
    tree or a cloud.
    """

    OK = 0
    NO_SKY = 1
    NO_TERRAIN = 2
    DOUBTFUL = 3


@dataclass(frozen=True)
class Skyline:
    """The boundary between sky (above) and terrain (below), one entry per image column.

    Attributes
    ----------
    row_px : ndarray of float, shape (width,)
        Row of the edge, pixel centres at whole numbers (between row 99 and row 100 is 99.5); NaN where none.
    sigma_px : ndarray of float, shape (width,)
        One standard deviation of ``row_px``, given that the boundary traced is the right one; NaN where none.
    confidence : ndarray of float, shape (width,)
        0 to 1, how sure it is that the boundary traced is the terrain's skyline; 0 where none.
    state : ndarray of uint8, shape (width,)
        What the column shows, a `ColumnState`.
    """

    row_px: NDArray[np.float64]
    sigma_px: NDArray[np.float64]
    confidence: NDArray[np.float64]
    state: NDArray[np.uint8]


def find_skyline(image_bgr: NDArray[np.uint8]) -> Skyline:
    """Find the skyline in a picture.

    Parameters
    ----------
    image_bgr : ndarray of uint8, shape (height, width, 3)
        Blue, green, red, as OpenCV reads pictures; turn an RGB picture with ``image[..., ::-1]``. The sky is at the top.

    Returns
    -------
    Skyline
        Arrays with an entry for each column. A picture without a skyline has ``NO_SKY`` or ``NO_TERRAIN`` in all columns, one
        of less than 16 pixels in height or width ``NO_TERRAIN``; the border around a scanned one has ``NO_SKY``.

    Raises
    ------
    ValueError
        The array has another shape or type.

    Notes
    -----
    The boundary is traced in a reduced picture by dynamic programming and placed to a fraction of a pixel in the full one.
    Trust columns whose state is ``OK``: their confidence is at least 0.5.

    Examples
    --------
    >>> bundle = localizer.load_bundle("bundles/first")
    >>> image_bgr = localizer.frame_image(bundle, bundle.frames[0])
    >>> skyline = localizer.find_skyline(image_bgr)
    >>> skyline.row_px.shape
    (640,)
    >>> bool((skyline.state == localizer.ColumnState.OK).mean() > 0.9)
    True
    """
    if image_bgr.ndim != 3 or image_bgr.shape[2] != 3 or image_bgr.dtype != np.uint8:
        raise ValueError(
            f"picture of shape {image_bgr.shape}, {image_bgr.dtype}: give (height, width, 3) in uint8"
        )
    if min(image_bgr.shape[:2]) < LEAST_PX:
        return _no_skyline(image_bgr.shape[1], ColumnState.NO_TERRAIN)
    rows, columns = inside_border(image_bgr)
    inside = _in_picture(np.ascontiguousarray(image_bgr[rows, columns]))
    if inside.state.size == image_bgr.shape[1]:
        return inside
    before, after = columns.start, image_bgr.shape[1] - columns.stop
    return Skyline(
        row_px=np.pad(inside.row_px + rows.start, (before, after), constant_values=np.nan),
        sigma_px=np.pad(inside.sigma_px, (before, after), constant_values=np.nan),
        confidence=np.pad(inside.confidence, (before, after)),
        state=np.pad(inside.state, (before, after), constant_values=np.uint8(ColumnState.NO_SKY)),
    )


def _in_picture(image_bgr: NDArray[np.uint8]) -> Skyline:
    """`find_skyline` in an image without a border."""
    height, width = image_bgr.shape[:2]
    work = reduce_image(image_bgr)
    boundary = trace_boundary(work)
    frame_odds = _frame_log_odds(boundary)
    if frame_odds < _LEAST_FRAME_LOG_ODDS:
        return _no_skyline(width, ColumnState.NO_SKY if _all_terrain(work) else ColumnState.NO_TERRAIN)

    h, w = work.texture.shape
    column = (np.arange(width) + 0.5) / work.scale_x - 0.5
    nearest = np.clip(np.round(column).astype(np.int64), 0, w - 1)
    rough_px = np.interp(column, np.arange(w), boundary.row.astype(np.float64)) * work.scale_y - 0.5
    edge = refine_edge(image_bgr, np.clip(rough_px, 0.5, height - 1.5), work.scale_y)

    confidence = _likelihood(frame_odds + 2.5) * _likelihood(_column_log_odds(boundary) - 2.6)[nearest]
    uncertain = boundary.uncertain | false_boundary_columns(work, boundary)
    confidence[foreground_columns(edge.row_px) | uncertain[nearest]] *= _UNCERTAIN_FACTOR
    state = np.where(confidence >= CONFIDENT, ColumnState.OK, ColumnState.DOUBTFUL).astype(np.uint8)
    state[boundary.row[nearest] < 2] = ColumnState.NO_SKY
    state[boundary.row[nearest] > h - 2] = ColumnState.NO_TERRAIN
    none = (state == ColumnState.NO_SKY) | (state == ColumnState.NO_TERRAIN)
    return Skyline(
        row_px=np.where(none, np.nan, edge.row_px),
        sigma_px=np.where(none, np.nan, edge.sigma_px),
        confidence=np.where(none, 0.0, confidence),
        state=state,
    )


_LEAST_FRAME_LOG_ODDS = -1.5
"""Log-odds that an image has a skyline, below which it counts as having none."""
_UNCERTAIN_FACTOR = 0.3
"""Factor on the confidence at foreground objects, false boundaries, and where another boundary is about as good."""


def _no_skyline(width: int, state: ColumnState) -> Skyline:
    """The result for an image without a skyline."""
    return Skyline(
        np.full(width, np.nan), np.full(width, np.nan), np.zeros(width), np.full(width, state, np.uint8)
    )


def _all_terrain(work: ReducedImage) -> bool:
    """Whether an image without a skyline shows terrain (or is dark) rather than sky, by logistic regression."""
    rough, bright, blue = np.median(work.texture), np.median(work.bright), np.median(work.blueness)
    return bool(2.3 + 1.9 * rough - 6.8 * bright - 7.7 * blue > 0)


def _frame_log_odds(boundary: SkyBoundary) -> float:
    """Log-odds that the boundary is a skyline, not a line in an image that is all sky or all terrain.

    A skyline is sharp for most of its length, with sky-like pixels above and terrain-like pixels below. The coefficients are
    those of a logistic regression on whole images and on their parts above and below the skyline.
    """
    h = boundary.odds.shape[0]
    row = boundary.row
    inside = (row > 2) & (row < h - 2)
    if inside.mean() < 0.05:
        return -math.inf
    generic_odds = np.clip(boundary.generic_odds, -3, 3)
    above = _column_mean(generic_odds, np.zeros_like(row), row)[inside].mean()
    below = _column_mean(generic_odds, row, np.full_like(row, h))[inside].mean()
    contrast = _contrast(boundary, 12)[inside].mean()
    sharpness = boundary.strength[inside].mean()
    return float(7.3 * sharpness - 0.23 * above + 0.61 * below + 5.6 * contrast - 6.6)


def _column_log_odds(boundary: SkyBoundary) -> NDArray[np.float64]:
    """Log odds per column of the reduced picture that the boundary is the skyline, given that there is one.

    The features are the cost margin of the next best boundary, the local edge strength, and the contrast of the log-odds above
    and below. The coefficients are those of a logistic regression; a boundary within 0.6 % of the width was right.
    """
    window = np.ones(15)
    sharpness = np.convolve(boundary.strength, window, "same") / np.convolve(
        np.ones(boundary.row.size), window, "same"
    )
    margin = np.log(np.maximum(boundary.margin, 0.1))
    return np.asarray(0.81 * margin + 4.25 * sharpness + 4.15 * _contrast(boundary, 7) - 2.45)


def _contrast(boundary: SkyBoundary, rows: int) -> NDArray[np.float64]:
    """Mean log-odds terrain : sky over the first `rows` rows below the boundary, minus that above it."""
    row = boundary.row
    below = _column_mean(boundary.odds, row + 1, row + 1 + rows)
    return below - _column_mean(boundary.odds, row - 1 - rows, row - 1)


def _column_mean(
    values: NDArray[np.float32], first: NDArray[np.int64], stop: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Mean of each column of `values` (h, w) over rows first..stop - 1, as far as they are in the picture; 0 if none is."""
    h, w = values.shape
    total = np.zeros((h + 1, w))
    np.cumsum(values, axis=0, out=total[1:])
    first, stop = np.clip(first, 0, h), np.clip(stop, 0, h)
    column = np.arange(w)
    return np.asarray((total[stop, column] - total[first, column]) / np.maximum(stop - first, 1))


def _likelihood(log_odds: ArrayLike) -> NDArray[np.float64]:
    """Logistic function."""
    return np.asarray(1.0 / (1.0 + np.exp(-np.clip(log_odds, -30, 30))))
