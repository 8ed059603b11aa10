"""Pictures taken with the camera on its side or on its head, turned by quarters so that the sky is up.

The finder of skylines looks at columns from the sky down. A picture is turned for it by the quarter nearest to its roll, and
its camera with it: what was found then holds for that camera and for the rest of the roll.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from localizer.bundle import Bundle, Camera, Frame, frame_image
from localizer.skyline.find import Skyline, find_skyline

Floats = NDArray[np.float64]


class Upright(NamedTuple):
    """A frame as it is once turned: ``quarters`` of a turn clockwise."""

    quarter_turns: int
    camera: Camera
    roll_deg: float

    def as_recorded(self, u_px: Floats, v_px: Floats) -> tuple[Floats, Floats]:
        """Pixels of the frame as recorded, of such as it is turned."""
        width, height = self.camera.width_px, self.camera.height_px
        for _ in range(self.quarter_turns):
            u_px, v_px, width, height = v_px, width - 1.0 - u_px, height, width
        return u_px, v_px


def quarter_turns_of(roll_deg: float) -> int:
    """By how many quarters clockwise a picture is turned, 0 to 3: a camera turned clockwise sees the world turned back."""
    return round(roll_deg / 90.0) % 4


def upright(camera: Camera, roll_deg: float) -> Upright:
    """The camera that would have taken the turned picture, and what is left of the roll."""
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
                # what is tangential goes along with the axes: (p2, p1) is a vector
                "distortion": (k1, k2, p2, -p1, k3),
            }
        )
    return Upright(quarter_turns, camera, (roll_deg - 90.0 * quarter_turns + 180.0) % 360.0 - 180.0)


def frame_skyline(bundle: Bundle, frame: Frame) -> Skyline:
    """The skyline in a frame's picture, in the pixels of the turned one. Raises ``BundleError``."""
    picture = frame_image(bundle, frame)
    return find_skyline(np.ascontiguousarray(np.rot90(picture, -quarter_turns_of(frame.roll_deg))))
