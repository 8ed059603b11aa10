"""Attitude of vehicle and camera from the newest readings: approximate values of what a capture measures.

The head does not turn, so the inclinometer's zero error and uncalibrated iron are included.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from rig.attitude.declination import declination
from rig.attitude.heading import VehicleIron
from rig.attitude.kinematics import (
    Attitude,
    Head,
    JointAngles,
    body_attitude,
    body_rotation,
    head_rotation,
    measured_pointing,
    pan_stage_rotation,
)
from rig.clock import utc_now
from rig.config.model import RigConfig
from rig.config.sections import Mmc5983maSection
from rig.errors import ConfigError
from rig.watch.watcher import DeviceStatus

LEVEL_BASE = Attitude(0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Attitudes:
    """Degrees and metres; None if a device that it needs has no fresh reading."""

    head_tilt_deg: float | None = None
    head_roll_deg: float | None = None
    pan_deg: float | None = None
    tilt_deg: float | None = None
    vehicle_pitch_deg: float | None = None
    vehicle_roll_deg: float | None = None
    vehicle_heading_deg: float | None = None
    camera_azimuth_deg: float | None = None
    camera_tilt_deg: float | None = None
    camera_roll_deg: float | None = None
    altitude_m: float | None = None
    altitude_sigma_m: float | None = None


def attitudes(config: RigConfig, statuses: Sequence[DeviceStatus]) -> Attitudes:
    """The attitudes from the fresh readings."""
    fresh = fresh_values(statuses)
    level, head = fresh.get("inclinometer", {}), fresh.get("head", {})
    found: dict[str, float | None] = {
        "head_tilt_deg": level.get("tilt_deg"),
        "head_roll_deg": level.get("roll_deg"),
        "pan_deg": head.get("pan_deg"),
        "tilt_deg": head.get("tilt_deg"),
        "altitude_m": fresh.get("altimeter", {}).get("altitude_m"),
        "altitude_sigma_m": fresh.get("altimeter", {}).get("altitude_sigma_m"),
    }
    if level and head:
        joints = JointAngles(head["pan_deg"], head["tilt_deg"])
        base = _base(level["tilt_deg"], level["roll_deg"], joints)
        found |= {"vehicle_pitch_deg": base.tilt_deg, "vehicle_roll_deg": base.roll_deg}
        if fresh.get("compass"):
            heading_deg = _heading_deg(config, fresh["compass"], base, joints)
            found["vehicle_heading_deg"] = heading_deg
            if heading_deg is not None:
                camera = measured_pointing(
                    Attitude(heading_deg, base.tilt_deg, base.roll_deg),
                    joints,
                    level["tilt_deg"],
                    level["roll_deg"],
                    Head.from_config(config).boresight,
                )
                found |= {
                    "camera_azimuth_deg": camera.azimuth_deg,
                    "camera_tilt_deg": camera.tilt_deg,
                    "camera_roll_deg": camera.roll_deg,
                }
    return Attitudes(**{name: None if value is None else round(value, 4) for name, value in found.items()})


def fresh_values(statuses: Sequence[DeviceStatus]) -> dict[str, Mapping[str, Any]]:
    """The values of the devices with a fresh reading, by name."""
    return {
        status.name: status.reading.values
        for status in statuses
        if status.reading is not None and status.state in ("ok", "warning")
    }


def _base(tilt_deg: float, roll_deg: float, joints: JointAngles) -> Attitude:
    """Pitch and roll of the base from the inclinometer's tilt and roll of the head; heading 0."""
    head = body_rotation(Attitude(0.0, tilt_deg, roll_deg))
    base = body_attitude(head @ head_rotation(LEVEL_BASE, joints).T)
    return Attitude(0.0, base.tilt_deg, base.roll_deg)


def _heading_deg(
    config: RigConfig, compass: Mapping[str, Any], base: Attitude, joints: JointAngles
) -> float | None:
    """True heading of the base; None without a declination."""
    section = config.compass
    assert section is not None
    try:
        if compass.get("reference") == "true":
            to_true_deg = 0.0
        else:
            variation_deg = compass.get("variation_deg")
            to_true_deg = declination(
                section.declination_deg, variation_deg, config.place, utc_now()
            ).declination_deg
    except ConfigError:
        return None
    if isinstance(section, Mmc5983maSection):
        stage_ut = np.array([compass[f"field_{axis}_ut"] for axis in ("right", "ahead", "up")])
        iron = VehicleIron(section.vehicle_hard_iron_ut, section.vehicle_soft_iron)
        in_base = iron.removed(pan_stage_rotation(LEVEL_BASE, joints.pan_deg) @ stage_ut)
        east, north, _ = body_rotation(base) @ in_base
        measured_deg = math.degrees(math.atan2(-east, north))
    else:
        ahead = pan_stage_rotation(base, joints.pan_deg)[:, 1]
        measured_deg = compass["heading_deg"] - math.degrees(math.atan2(ahead[0], ahead[1]))
    return float(measured_deg + to_true_deg + section.heading_offset_deg) % 360.0
