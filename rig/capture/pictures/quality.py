"""Detects unusable pictures: black, white, frozen, stale, changing and blurred ones.

Pure functions of pictures (height, width, 3), BGR. A defect is a phrase that continues "camera ...: its picture".
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from localizer.skyline.find import CONFIDENT, ColumnState, Skyline

Image = NDArray[np.uint8]
Thumbnail = NDArray[np.float32]
"""(15, 20) mean levels of patches: noise averages out, a rotation by a few degrees shows."""

BLACK, WHITE = 3.0, 252.0  # mean level
THUMBNAIL_SIZE = 20, 15
PLAIN_LEVELS = 4.0  # scatter of a featureless picture
SAME_LEVELS = 3.0  # largest difference of a patch between two pictures of the same view
CHANGING_LEVELS = (
    4.0  # mean change of the patches from the first frame to the last: clouds and trees make less
)
TURNED_DEG = 4.0  # rotation after which two views always differ
BLURRED_SHARE = 0.02  # of the height: width of the skyline's edge
SHARPEST_PX = 4.0
EDGE_REACH_PX = 15
MIN_CONTRAST = 20.0
COLUMNS_NEEDED = 0.2  # of the width


@dataclass(frozen=True)
class Seen:
    """A view's thumbnail and its joint angles."""

    pan_deg: float
    tilt_deg: float
    thumbnail: Thumbnail


def thumbnail(image: Image) -> Thumbnail:
    """The thumbnail of a picture."""
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    return np.asarray(cv2.resize(grey, THUMBNAIL_SIZE, interpolation=cv2.INTER_AREA), np.float32)


def defect(frames: Sequence[Image], pan_deg: float, tilt_deg: float, seen: Sequence[Seen]) -> str | None:
    """The defect of frames taken at these joint angles after the views in ``seen``; None if there is none."""
    first, last = thumbnail(frames[0]), thumbnail(frames[-1])
    level = float(last.mean())
    if level < BLACK:
        return "is black"
    if level > WHITE:
        return "is all white"
    if float(np.abs(last - first).mean()) > CHANGING_LEVELS:
        return "still changes although the head stands"
    if float(last.std()) < PLAIN_LEVELS:
        return None
    for view in seen:
        turned_deg = max(abs(pan_deg - view.pan_deg), abs(tilt_deg - view.tilt_deg))
        if turned_deg >= TURNED_DEG and float(np.abs(last - view.thumbnail).max()) < SAME_LEVELS:
            return f"has not changed although the head turned by {turned_deg:.0f} deg"
    if len(frames) > 1 and np.array_equal(frames[0], frames[-1]):
        return "has not changed in the least from frame to frame"  # real exposures have noise
    return None


def blur(image: Image, skyline: Skyline) -> str | None:
    """The defect of a picture with too wide a skyline edge; None if it is sharp."""
    width_px = edge_width_px(image, skyline)
    limit_px = max(SHARPEST_PX, BLURRED_SHARE * image.shape[0])
    return f"is blurred (the skyline is {width_px:.0f} px wide)" if width_px > limit_px else None


def edge_width_px(image: Image, skyline: Skyline) -> float:
    """Median width of the step from sky to terrain, px; 0 if too few columns have enough contrast.

    The width of a step is its height divided by its steepest slope.
    """
    columns = np.flatnonzero((skyline.state == ColumnState.OK) & (skyline.confidence >= CONFIDENT))
    grey = cv2.GaussianBlur(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), (0, 0), 0.8).astype(np.float32)
    rows = np.rint(skyline.row_px[columns]).astype(int)
    reach = np.arange(-EDGE_REACH_PX, EDGE_REACH_PX + 1)
    strips = grey[np.clip(rows[:, None] + reach, 0, grey.shape[0] - 1), columns[:, None]]
    heights = strips.max(axis=1) - strips.min(axis=1) if len(columns) else np.zeros(0)
    clear = heights >= MIN_CONTRAST
    if np.count_nonzero(clear) < COLUMNS_NEEDED * grey.shape[1]:
        return 0.0
    slopes = np.abs(np.diff(strips[clear], axis=1)).max(axis=1)
    return float(np.median(heights[clear] / np.maximum(slopes, 1e-6)))
