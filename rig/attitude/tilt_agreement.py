"""Consistency check of inclinometer and tilt servo.

Gear backlash explains a difference of a degree or two. A factor means a chip with another scale than its identity says,
or exchanged axes; the base level is then wrong by the same factor.
"""

from rig.attitude.kinematics import Attitude, JointAngles, body_attitude, head_rotation
from rig.errors import DeviceError

MIN_TILT_DEG = 6.0
MAX_PLAY_DEG = 2.0
MAX_PLAY_SHARE = 0.25


def require_agreement(base: Attitude, joints: JointAngles, measured_tilt_deg: float, device: str) -> None:
    """Raise ``DeviceError`` if the tilt measured at ``joints`` differs by more than backlash from that of the joints.

    ``measured_tilt_deg`` is the inclinometer's, zero error removed; ``base`` was measured by it at tilt 0.
    """
    level_deg = body_attitude(head_rotation(base, JointAngles(joints.pan_deg, 0.0))).tilt_deg
    expected_deg = body_attitude(head_rotation(base, joints)).tilt_deg - level_deg
    change_deg = measured_tilt_deg - level_deg
    tolerance_deg = max(MAX_PLAY_DEG, MAX_PLAY_SHARE * abs(expected_deg))
    if abs(expected_deg) < MIN_TILT_DEG or abs(change_deg - expected_deg) <= tolerance_deg:
        return
    raise DeviceError(
        device,
        f"finds the head tilted by {change_deg:.1f} deg where the tilt servo turned it by {expected_deg:.1f} deg, a factor of "
        f"{change_deg / expected_deg:.2f}",
        "look at what chip is fitted (others have its identity and another scale), at [inclinometer] axes and scale, "
        "and at the coupling of the tilt servo",
    )
