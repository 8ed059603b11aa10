"""One view: aim at a direction, tilt until the skyline is well in the picture, and read all sensors meanwhile."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig import timebase
from rig.attitude.kinematics import Attitude, Head, JointAngles, body_attitude, head_rotation, joints_for
from rig.attitude.level import HeadLevel
from rig.attitude.tilt_agreement import require_agreement
from rig.capture import derive
from rig.capture.averaged_readings import require_stationary, still_level
from rig.capture.base_attitude import (
    BaseEstimate,
    Stop,
    read_compass_during_picture,
    stop_of,
)
from rig.capture.pictures.framing import confident_fraction, state_counts, tilt_correction_deg
from rig.capture.pictures.quality import Seen
from rig.capture.pictures.take import seen_at, take_pictures
from rig.config.directions import Direction
from rig.devices.camera.frames import TimedFrame
from rig.devices.connect import Rig
from rig.devices.pan_tilt import HeadState
from rig.errors import GoalError
from rig.fault_notes import note_fault

MAX_VIEWS = 5
SEARCH_TILT_DEG = 15.0
ASIDE_DEG = 5.0  # allowed offset of a frame's direction, as the pan range is less than a full turn
PLAY_DEG = 0.5


@dataclass(frozen=True)
class View:
    """Frames and readings at one position of the head; ``pointing`` uses the heading known at that time."""

    before: HeadState
    state: HeadState
    stop: Stop
    frames: list[TimedFrame]
    image_bgr: NDArray[np.uint8]
    pointing: Attitude
    skyline_share: float
    skyline_states: dict[str, int]
    tilt_correction_deg: float | None


def aim_and_take(
    rig: Rig, direction: Direction, base_estimate: BaseEstimate, head: Head, seen: list[Seen] | None = None
) -> View:
    """Point at a direction and tilt until the skyline lies well in the picture.

    ``seen`` are all earlier views, in any direction; those of this call are added to it.

    Starts at tilt 0. Without any skyline it tries once higher and once lower. After ``MAX_VIEWS`` views, or at the tilt
    limit, the view with most skyline is returned.
    """
    seen = [] if seen is None else seen
    tilts_to_search = [SEARCH_TILT_DEG, -SEARCH_TILT_DEG]
    tilt_deg = 0.0
    views: list[View] = []
    while len(views) < MAX_VIEWS:
        try:
            joints = nearest_reachable_joints(direction.azimuth_deg, tilt_deg, base_estimate.attitude, head)
        except GoalError:
            if not views:
                raise
            break
        view = take_view(rig, joints, base_estimate, head, seen)
        # The last frame, not the mean: a camera that freezes during a view would mix old content into the
        # mean.
        seen.append(seen_at(joints, view.frames[-1].image_bgr))
        views.append(view)
        if view.tilt_correction_deg == 0.0:
            return view
        if view.tilt_correction_deg is not None:
            tilt_deg = view.pointing.tilt_deg + view.tilt_correction_deg
        elif tilts_to_search:
            tilt_deg = tilts_to_search.pop(0)
        else:
            break
    return max(reversed(views), key=lambda view: view.skyline_share)


def nearest_reachable_joints(azimuth_deg: float, tilt_deg: float, base: Attitude, head: Head) -> JointAngles:
    """Joint angles for a direction, or for the nearest reachable one within ``ASIDE_DEG``.

    The pan range is less than a full turn, and the bundle records the actual azimuth. ``GoalError`` of the direction
    itself if none is reachable.
    """
    try:
        return joints_for(azimuth_deg, tilt_deg, base, head)
    except GoalError:
        for aside_deg in np.arange(0.5, ASIDE_DEG + 0.25, 0.5):
            for side in (-1.0, 1.0):
                try:
                    return joints_for(azimuth_deg + side * float(aside_deg), tilt_deg, base, head)
                except GoalError:
                    continue
        raise


def in_sweep_order(
    directions: Sequence[Direction], base: Attitude, head: Head, pan_deg: float
) -> list[Direction]:
    """The directions ordered for one sweep of the pan, starting at the nearer end. ``GoalError`` for an unreachable
    one.
    """
    pans = {d.label: nearest_reachable_joints(d.azimuth_deg, 0.0, base, head).pan_deg for d in directions}
    sweep = sorted(directions, key=lambda direction: pans[direction.label])
    first, last = pans[sweep[0].label], pans[sweep[-1].label]
    return sweep if abs(pan_deg - first) <= abs(pan_deg - last) else sweep[::-1]


def take_view(
    rig: Rig, joints: JointAngles, base_estimate: BaseEstimate, head: Head, seen: Sequence[Seen]
) -> View:
    """Move to joint angles, take pictures and read all sensors that determine the camera's attitude."""
    camera = rig.config.camera
    before = rig.pan_tilt.go_to(joints.pan_deg, joints.tilt_deg)
    average_s = rig.config.inclinometer.average_s
    levelling = rig.readers.submit(still_level, rig, average_s)
    heading = rig.readers.submit(read_compass_during_picture, rig, average_s)
    exposed_s = timebase.monotonic_s() + camera.exposure_settle_s
    pictures = take_pictures(rig.camera, camera.frames_per_direction, exposed_s, joints, seen)
    level, still_since_s = levelling.result()
    if pictures.frames[0].not_before_s < still_since_s:  # the mast still swung
        pictures = take_pictures(rig.camera, camera.frames_per_direction, still_since_s, joints, seen)
    readings = heading.result()
    after = rig.pan_tilt.state()
    require_stationary(before, after, "a frame was taken")
    joints_seen = JointAngles((before.pan_deg + after.pan_deg) / 2, (before.tilt_deg + after.tilt_deg) / 2)
    stop = stop_of(after.ticks, joints_seen, level, readings)
    pointing = derive.pointing(base_estimate, joints_seen, level, head)
    _compare_tilts(rig, base_estimate, joints_seen, level)
    margin = rig.config.capture.skyline_margin_fraction
    skyline = pictures.skyline
    return View(
        before,
        after,
        stop,
        pictures.frames,
        pictures.image_bgr,
        pointing,
        confident_fraction(skyline),
        state_counts(skyline),
        tilt_correction_deg(skyline, camera.fy_px, camera.height_px, margin),
    )


def _compare_tilts(rig: Rig, base_estimate: BaseEstimate, joints: JointAngles, level: HeadLevel) -> None:
    """Note a tilt joint that disagrees with the inclinometer; the inclinometer is used.

    ``DeviceError`` if they differ by a factor.
    """
    measured_deg = level.tilt_deg - base_estimate.level.tilt_zero_deg
    require_agreement(base_estimate.attitude, joints, measured_deg, rig.inclinometer.identify())
    by_joints_deg = body_attitude(head_rotation(base_estimate.attitude, joints)).tilt_deg
    if abs(measured_deg - by_joints_deg) > PLAY_DEG:
        note_fault(
            "tilt servo",
            "stands more than 0.5 deg away from where the inclinometer finds the head: play in the gear",
            "tilt taken from the inclinometer",
        )
