"""Exposure bracketing: darker pictures where the sky is overexposed, which hides haze, snow and thin ridges below it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from localizer.skyline.find import CONFIDENT, ColumnState, Skyline, find_skyline
from rig.devices.camera.driver import Camera
from rig.devices.camera.frames import TimedFrame, average
from rig.errors import DeviceError
from rig.fault_notes import note_fault

Image = NDArray[np.uint8]

STEPS_EV = (-1.0, -2.0, -3.0)
OVEREXPOSED_LEVEL = 250
ABOVE_PX = (3, 8)  # rows above the skyline: clear of its edge, and near enough to show overexposure
OVEREXPOSED_LIMIT = 0.2  # of the columns


@dataclass(frozen=True)
class Pictures:
    """Frames of one view, their mean (height, width, 3), BGR, and its skyline."""

    frames: list[TimedFrame]
    image_bgr: Image
    skyline: Skyline

    @property
    def sure_share(self) -> float:
        """Share of columns with a confident skyline."""
        sure = (self.skyline.state == ColumnState.OK) & (self.skyline.confidence >= CONFIDENT)
        return float(np.mean(sure))


def pictures_of(frames: list[TimedFrame]) -> Pictures:
    """Average frames and find their skyline."""
    image = average(frames)
    return Pictures(frames, image, find_skyline(image))


def overexposed_share(image: Image, skyline: Skyline) -> float:
    """Share of columns whose sky is overexposed just above the skyline, or at the bottom of an all-sky column."""
    overexposed = image.min(axis=2) >= OVEREXPOSED_LEVEL
    height, width = overexposed.shape
    all_sky = skyline.state == ColumnState.NO_TERRAIN
    row = np.where(np.isfinite(skyline.row_px) & ~all_sky, np.nan_to_num(skyline.row_px), height - 1)
    rows = np.rint(row).astype(int)[:, None] - np.arange(*ABOVE_PX)
    above = overexposed[np.clip(rows, 0, height - 1), np.arange(width)[:, None]].all(axis=1)
    return float(np.mean(above & (skyline.state != ColumnState.NO_SKY)))


def bracketed(camera: Camera, usual: Pictures) -> Pictures:
    """``usual``, or the brightest darker exposure whose sky is not overexposed, else the one with most skyline.

    A camera without settable exposure is left alone. A replacement of ``usual`` is noted.
    """
    if (
        overexposed_share(usual.image_bgr, usual.skyline) <= OVEREXPOSED_LIMIT
        or not camera.exposure_is_settable
    ):
        return usual
    tried = [(0.0, usual)]
    try:
        for ev in STEPS_EV:
            camera.expose(ev)
            darker = pictures_of(camera.frames_after(camera.exposure_settled_at_s(), len(usual.frames)))
            tried.append((ev, darker))
            if overexposed_share(darker.image_bgr, darker.skyline) <= OVEREXPOSED_LIMIT:
                break
    except DeviceError as error:
        note_fault(error.device, error.problem, "kept the picture with the burnt-out sky")
        return usual
    finally:
        restore(camera)
    ev, best = max(reversed(tried), key=lambda each: each[1].sure_share)
    if ev:
        note_fault(camera.name, "its sky is burnt out", f"taken again at {ev:g} EV")
    return best


def restore(camera: Camera) -> None:
    """Restore the camera's automatic exposure; a failure is noted, as the next pictures are then dark."""
    try:
        camera.expose(0.0)
    except DeviceError as error:
        note_fault(error.device, error.problem, "its exposure may have stayed low")
