"""One capture: how the vehicle stands, then a frame of the skyline in each direction, then the bundle."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from localizer.bundle import Altitude
from localizer.errors import SkyfixError
from localizer.skyline.find import find_skyline
from rig import clock, event_bus
from rig.attitude.altitude_plausibility import altitude_bounds
from rig.attitude.kinematics import Attitude, Head, JointAngles, body_attitude, head_rotation, joints_for
from rig.attitude.level import HeadLevel
from rig.attitude.tilt_agreement import require_agreement
from rig.bundle.writer import Measurement, require_writable, write_bundle
from rig.capture import derive
from rig.capture.averaged_readings import AltitudeReading, read_altitude, require_stood, still_level, utc_text
from rig.capture.base_attitude import (
    BaseEstimate,
    Stop,
    compass_record,
    estimate_base,
    measure_base,
    read_compass_during_picture,
    stop_of,
)
from rig.capture.pictures.framing import confident_fraction, state_counts, tilt_correction_deg
from rig.capture.pictures.quality import Seen
from rig.capture.pictures.take import seen_at, take_pictures
from rig.capture.progress import ProgressReporter, PublishingReporter
from rig.config.directions import Direction
from rig.config.model import RigConfig
from rig.devices.bus.retry import retry
from rig.devices.camera.driver import TimedFrame
from rig.devices.connect import Rig, connect
from rig.devices.pan_tilt import HeadState
from rig.errors import GoalError, RigError
from rig.fault_notes import collecting, note_fault

if TYPE_CHECKING:
    from localizer.dem.lattice import Dem

MAX_VIEWS = 5
SEARCH_TILT_DEG = 15.0
ASIDE_DEG = 5.0  # how far from its direction a frame may be taken where the pan does not reach quite round
PLAY_DEG = 0.5
CLOCK_STEP_S = 1.0


class CaptureError(RigError):
    """The devices work, but what they see is no measurement."""


@dataclass(frozen=True)
class View:
    """What was read while the head stood in one position; ``pointing`` is by the heading as it was known then."""

    before: HeadState
    state: HeadState
    stop: Stop
    frames: list[TimedFrame]
    image_bgr: NDArray[np.uint8]
    pointing: Attitude
    skyline_share: float
    skyline_states: dict[str, int]
    tilt_correction_deg: float | None


def capture(
    config: RigConfig,
    directions: Sequence[Direction],
    out_dir: Path,
    report: ProgressReporter,
    remarks: Mapping[str, Any] | None = None,
    *,
    park: bool = False,
    skip_failed_sensors: bool = False,
    dem: "Dem | None" = None,
) -> Path:
    """Take a bundle into ``out_dir`` and return its directory. ``remarks`` (JSON values) go into its ``raw``.

    With ``park`` the head moves to its parking position before the torque goes off. With ``skip_failed_sensors`` a
    compass or an altimeter that cannot be opened is left out. An altitude that is impossible over ``dem`` is refused.

    Whatever happens, an interruption too, the head is left without torque and no incomplete bundle behind.
    Raises ``DeviceError``, ``GoalError`` or ``ConfigError`` as the parts do, ``BundleWriteError`` where the
    bundle cannot be written, ``CaptureError`` where no frame shows a skyline.
    """
    report = PublishingReporter(report)
    require_writable(out_dir)
    clock.begin_session()
    report.doing("connecting")
    try:
        with collecting() as faults:
            if wrong := clock.problem():
                note_fault("wall clock", wrong, "times in this bundle are as wrong; the measurement is not")
                report.done(f"{wrong}: times in this bundle are as wrong; set it")
            with connect(config, skip_failed_sensors=skip_failed_sensors) as rig:
                measurement = (
                    measure_and_park(rig, directions, report, dem)
                    if park
                    else measure(rig, directions, report, dem)
                )
            step_s = clock.step_s()
            if abs(step_s) > CLOCK_STEP_S:
                note_fault(
                    "wall clock", f"stepped by {step_s:+.1f} s", "times are by the clock at the beginning"
                )
        report.doing("writing the bundle")
        raw = {**measurement.raw, **(remarks or {}), "faults": faults.as_json()}
        bundle_dir = write_bundle(out_dir, replace(measurement, raw=raw))
    except SkyfixError as error:
        event_bus.publish(event_bus.Step("error", "capture", str(error)))
        raise
    event_bus.publish(bundle_dir)
    return bundle_dir


def measure_and_park(
    rig: Rig, directions: Sequence[Direction], report: ProgressReporter, dem: "Dem | None" = None
) -> Measurement:
    """As ``measure``, and the head goes to its parking place, after a failure too.

    A head that does not get there is a note: what has been measured counts.
    """
    try:
        measurement = measure(rig, directions, report, dem)
    except RigError:
        _park(rig, report)
        raise
    _park(rig, report)
    return measurement


def _park(rig: Rig, report: ProgressReporter) -> None:
    section = rig.config.pan_tilt
    report.doing("parking")
    try:
        rig.pan_tilt.go_to(section.park_pan_deg, section.park_tilt_deg)
    except RigError as error:
        note_fault("pan and tilt head", f"cannot be parked: {error}", "let go where it stood")


def measure(
    rig: Rig, directions: Sequence[Direction], report: ProgressReporter, dem: "Dem | None" = None
) -> Measurement:
    """Everything that goes into a bundle, frames in the order of ``directions``.

    ``CaptureError`` where no frame shows a skyline, or a reading is older than [capture] oldest_reading_s.
    """
    report.doing("level and heading")
    reading = rig.readers.submit(_altitude, rig, dem)
    parked = rig.pan_tilt.state()
    first = retry(lambda: rig.camera.frame_after(time.monotonic())).image_bgr
    seen = [seen_at(JointAngles(parked.pan_deg, parked.tilt_deg), first)]
    # Compiled code takes a second to load: better now than while the head waits for it.
    loading = rig.readers.submit(find_skyline, first)
    base_estimate = measure_base(rig)
    altitude = reading.result()
    loading.result()
    event_bus.publish(base_estimate)
    if altitude:
        event_bus.publish(altitude)
    report.done(_base_line(base_estimate, altitude))
    north = base_estimate.heading.declination
    if north and north.doubt:
        report.done(f"compass: {north.doubt}: {north.action}")
    head = Head.from_config(rig.config)
    found: dict[str, derive.Shot] = {}
    for direction in in_sweep_order(directions, base_estimate.attitude, head, rig.pan_tilt.state().pan_deg):
        report.doing(f"looking {direction.label}")
        view = aim_and_take(rig, direction, base_estimate, head, seen)
        event_bus.publish(view)
        report.done(_view_line(direction, view))
        found[direction.label] = _shot_of(direction, view)
    shots = [found[direction.label] for direction in directions]
    if not any(shot.raw["skyline"]["share"] for shot in shots):
        raise CaptureError(
            f"no skyline in any of {len(shots)} frames: look at the lens, the light and the weather, "
            "or move to where the horizon is open"
        )
    times = {f"frame {shot.label}": shot.time for shot in shots}
    times |= {
        f"level and heading at stop {number}": stop.utc for number, stop in enumerate(base_estimate.stops, 1)
    }
    if altitude:
        times["altitude"] = altitude.utc
    require_fresh(times, rig.config.capture.oldest_reading_s)
    if any(shot.stop.has_compass for shot in shots):
        views = [shot.stop for shot in shots]
        base_estimate = estimate_base(rig.config, base_estimate.stops, base_estimate.raw["compass"], views)
        event_bus.publish(base_estimate)
    return Measurement(
        created=clock.utc_now(),
        camera=derive.bundle_camera(rig.config),
        mast_height_m=rig.config.rig.mast_height_m,
        altitude=Altitude(value_m=altitude.altitude_m, sigma_m=altitude.sigma_m) if altitude else None,
        azimuth_bias_sigma_deg=derive.azimuth_bias_sigma_deg(rig.config, base_estimate),
        tilt_bias_sigma_deg=derive.tilt_bias_sigma_deg(rig.config, base_estimate),
        frames=[derive.frame_record(rig.config, base_estimate, shot) for shot in shots],
        raw={
            "rig": rig.config.rig.name,
            "pan_tilt": rig.pan_tilt.identify(),
            "inclinometer": rig.inclinometer.identify(),
            "altimeter": altitude.raw if altitude else None,
            **base_estimate.raw,
        },
        calibration=derive.calibration_record(rig.config, base_estimate),
    )


def require_fresh(times: Mapping[str, datetime], oldest_s: float) -> None:
    """Raise ``CaptureError`` where a reading is older: the vehicle, the weather or the light is another by now."""
    now = clock.utc_now()
    name, time_of = min(times.items(), key=lambda item: item[1])
    age_s = (now - time_of).total_seconds()
    if age_s > oldest_s:
        raise CaptureError(
            f"{name} is {age_s:.0f} s old, more than {oldest_s:g} s ([capture] oldest_reading_s): "
            "look at what held the capture up, and take it again"
        )


def aim_and_take(
    rig: Rig, direction: Direction, base_estimate: BaseEstimate, head: Head, seen: list[Seen] | None = None
) -> View:
    """Point at a direction and tilt until the skyline lies well in the picture.

    ``seen`` are the views before this one, in whichever direction; those of this one are added to it.

    Begins at tilt 0. Where the picture shows no skyline at all, looks higher and lower once each. After
    ``MAX_VIEWS`` views, or where the head does not tilt further, the view with most skyline is taken.
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
        # The last one: a camera that freezes while a view is taken mixes what it saw before into the mean.
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


def in_sweep_order(
    directions: Sequence[Direction], base: Attitude, head: Head, pan_deg: float
) -> list[Direction]:
    """The directions in one sweep of the pan, from the end that is nearer. ``GoalError`` for one out of reach."""
    pans = {d.label: nearest_reachable_joints(d.azimuth_deg, 0.0, base, head).pan_deg for d in directions}
    sweep = sorted(directions, key=lambda direction: pans[direction.label])
    first, last = pans[sweep[0].label], pans[sweep[-1].label]
    return sweep if abs(pan_deg - first) <= abs(pan_deg - last) else sweep[::-1]


def take_view(
    rig: Rig, joints: JointAngles, base_estimate: BaseEstimate, head: Head, seen: Sequence[Seen]
) -> View:
    """Move to joint angles, and read all that tells where the camera looks while it takes its pictures."""
    camera = rig.config.camera
    before = rig.pan_tilt.go_to(joints.pan_deg, joints.tilt_deg)
    average_s = rig.config.inclinometer.average_s
    levelling = rig.readers.submit(still_level, rig, average_s)
    heading = rig.readers.submit(read_compass_during_picture, rig, average_s)
    exposed_s = time.monotonic() + camera.exposure_settle_s
    pictures = take_pictures(rig.camera, camera.frames_per_direction, exposed_s, joints, seen)
    level, still_since_s = levelling.result()
    if pictures.frames[0].not_before_s < still_since_s:  # the mast still swung
        pictures = take_pictures(rig.camera, camera.frames_per_direction, still_since_s, joints, seen)
    readings = heading.result()
    after = rig.pan_tilt.state()
    require_stood(before, after, "a frame was taken")
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
    """Note a tilt joint that disagrees with the inclinometer, which is the one that is believed.

    ``DeviceError`` where they disagree by a factor.
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


def _altitude(rig: Rig, dem: "Dem | None") -> AltitudeReading | None:
    if rig.altimeter is None or rig.config.altimeter is None:
        return None
    return read_altitude(rig.altimeter, rig.config.altimeter, altitude_bounds(rig.config, dem))


def _shot_of(direction: Direction, view: View) -> derive.Shot:
    return derive.Shot(
        label=direction.label,
        image_bgr=view.image_bgr,
        time=view.frames[len(view.frames) // 2].arrived.utc,
        stop=view.stop,
        raw={
            "requested_azimuth_deg": direction.azimuth_deg,
            "ticks": list(view.state.ticks),
            "ticks_before": list(view.before.ticks),
            "servo_volts": list(view.state.volts),
            "servo_temperatures_c": list(view.state.temps),
            "inclinometer": asdict(view.stop.level),
            **compass_record(view.stop),
            "frame_times": [utc_text(frame.arrived.utc) for frame in view.frames],
            "frame_monotonic_s": [round(frame.arrived.monotonic_s, 3) for frame in view.frames],
            "head_monotonic_s": [round(state.monotonic_s, 3) for state in (view.before, view.state)],
            "skyline": {"share": view.skyline_share, "columns": view.skyline_states},
        },
    )


def _base_line(base_estimate: BaseEstimate, altitude: AltitudeReading | None) -> str:
    base, heading = base_estimate.attitude, base_estimate.heading
    parts = [
        f"heading {base.azimuth_deg:.1f} +- {heading.sigma_deg:.1f}",
        f"pitch {base.tilt_deg:z.2f}",
        f"roll {base.roll_deg:z.2f} deg (residual {base_estimate.level.residual_deg:.3f})",
    ]
    if altitude:
        parts.append(f"altitude {altitude.altitude_m:.1f} +- {altitude.sigma_m:.1f} m")
    return "vehicle: " + ", ".join(parts)


def _view_line(direction: Direction, view: View) -> str:
    seen = f"skyline in {view.skyline_share:.0%} of the columns" if view.skyline_share else "no skyline"
    pointing = view.pointing
    return (
        f"{direction.label}: azimuth {pointing.azimuth_deg:.2f}, tilt {pointing.tilt_deg:z.2f}, "
        f"roll {pointing.roll_deg:z.2f} deg; {seen}"
    )
