"""Derives a bundle's calibrated values from raw readings and a configuration: at capture, and again on recalibration."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from localizer.bundle import Camera as BundleCamera
from rig.attitude.kinematics import Attitude, Head, JointAngles, measured_pointing
from rig.attitude.level import HeadLevel
from rig.bundle.writer import FrameRecord
from rig.capture.base_attitude import BaseEstimate, Stop
from rig.config.model import RigConfig

MAX_SIGMA_DEG = 180.0


@dataclass(frozen=True)
class Shot:
    """A picture and the readings taken with it; its attitude follows from the base estimate."""

    label: str
    image_bgr: NDArray[np.uint8]
    time: datetime
    stop: Stop
    raw: Mapping[str, Any]


def frame_record(config: RigConfig, base_estimate: BaseEstimate, shot: Shot) -> FrameRecord:
    """A frame of the bundle."""
    level = shot.stop.level
    looked = pointing(base_estimate, shot.stop.joints, level, Head.from_config(config))
    return FrameRecord(
        label=shot.label,
        image_bgr=shot.image_bgr,
        time=shot.time,
        azimuth_deg=looked.azimuth_deg,
        azimuth_sigma_deg=config.pan_tilt.azimuth_sigma_deg,
        tilt_deg=looked.tilt_deg,
        tilt_sigma_deg=tilt_sigma_deg(config, level),
        roll_deg=looked.roll_deg,
        roll_sigma_deg=roll_sigma_deg(config, base_estimate, level),
        raw=shot.raw,
    )


def pointing(base_estimate: BaseEstimate, joints: JointAngles, level: HeadLevel, head: Head) -> Attitude:
    """Camera attitude from joint angles and inclinometer."""
    return measured_pointing(
        base_estimate.attitude,
        joints,
        level.tilt_deg - base_estimate.level.tilt_zero_deg,
        level.roll_deg - base_estimate.level.roll_zero_deg,
        head.boresight,
    )


def azimuth_bias_sigma_deg(config: RigConfig, base_estimate: BaseEstimate) -> float:
    """Sigma of the azimuth error common to all frames: heading and boresight."""
    both_deg = math.hypot(base_estimate.heading.sigma_deg, config.camera.boresight_azimuth_sigma_deg)
    return min(both_deg, MAX_SIGMA_DEG)


def tilt_bias_sigma_deg(config: RigConfig, base_estimate: BaseEstimate) -> float:
    """Sigma of the tilt error common to all frames: inclinometer zero and boresight."""
    return math.hypot(base_estimate.level.tilt_zero_sigma_deg, config.camera.boresight_tilt_sigma_deg)


def tilt_sigma_deg(config: RigConfig, level: HeadLevel) -> float:
    """Sigma of one frame's tilt."""
    return math.hypot(config.inclinometer.tilt_sigma_deg, level.tilt_noise_deg)


def roll_sigma_deg(config: RigConfig, base_estimate: BaseEstimate, level: HeadLevel) -> float:
    """Sigma of one frame's roll. The contract has no roll bias: residual zero errors are included here."""
    return math.hypot(
        config.inclinometer.roll_sigma_deg,
        level.roll_noise_deg,
        base_estimate.level.roll_zero_sigma_deg,
        config.camera.boresight_roll_sigma_deg,
    )


def bundle_camera(config: RigConfig) -> BundleCamera:
    """The camera's intrinsics for the bundle."""
    camera = config.camera
    return BundleCamera(
        width_px=camera.width_px,
        height_px=camera.height_px,
        fx_px=camera.fx_px,
        fy_px=camera.fy_px,
        cx_px=camera.cx_px,
        cy_px=camera.cy_px,
        distortion=camera.distortion,
    )


def calibration_record(config: RigConfig, base_estimate: BaseEstimate) -> dict[str, Any]:
    """How calibrated readings were derived: intermediate results, configuration, and calibration files."""
    return {
        **base_estimate.calibration,
        "configuration": configured_calibration(config),
        "files": {each.document.kind: each.record() for each in config.calibrations},
    }


def configured_calibration(config: RigConfig) -> dict[str, Any]:
    """The configuration in force, with the values of calibrations, as JSON values.

    Without the camera's URLs, which may contain a password.
    """
    return config.model_dump(
        mode="json",
        exclude={
            "capture": True,
            "calibration": True,
            "run": True,
            "rig": {"bundle_dir", "telemetry_dir"},
            "camera": {"source", "exposure_url"},
        },
    )
