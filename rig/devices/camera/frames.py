"""Camera frames with their times, and their mean."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.clock import Instant
from rig.devices.camera.exposure import V4L2_AUTOMATIC as V4L2_AUTOMATIC
from rig.devices.camera.exposure import V4L2_MANUAL as V4L2_MANUAL
from rig.devices.camera.exposure import LocalExposure as LocalExposure

Image = NDArray[np.uint8]


@dataclass(frozen=True)
class TimedFrame:
    """A frame, and when it reached the computer: between ``not_before_s`` and ``arrived``.

    Attributes
    ----------
    image_bgr : array of uint8
        (height, width, 3): blue, green, red.
    not_before_s : float
        On ``time.monotonic``'s clock.
    arrived : Instant
        On both clocks: ``monotonic_s`` and ``utc``.
    """

    image_bgr: Image
    not_before_s: float
    arrived: Instant


def average(frames: Sequence[TimedFrame]) -> Image:
    """The mean of frames of the same view, rounded to nearest: noise falls with the root of their number."""
    mean = np.mean([frame.image_bgr for frame in frames], axis=0, dtype=np.float32)
    return np.rint(mean).astype(np.uint8)


def is_newer(not_before_s: float, last_s: float, frame: TimedFrame) -> bool:
    return frame.not_before_s >= not_before_s and frame.arrived.monotonic_s > last_s
