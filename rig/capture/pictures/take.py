"""Takes the pictures of one view, again if they are black, frozen, stale, blurred or overexposed."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rig import timebase
from rig.attitude.kinematics import JointAngles
from rig.capture.pictures.bracketing import Pictures, bracketed, pictures_of
from rig.capture.pictures.quality import Seen, blur, defect, thumbnail
from rig.devices.bus.retry import retry
from rig.devices.camera.driver import Camera
from rig.errors import TransientError

TRIES = 6
TIME_LIMIT_S = 8.0
PAUSE_S = 0.1  # doubles each time, to cover a camera that lags by some seconds

REMEDIES = {
    "is black": "look at the lens cap, the light and the camera's exposure",
    "is all white": "look at the camera's exposure",
    "is blurred": "clean the lens, and look at its focus",
}
REMEDY = "restart the camera, and look at its cable or network"


def take_pictures(
    camera: Camera, count: int, not_before_s: float, joints: JointAngles, seen: Sequence[Seen]
) -> Pictures:
    """``count`` frames that arrive no earlier than a moment (monotonic) while the head stands at ``joints``.

    ``seen`` are earlier views. An overexposed sky is bracketed if the exposure is settable. Raises ``DeviceError`` as
    the camera does, and if the pictures do not become usable.
    """
    begins_s = not_before_s

    def take() -> Pictures:
        nonlocal begins_s
        moment_s, begins_s = begins_s, 0.0
        frames = camera.frames_after(max(moment_s, timebase.monotonic_s()), count)
        problem = defect([frame.image_bgr for frame in frames], joints.pan_deg, joints.tilt_deg, seen)
        if problem:
            raise _bad(camera, problem)
        pictures = pictures_of(frames)
        problem = blur(pictures.image_bgr, pictures.skyline)
        if problem:
            raise _bad(camera, problem)
        return pictures

    return bracketed(camera, retry(take, tries=TRIES, within_s=TIME_LIMIT_S, pause_s=PAUSE_S))


def seen_at(joints: JointAngles, image_bgr: NDArray[np.uint8]) -> Seen:
    """The view's entry for later comparisons."""
    return Seen(joints.pan_deg, joints.tilt_deg, thumbnail(image_bgr))


def _bad(camera: Camera, problem: str) -> TransientError:
    remedy = next((cure for start, cure in REMEDIES.items() if problem.startswith(start)), REMEDY)
    return TransientError(camera.name, f"its picture {problem}", remedy)
