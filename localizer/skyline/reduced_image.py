"""The reduced image in which the boundary is traced, and its features per pixel."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from localizer.jit import kernel

Floats = NDArray[np.float32]

WORK_PIXELS = 77_000
"""About as many pixels as the reduced picture has (320 x 240)."""


@dataclass(frozen=True)
class ReducedImage:
    """A reduced picture of h x w pixels. Boundaries between rows count from 0 (above row 0) to h (below the last).

    Attributes:
        lab: (h, w, 3) CIE Lab, L 0..100.
        bright: (h, w) largest of the colour channels, 0..1.
        blueness: (h, w) blue minus red, -1..1.
        texture: (h, w) log of the mean absolute horizontal curvature of the brightness, grey levels. Horizontal, so that
            a horizontal edge between two smooth areas does not count as texture.
        step: (h + 1, w) colour step across each boundary, grey levels, measured at the finer resolution; negative where it is
            brighter below.
        scale_x, scale_y: full-resolution pixels per pixel.
    """

    lab: Floats
    bright: Floats
    blueness: Floats
    texture: Floats
    step: Floats
    scale_x: float
    scale_y: float


def reduce_image(image_bgr: NDArray[np.uint8]) -> ReducedImage:
    """Average a picture (height, width, 3) down to WORK_PIXELS; texture and steps are measured at twice that resolution."""
    height, width = image_bgr.shape[:2]
    factor = max(1.0, float(np.sqrt(height * width / WORK_PIXELS)))
    w, h = max(8, round(width / factor)), max(8, round(height / factor))
    fine = image_bgr
    if factor > 2.5:
        fine = np.asarray(cv2.resize(image_bgr, (2 * w, 2 * h), interpolation=cv2.INTER_AREA), np.uint8)
    grey = cv2.cvtColor(fine, cv2.COLOR_BGR2GRAY).astype(np.float32)
    curvature = np.abs(cv2.filter2D(grey, -1, np.array([[-0.5, 1.0, -0.5]], np.float32)))
    texture = np.asarray(
        cv2.blur(cv2.resize(curvature, (w, h), interpolation=cv2.INTER_AREA), (7, 3)), np.float32
    )
    bgr = np.asarray(cv2.resize(fine, (w, h), interpolation=cv2.INTER_AREA), np.float32) * np.float32(1 / 255)
    lab = np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2LAB), np.float32)
    blue, green, red = cv2.split(bgr)
    return ReducedImage(
        lab=lab,
        bright=np.asarray(cv2.max(cv2.max(blue, green), red), np.float32),
        blueness=np.asarray(blue - red, np.float32),
        texture=np.asarray(np.log(texture + np.float32(0.3)), np.float32),
        step=_pool(_steps(fine), h, w),
        scale_x=width / w,
        scale_y=height / h,
    )


@kernel()
def _steps(fine: NDArray[np.uint8]) -> Floats:
    """Colour step across each boundary between two rows, (rows + 1, cols), grey levels; negative where brighter below.

    At a ridge, the difference between adjacent pairs of rows is as large as that between groups of four rows farther apart.
    Soft edges of clouds, and thin streaks, have smaller ratios and get smaller steps.
    """
    rows, cols = fine.shape[:2]
    pad = 6
    total = np.zeros((rows + 2 * pad + 1, cols, 3), np.int32)
    for y in range(rows + 2 * pad):
        for x in range(cols):
            for c in range(3):
                total[y + 1, x, c] = total[y, x, c] + fine[min(max(y - pad, 0), rows - 1), x, c]
    step = np.zeros((rows + 1, cols), np.float32)
    for y in range(1, rows):
        at = y + pad
        for x in range(cols):
            near = np.int32(0)
            far = np.int32(0)
            darker = np.int32(0)
            for c in range(3):
                middle = 2 * total[at, x, c] - total[at - 2, x, c] - total[at + 2, x, c]
                outer = (total[at - 2, x, c] - total[at - 6, x, c]) - (
                    total[at + 6, x, c] - total[at + 2, x, c]
                )
                near += middle * middle
                far += outer * outer
                darker += middle
            sharp = np.sqrt(np.float32(near) / np.float32(12))
            lasting = np.sqrt(np.float32(far) / np.float32(48))
            size = sharp * min(np.float32(1), sharp / (np.float32(0.65) * lasting + np.float32(0.01)))
            size = min(size, np.float32(1.3) * lasting)
            step[y, x] = size if darker >= 0 else -size
    return step


@kernel()
def _pool(step: Floats, h: int, w: int) -> Floats:
    """The largest step near each boundary of the reduced picture, averaged over the columns that make up one; (h + 1, w)."""
    rows, cols = step.shape[0] - 1, step.shape[1]
    out = np.zeros((h + 1, w), np.float32)
    for r in range(1, h):
        middle = r * rows / h
        first = max(1, int(np.floor(middle - 0.5 * rows / h + 0.5)))
        last = max(first, min(rows - 1, int(np.floor(middle + 0.5 * rows / h))))
        for x in range(w):
            start = int(x * cols / w)
            stop = max(start + 1, int((x + 1) * cols / w))
            for i in range(start, stop):
                best = np.float32(0)
                for y in range(first, last + 1):
                    if abs(step[y, i]) > abs(best):
                        best = step[y, i]
                out[r, x] += best / np.float32(stop - start)
    return out
