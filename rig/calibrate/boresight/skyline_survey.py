"""Skyline survey at a known place: frames at several tilts in each direction, from a stationary vehicle."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from localizer.camera import pixel_rays
from localizer.observation import NO_COMPASS_SIGMA_DEG
from localizer.skyline.find import CONFIDENT, ColumnState, Skyline, find_skyline
from rig.attitude.kinematics import Attitude, Head, JointAngles, body_attitude, head_rotation, wrapped_deg
from rig.calibrate.boresight.skyline_frame import SkylineFrame
from rig.capture.base_attitude import BaseEstimate, Stop
from rig.capture.view import View, aim_and_take, in_sweep_order, take_view
from rig.config.calibration_files import CalibrationError
from rig.config.directions import Direction
from rig.config.model import RigConfig
from rig.config.sections import CameraSection
from rig.devices.connect import Rig

Vector = NDArray[np.float64]

POINTS_APART_PX = 12
SECOND_TILT_SHARE = 0.65  # of half the picture's height
CENTRAL_SHARE = 0.05
MIN_SIGMA_PX = 0.3
HEADING_CHANGE_LIMIT_DEG = 1.0
LEVEL_CHANGE_LIMIT_DEG = 0.1
"""Apparent motion of a stationary vehicle from noise of compass and inclinometer."""


def require_unmoved(before: BaseEstimate, after: BaseEstimate) -> None:
    """Raise ``CalibrationError`` if the vehicle moved during the survey."""
    turned_deg = wrapped_deg(after.attitude.azimuth_deg - before.attitude.azimuth_deg)
    leaned_deg = max(
        abs(after.level.pitch_deg - before.level.pitch_deg), abs(after.level.roll_deg - before.level.roll_deg)
    )
    without_compass = before.heading.sigma_deg >= NO_COMPASS_SIGMA_DEG
    if leaned_deg > LEVEL_CHANGE_LIMIT_DEG or (
        abs(turned_deg) > HEADING_CHANGE_LIMIT_DEG and not without_compass
    ):
        raise CalibrationError(
            f"boresight: the vehicle moved while it was measured (it turned by {abs(turned_deg):.2f} deg and leans "
            f"{leaned_deg:.2f} deg otherwise); let nobody get on or off, engine off, and calibrate again"
        )


def survey_skyline(
    rig: Rig, base_estimate: BaseEstimate, directions: Sequence[Direction], say: Callable[[str], None]
) -> tuple[list[SkylineFrame], list[Stop]]:
    """In each direction take a frame with the skyline in the middle and one with it higher or lower; also returns the
    sensor readings of each.

    An azimuth error of the camera rotates the picture when the head tilts, a heading error does not: frames at
    different tilts separate them.
    """
    config = rig.config
    head = Head.from_config(config)
    low_deg, high_deg = head.tilt_range_deg
    frames: list[SkylineFrame] = []
    stops: list[Stop] = []
    for number, direction in enumerate(
        in_sweep_order(directions, base_estimate.attitude, head, rig.pan_tilt.state().pan_deg)
    ):
        view = aim_and_take(rig, direction, base_estimate, head)
        frames.append(skyline_frame(config, direction.label, base_estimate, view, number))
        stops.append(view.stop)
        here = view.state
        wanted_deg = here.tilt_deg + second_tilt_offset_deg(
            find_skyline(view.image_bgr), config.camera, number % 2 == 1
        )
        if low_deg <= wanted_deg <= high_deg:
            other = take_view(rig, JointAngles(here.pan_deg, wanted_deg), base_estimate, head, [])
            frames.append(skyline_frame(config, f"{direction.label} tilted", base_estimate, other, number))
            stops.append(other.stop)
        say(f"{direction.label}: skyline in {view.skyline_share:.0%} of the columns")
    return frames, stops


def second_tilt_offset_deg(skyline: Skyline, camera: CameraSection, up: bool) -> float:
    """Additional tilt that puts the skyline into the other half of the picture; ``up`` decides if it is central."""
    rows = skyline.row_px[skyline.state == ColumnState.OK]
    middle_px = (camera.height_px - 1) / 2.0
    row_px = float(np.median(rows)) if len(rows) else middle_px
    if abs(row_px - middle_px) > CENTRAL_SHARE * camera.height_px:
        up = row_px < middle_px
    # Tilting up moves the skyline down, to higher rows.
    target_px = middle_px + (1.0 if up else -1.0) * SECOND_TILT_SHARE * middle_px
    return float(
        np.degrees(
            np.arctan((target_px - middle_px) / camera.fy_px) - np.arctan((row_px - middle_px) / camera.fy_px)
        )
    )


def skyline_frame(
    config: RigConfig, label: str, base_estimate: BaseEstimate, view: View, stop: int
) -> SkylineFrame:
    """A view as input of the fit, for the pan's ``stop``."""
    skyline = find_skyline(view.image_bgr)
    columns = np.arange(POINTS_APART_PX // 2, len(skyline.row_px), POINTS_APART_PX)
    sure = (skyline.state == ColumnState.OK) & (skyline.confidence >= CONFIDENT)
    columns = columns[sure[columns]]
    rays = pixel_rays(config.camera, columns, skyline.row_px[columns]) if len(columns) else np.empty((0, 3))
    sigma_px = np.maximum(skyline.sigma_px[columns], MIN_SIGMA_PX)
    return SkylineFrame(
        label,
        head_attitude(base_estimate, view.stop),
        rays,
        np.degrees(sigma_px / config.camera.fy_px),
        view.skyline_share,
        config.pan_tilt.azimuth_sigma_deg,
        config.inclinometer.tilt_sigma_deg,
        stop,
    )


def head_attitude(base_estimate: BaseEstimate, stop: Stop) -> Attitude:
    """Attitude of the head from joints, heading and inclinometer."""
    azimuth_deg = body_attitude(head_rotation(base_estimate.attitude, stop.joints)).azimuth_deg
    level, zero = stop.level, base_estimate.level
    return Attitude(azimuth_deg, level.tilt_deg - zero.tilt_zero_deg, level.roll_deg - zero.roll_zero_deg)
