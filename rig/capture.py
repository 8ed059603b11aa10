"""One capture: how the vehicle stands, then a frame of the skyline in each direction, then the bundle."""

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from localizer.bundle import Altitude
from localizer.horizon.from_image import find_skyline
from rig import derive
from rig.attitude import HeadLevel
from rig.bundle_writer import FrameRecord, Measurement, require_writable, write_bundle
from rig.camera import TimedFrame, average
from rig.config import RigConfig
from rig.connect import Rig, connect
from rig.directions import Direction
from rig.errors import DeviceError, GoalError, RigError
from rig.framing import confident_fraction, state_counts, tilt_correction_deg
from rig.kinematics import Attitude, Head, JointAngles, joints_for
from rig.measure import AltitudeReading, read_altitude, still_level, utc_text
from rig.pan_tilt import HeadState
from rig.progress import Reporter
from rig.standing import Standing, measure_standing

MOST_VIEWS = 5
SEARCH_TILT_DEG = 15.0
ASIDE_DEG = 5.0  # how far from its direction a frame may be taken where the pan does not reach quite round
NUDGED_TICKS = 4


class CaptureError(RigError):
    """The devices work, but what they see is no measurement."""


@dataclass(frozen=True)
class View:
    """What was read while the head stood in one position."""

    before: HeadState
    state: HeadState
    level: HeadLevel
    frames: list[TimedFrame]
    image_bgr: NDArray[np.uint8]
    pointing: Attitude
    skyline_share: float
    skyline_states: dict[str, int]
    tilt_correction_deg: float | None


def capture(config: RigConfig, directions: Sequence[Direction], out_dir: Path, report: Reporter) -> Path:
    """Take a bundle into ``out_dir`` and return its directory.

    Whatever happens, an interruption too, the head is left without torque and no incomplete bundle behind.
    Raises ``DeviceError``, ``GoalError`` or ``ConfigError`` as the parts do, ``BundleWriteError`` where the
    bundle cannot be written, ``CaptureError`` where no frame shows a skyline.
    """
    require_writable(out_dir)
    report.doing("connecting")
    with connect(config) as rig:
        measurement = measure(rig, directions, report)
    report.doing("writing the bundle")
    return write_bundle(out_dir, measurement)


def measure(rig: Rig, directions: Sequence[Direction], report: Reporter) -> Measurement:
    """Everything that goes into a bundle, frames in the order of ``directions``."""
    report.doing("level and heading")
    reading = rig.readers.submit(_altitude, rig)
    # Compiled code takes a second to load: better now than while the head waits for it.
    loading = rig.readers.submit(find_skyline, rig.camera.frame_after(time.monotonic()).image_bgr)
    standing = measure_standing(rig)
    altitude = reading.result()
    loading.result()
    report.done(_standing_line(standing, altitude))
    head = Head.from_config(rig.config)
    frames = {}
    for direction in in_passing(directions, standing.attitude, head, rig.pan_tilt.state().pan_deg):
        report.doing(f"looking {direction.label}")
        view = look(rig, direction, standing, head)
        report.done(_view_line(direction, view))
        frames[direction.label] = _frame_record(rig.config, direction, standing, view)
    if not any(frame.raw["skyline"]["share"] for frame in frames.values()):
        raise CaptureError(
            f"no skyline in any of {len(frames)} frames: look at the lens, the light and the weather, "
            "or move to where the horizon is open"
        )
    return Measurement(
        created=datetime.now(UTC),
        camera=derive.bundle_camera(rig.config),
        mast_height_m=rig.config.rig.mast_height_m,
        altitude=Altitude(value_m=altitude.altitude_m, sigma_m=altitude.sigma_m) if altitude else None,
        azimuth_bias_sigma_deg=derive.azimuth_bias_sigma_deg(rig.config, standing),
        tilt_bias_sigma_deg=derive.tilt_bias_sigma_deg(rig.config, standing),
        frames=[frames[direction.label] for direction in directions],
        raw={
            "rig": rig.config.rig.name,
            "pan_tilt": rig.pan_tilt.identify(),
            "inclinometer": rig.inclinometer.identify(),
            "altimeter": altitude.raw if altitude else None,
            **standing.raw,
        },
        calibration=derive.calibration_record(rig.config, standing),
    )


def look(rig: Rig, direction: Direction, standing: Standing, head: Head) -> View:
    """Point at a direction and tilt until the skyline lies well in the picture.

    Begins at tilt 0. Where the picture shows no skyline at all, looks higher and lower once each. After
    ``MOST_VIEWS`` views, or where the head does not tilt further, the view with most skyline is taken.
    """
    tilts_to_search = [SEARCH_TILT_DEG, -SEARCH_TILT_DEG]
    tilt_deg = 0.0
    views: list[View] = []
    while len(views) < MOST_VIEWS:
        try:
            joints = joints_beside(direction.azimuth_deg, tilt_deg, standing.attitude, head)
        except GoalError:
            if not views:
                raise
            break
        view = _view(rig, joints, standing, head)
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


def joints_beside(azimuth_deg: float, tilt_deg: float, base: Attitude, head: Head) -> JointAngles:
    """Joint angles for a direction, or for the nearest one within ``ASIDE_DEG`` that the head reaches.

    The pan stops short of a whole turn, and the bundle records where a frame was really taken. ``GoalError`` of
    the direction itself where none is reached.
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


def in_passing(
    directions: Sequence[Direction], base: Attitude, head: Head, pan_deg: float
) -> list[Direction]:
    """The directions in one sweep of the pan, from the end that is nearer. ``GoalError`` for one out of reach."""
    pans = {d.label: joints_beside(d.azimuth_deg, 0.0, base, head).pan_deg for d in directions}
    sweep = sorted(directions, key=lambda direction: pans[direction.label])
    first, last = pans[sweep[0].label], pans[sweep[-1].label]
    return sweep if abs(pan_deg - first) <= abs(pan_deg - last) else sweep[::-1]


def _view(rig: Rig, joints: JointAngles, standing: Standing, head: Head) -> View:
    camera = rig.config.camera
    rig.pan_tilt.move_to(joints.pan_deg, joints.tilt_deg)
    before = rig.pan_tilt.wait_settled()
    levelling = rig.readers.submit(still_level, rig, rig.config.inclinometer.average_s)
    exposed_s = time.monotonic() + camera.exposure_settle_s
    frames = rig.camera.frames_after(exposed_s, camera.frames_per_direction)
    image = average(frames)
    skyline = find_skyline(image)
    level, still_since_s = levelling.result()
    if frames[0].not_before_s < still_since_s:  # the mast still swung
        frames = rig.camera.frames_after(time.monotonic(), camera.frames_per_direction)
        image = average(frames)
        skyline = find_skyline(image)
    after = rig.pan_tilt.state()
    moved_ticks = max(abs(a - b) for a, b in zip(before.ticks, after.ticks, strict=True))
    if moved_ticks > NUDGED_TICKS:
        raise DeviceError(
            "pan and tilt head",
            f"moved by {moved_ticks} ticks while a frame was taken",
            "look for what pushes it",
        )
    joints_seen = JointAngles((before.pan_deg + after.pan_deg) / 2, (before.tilt_deg + after.tilt_deg) / 2)
    pointing = derive.pointing(standing, joints_seen, level, head)
    margin = rig.config.capture.skyline_margin_fraction
    return View(
        before,
        after,
        level,
        frames,
        image,
        pointing,
        confident_fraction(skyline),
        state_counts(skyline),
        tilt_correction_deg(skyline, camera.fy_px, camera.height_px, margin),
    )


def _altitude(rig: Rig) -> AltitudeReading | None:
    if rig.altimeter is None or rig.config.altimeter is None:
        return None
    return read_altitude(rig.altimeter, rig.config.altimeter)


def _frame_record(config: RigConfig, direction: Direction, standing: Standing, view: View) -> FrameRecord:
    return FrameRecord(
        label=direction.label,
        image_bgr=view.image_bgr,
        time=view.frames[len(view.frames) // 2].arrived.utc,
        azimuth_deg=view.pointing.azimuth_deg,
        azimuth_sigma_deg=config.pan_tilt.azimuth_sigma_deg,
        tilt_deg=view.pointing.tilt_deg,
        tilt_sigma_deg=derive.tilt_sigma_deg(config, view.level),
        roll_deg=view.pointing.roll_deg,
        roll_sigma_deg=derive.roll_sigma_deg(config, standing, view.level),
        raw={
            "requested_azimuth_deg": direction.azimuth_deg,
            "ticks": list(view.state.ticks),
            "ticks_before": list(view.before.ticks),
            "servo_volts": list(view.state.volts),
            "servo_temperatures_c": list(view.state.temps),
            "inclinometer": asdict(view.level),
            "frame_times": [utc_text(frame.arrived.utc) for frame in view.frames],
            "skyline": {"share": view.skyline_share, "columns": view.skyline_states},
        },
    )


def _standing_line(standing: Standing, altitude: AltitudeReading | None) -> str:
    base, heading = standing.attitude, standing.heading
    parts = [
        f"heading {base.azimuth_deg:.1f} +- {heading.sigma_deg:.1f}",
        f"pitch {base.tilt_deg:.2f}",
        f"roll {base.roll_deg:.2f} deg (residual {standing.level.residual_deg:.3f})",
    ]
    if altitude:
        parts.append(f"altitude {altitude.altitude_m:.1f} +- {altitude.sigma_m:.1f} m")
    return "vehicle: " + ", ".join(parts)


def _view_line(direction: Direction, view: View) -> str:
    seen = f"skyline in {view.skyline_share:.0%} of the columns" if view.skyline_share else "no skyline"
    pointing = view.pointing
    return (
        f"{direction.label}: azimuth {pointing.azimuth_deg:.2f}, tilt {pointing.tilt_deg:.2f}, "
        f"roll {pointing.roll_deg:.2f} deg; {seen}"
    )
