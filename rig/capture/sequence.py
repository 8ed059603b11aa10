"""One capture: base attitude, then a frame of the skyline in each direction, then the bundle."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from localizer.bundle import Altitude
from localizer.errors import SkyfixError
from localizer.skyline.find import find_skyline
from rig import clock, event_bus, timebase
from rig.attitude.altitude_plausibility import altitude_bounds
from rig.attitude.kinematics import Head, JointAngles
from rig.bundle.writer import Measurement, require_writable, write_bundle
from rig.capture import derive
from rig.capture.averaged_readings import AltitudeReading, read_altitude, utc_text
from rig.capture.base_attitude import (
    BaseEstimate,
    compass_record,
    estimate_base,
    measure_base,
)
from rig.capture.pictures.take import seen_at
from rig.capture.progress import ProgressReporter, PublishingReporter
from rig.capture.view import View, aim_and_take, in_sweep_order
from rig.config.directions import Direction
from rig.config.model import RigConfig
from rig.devices.bus.retry import retry
from rig.devices.connect import Rig, connect
from rig.errors import RigError
from rig.fault_notes import collecting, note_fault

if TYPE_CHECKING:
    from localizer.dem.lattice import Dem

CLOCK_STEP_S = 1.0


class CaptureError(RigError):
    """The devices work, but their readings make no usable measurement."""


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

    In every case, also when interrupted, the torque is off afterwards and no incomplete bundle is left. Raises
    ``DeviceError``, ``GoalError`` or ``ConfigError`` as the parts do, ``BundleWriteError`` if the bundle cannot be
    written, ``CaptureError`` if no frame shows a skyline.
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
    """As ``measure``, then move the head to its parking position, also after a failure.

    A failure to park is only noted: the measurement is valid.
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
    """All content of a bundle, frames in the order of ``directions``.

    ``CaptureError`` if no frame shows a skyline, or a reading is older than [capture] oldest_reading_s.
    """
    report.doing("level and heading")
    reading = rig.readers.submit(_altitude, rig, dem)
    parked = rig.pan_tilt.state()
    first = retry(lambda: rig.camera.frame_after(timebase.monotonic_s())).image_bgr
    seen = [seen_at(JointAngles(parked.pan_deg, parked.tilt_deg), first)]
    # Loading compiled code takes a second: done in parallel with the first moves.
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
    """Raise ``CaptureError`` for an older reading: vehicle, weather or light may have changed since."""
    now = clock.utc_now()
    name, time_of = min(times.items(), key=lambda item: item[1])
    age_s = (now - time_of).total_seconds()
    if age_s > oldest_s:
        raise CaptureError(
            f"{name} is {age_s:.0f} s old, more than {oldest_s:g} s ([capture] oldest_reading_s): "
            "look at what held the capture up, and take it again"
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
