"""Effect of the servos' holding current on the compass: read with torque on and off.

Captures and the calibration both read with torque on. A constant effect becomes part of the pan stage's iron; the part
that varies with the pan angle remains in the heading.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.attitude.level import in_axes
from rig.capture.base_attitude import Stop, read_here
from rig.config.calibration_files import CalibrationError
from rig.config.sections import Mmc5983maSection
from rig.devices.connect import Rig

Vector = NDArray[np.float64]


@dataclass(frozen=True)
class TorqueOnOffPair:
    """Fields (3,), uT in stage axes, with torque on and off, and the pan angle of each reading."""

    torque_on_ut: Vector
    torque_off_ut: Vector
    torque_on_pan_deg: float
    torque_off_pan_deg: float


@dataclass(frozen=True)
class TorqueField:
    """Field of the holding current (3,), uT in stage axes, and its rms variation, horizontal.

    ``heading_deg`` is its effect on an uncorrected heading, ``varying_deg`` the effect of its variation on a capture's
    heading.
    """

    field_ut: Vector
    varies_ut: float
    heading_deg: float
    varying_deg: float


def read_with_torque_on_and_off(
    rig: Rig, held: Stop, section: Mmc5983maSection, duration_s: float
) -> TorqueOnOffPair:
    """Switch the torque off at a stop that was just read, and read again. ``CalibrationError`` without a field."""
    rig.pan_tilt.relax()
    free = read_here(rig, rig.pan_tilt.state(), duration_s)
    if held.field is None or free.field is None:
        raise CalibrationError("compass: gave no field; calibrate again")
    torque_on_ut, torque_off_ut = (
        in_axes(np.array(stop.field.mean_ut), section.axes) for stop in (held, free) if stop.field
    )
    return TorqueOnOffPair(torque_on_ut, torque_off_ut, held.joints.pan_deg, free.joints.pan_deg)


def torque_field(
    pairs: Sequence[TorqueOnOffPair],
    stage_hard_ut: Sequence[float],
    horizontal_ut: float,
    capture_angles: int,
) -> TorqueField:
    """Difference of the readings, corrected for the rotation of a head that moved when the torque went off.

    ``capture_angles`` is the number of pan angles at which a capture reads the compass before its pictures.
    """
    hard_ut = np.array(stage_hard_ut)
    changes = []
    for pair in pairs:
        gave_way = np.radians(pair.torque_off_pan_deg - pair.torque_on_pan_deg)
        c, s = np.cos(gave_way), np.sin(gave_way)
        x, y, z = pair.torque_off_ut - hard_ut
        changes.append(pair.torque_on_ut - hard_ut - [c * x + s * y, -s * x + c * y, z])
    change_ut = np.array(changes)
    mean_ut = change_ut.mean(axis=0)
    off_ut = change_ut[:, :2] - mean_ut[:2]
    varies_ut = float(np.sqrt((off_ut**2).sum() / 2.0 / max(len(pairs) - 1, 1)))
    return TorqueField(
        mean_ut,
        varies_ut,
        float(np.degrees(np.arctan2(np.hypot(*mean_ut[:2]), horizontal_ut))),
        float(np.degrees(varies_ut / horizontal_ut)) / float(np.sqrt(capture_angles)),
    )
