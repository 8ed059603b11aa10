"""Frames taken with a roll near 90, 180 or 270 degrees, rotated by quarter turns so that the sky is up.

Skyline detection works on columns from the sky down. A frame, and its camera model with it, is rotated by the quarter turn
nearest to its roll. Results refer to the rotated camera and the remaining roll.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from localizer.bundle import Bundle, Camera, Frame, frame_image
from localizer.skyline.find import Skyline, find_skyline

Floats = NDArray[np.float64]


class Upright(NamedTuple):
    """A rotated frame: ``quarter_turns`` clockwise, the camera model that belongs to it, and the remaining roll."""

    quarter_turns: int
    camera: Camera
    roll_deg: float

    def as_recorded(self, u_px: Floats, v_px: Floats) -> tuple[Floats, Floats]:
        """Pixels of the recorded frame, from pixels of the rotated one."""
        width, height = self.camera.width_px, self.camera.height_px
        for _ in range(self.quarter_turns):
            u_px, v_px, width, height = v_px, width - 1.0 - u_px, height, width
        return u_px, v_px


def quarter_turns_of(roll_deg: float) -> int:
    """Quarter turns clockwise, 0 to 3, that put the sky up.

    The image of a camera that is rolled clockwise is rotated counter-clockwise.
    """
    return round(roll_deg / 90.0) % 4


def upright(camera: Camera, roll_deg: float) -> Upright:
    """The camera model of the rotated frame, and the remaining roll."""
    quarter_turns = quarter_turns_of(roll_deg)
    for _ in range(quarter_turns):
        k1, k2, p1, p2, k3 = camera.distortion
        camera = camera.model_copy(
            update={
                "width_px": camera.height_px,
                "height_px": camera.width_px,
                "fx_px": camera.fy_px,
                "fy_px": camera.fx_px,
                "cx_px": camera.height_px - 1.0 - camera.cy_px,
                "cy_px": camera.cx_px,
                # the tangential coefficients (p2, p1) rotate like a vector
                "distortion": (k1, k2, p2, -p1, k3),
            }
        )
    return Upright(quarter_turns, camera, (roll_deg - 90.0 * quarter_turns + 180.0) % 360.0 - 180.0)


def frame_skyline(bundle: Bundle, frame: Frame) -> Skyline:
    """The skyline in a frame, in pixels of the rotated image. Raises ``BundleError``."""
    picture = frame_image(bundle, frame)
    return find_skyline(np.ascontiguousarray(np.rot90(picture, -quarter_turns_of(frame.roll_deg))))
