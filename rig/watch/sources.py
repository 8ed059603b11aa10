"""Reads each device for ``rig watch`` and the daemon. Reads only: the head's torque and position are not changed."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, closing, contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from rig import timebase
from rig.attitude.altitude_plausibility import AltitudeBounds, altitude_bounds, require_plausible_altitude
from rig.attitude.level import in_axes
from rig.attitude.talker_headings import heading_notes
from rig.capture.averaged_readings import altitude_from, read_level, read_pressure
from rig.check.devices import BRIGHT, DARK
from rig.config.model import RigConfig
from rig.config.sections import (
    AltimeterSection,
    CameraSection,
    CompassSection,
    InclinometerSection,
    Mmc5983maSection,
    NmeaCompassSection,
    PanTiltSection,
    Place,
)
from rig.config.sections import Servo as ServoSection
from rig.devices.bus.retry import retry
from rig.devices.bus.serial_port import SerialPort
from rig.devices.camera.driver import Camera
from rig.devices.camera.frames import TimedFrame
from rig.devices.connect import open_altimeter, open_compass, open_inclinometer
from rig.devices.dynamixel.servo import Servo
from rig.devices.dynamixel.servo_bus import ServoBus
from rig.devices.dynamixel.servo_group import read_states, require_models
from rig.devices.readings import FieldReading, HeadingReading
from rig.errors import DeviceError, RigError

HEAD_PAUSE_S = 0.2
LEVEL_S = 0.4
COMPASS_S = 0.3
PRESSURE_S = 0.5
CAMERA_S = 1.0


@dataclass(frozen=True)
class Reading:
    """A reading: JSON values with units in their names. ``warnings`` are problems of a device that answers."""

    values: Mapping[str, Any]
    monotonic_s: float
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class Source:
    """An open device. ``read`` averages over a suitable time and raises ``RigError``."""

    identity: str
    read: Callable[[], Reading]


Opener = Callable[[], AbstractContextManager[Source]]


def sources_of(config: RigConfig) -> dict[str, Opener]:
    """A function to open each configured device, by the device's name."""
    found: dict[str, Opener] = {
        "head": partial(_head, config.pan_tilt),
        "inclinometer": partial(_inclinometer, config.inclinometer),
    }
    if config.compass:
        found["compass"] = partial(_compass, config.compass, config.place)
    if config.altimeter:
        found["altimeter"] = partial(_altimeter, config.altimeter, altitude_bounds(config))
    return {**found, "camera": partial(_camera, config.camera)}


@contextmanager
def _head(section: PanTiltSection) -> Iterator[Source]:
    """Both servos, on its own bus object: ``PanTilt`` would switch the torque off and write limits."""
    with closing(ServoBus(SerialPort(section.port, section.baud))) as bus:
        joints = {"pan": section.pan, "tilt": section.tilt}
        servos = {name: Servo(bus, joint.id, joint.model, name) for name, joint in joints.items()}
        firmware = retry(partial(require_models, bus, {joint.id: joint.model for joint in joints.values()}))
        for servo in servos.values():
            retry(servo.ensure_reads_answered)
        identity = ", ".join(
            f"{name} {joint.model} firmware {firmware[joint.id]} (id {joint.id})"
            for name, joint in joints.items()
        )
        yield Source(identity, partial(_read_head, bus, servos, joints))


def _turned_by_hand(servo: Servo, position_tick: int) -> list[str]:
    try:
        servo.require_one_turn(position_tick)
    except DeviceError as error:
        return [f"{servo.name}: {error.problem}; turn it back by hand"]
    return []


def _read_head(bus: ServoBus, servos: Mapping[str, Servo], joints: Mapping[str, ServoSection]) -> Reading:
    timebase.sleep(HEAD_PAUSE_S)
    states = retry(partial(read_states, bus, list(servos.values())))
    warnings: list[str] = []
    values: dict[str, Any] = {}
    for (name, servo), state in zip(servos.items(), states, strict=True):
        values[f"{name}_deg"] = round(joints[name].angle_deg(state.position_tick), 3)
        warnings += _turned_by_hand(servo, state.position_tick)
        if state.alert:
            warnings += [f"{servo.name}: {error}" for error in retry(servo.hardware_errors)]
    values |= {
        "moving": any(state.moving for state in states),
        "torque": [bool(retry(partial(servo.read, "Torque Enable"))) for servo in servos.values()],
        "volts_v": [round(state.voltage_v, 2) for state in states],
        "temperatures_c": [state.temperature_c for state in states],
        "ticks": [state.position_tick for state in states],
    }
    return Reading(values, states[0].monotonic_s, tuple(warnings))


@contextmanager
def _inclinometer(section: InclinometerSection) -> Iterator[Source]:
    with closing(open_inclinometer(section)) as chip:

        def read() -> Reading:
            level, _, _ = read_level(chip, section, LEVEL_S)
            values = {
                "tilt_deg": round(level.tilt_deg, 4),
                "roll_deg": round(level.roll_deg, 4),
                "noise_deg": round(max(level.tilt_noise_deg, level.roll_noise_deg), 5),
                "temperature_c": _rounded(level.temperature_c),
            }
            return Reading(values, timebase.monotonic_s())

        yield Source(chip.identify(), read)


@contextmanager
def _compass(section: CompassSection, place: Place | None) -> Iterator[Source]:
    with closing(open_compass(section)) as compass:

        def read() -> Reading:
            readings = retry(partial(compass.read_many, COMPASS_S))
            last = readings[-1]
            if isinstance(last, HeadingReading):
                assert isinstance(section, NmeaCompassSection)
                return _heading(last, _heading_notes(last, section, place))
            assert isinstance(section, Mmc5983maSection)
            return _field([each for each in readings if isinstance(each, FieldReading)], section)

        yield Source(compass.identify(), read)


def _heading_notes(
    reading: HeadingReading, section: NmeaCompassSection, place: Place | None
) -> tuple[str, ...]:
    """The notes, or the error, that a capture would make of a heading."""
    try:
        return tuple(heading_notes([reading], section, place))
    except RigError as error:
        return (str(error),)


def _heading(reading: HeadingReading, warnings: tuple[str, ...]) -> Reading:
    values = {
        "heading_deg": reading.heading_deg,
        "reference": reading.reference,
        "variation_deg": reading.variation_deg,
        "pitch_deg": reading.pitch_deg,
        "roll_deg": reading.roll_deg,
    }
    return Reading(values, reading.monotonic_s, warnings)


def _field(readings: list[FieldReading], section: Mmc5983maSection) -> Reading:
    """The field in axes of the pan stage, corrected for the stage's calibrated iron."""
    chip_ut = np.array([[reading.x_ut, reading.y_ut, reading.z_ut] for reading in readings]).mean(axis=0)
    stage_ut = in_axes(chip_ut, section.axes) - np.array(section.hard_iron_ut)
    right_ut, ahead_ut, up_ut = np.linalg.solve(np.array(section.soft_iron), stage_ut).tolist()
    values = {
        "field_right_ut": round(right_ut, 3),
        "field_ahead_ut": round(ahead_ut, 3),
        "field_up_ut": round(up_ut, 3),
        "field_ut": round(math.hypot(right_ut, ahead_ut, up_ut), 3),
        "temperature_c": _rounded(readings[-1].temperature_c),
    }
    return Reading(values, readings[-1].monotonic_s)


@contextmanager
def _altimeter(section: AltimeterSection, bounds: Sequence[AltitudeBounds]) -> Iterator[Source]:
    with closing(open_altimeter(section)) as barometer:

        def read() -> Reading:
            pressure = read_pressure(barometer, PRESSURE_S)
            altitude = altitude_from(pressure, section)
            values = {
                "pressure_hpa": round(pressure.pressure_hpa, 3),
                "altitude_m": round(altitude.altitude_m, 2),
                "altitude_sigma_m": round(altitude.sigma_m, 2),
                "temperature_c": _rounded(pressure.temperature_c),
            }
            try:
                require_plausible_altitude(
                    altitude.altitude_m, pressure.pressure_hpa, section, barometer.identify(), bounds
                )
            except DeviceError as error:
                return Reading(values, timebase.monotonic_s(), (f"{error.problem}; {error.remedy}",))
            return Reading(values, timebase.monotonic_s())

        yield Source(barometer.identify(), read)


@contextmanager
def _camera(section: CameraSection) -> Iterator[Source]:
    with Camera(section) as camera:
        camera.wait_open()
        yield Source(camera.identify(), partial(_read_camera, camera))


def _read_camera(camera: Camera) -> Reading:
    """Frame rate over a second, and checks of the first and the last frame."""
    first = last = camera.frame_after(timebase.monotonic_s())
    count = 1
    while last.arrived.monotonic_s - first.arrived.monotonic_s < CAMERA_S:
        (last,) = camera.frames_after(math.nextafter(last.arrived.monotonic_s, math.inf), 1)
        count += 1
    span_s = last.arrived.monotonic_s - first.arrived.monotonic_s
    level = float(last.image_bgr.mean())
    values = {"frames_per_s": round((count - 1) / span_s, 1), "brightness": round(level, 1)}
    return Reading(values, last.arrived.monotonic_s, _picture_warnings(first, last, level))


def _picture_warnings(first: TimedFrame, last: TimedFrame, level: float) -> tuple[str, ...]:
    if not DARK <= level <= BRIGHT:
        colour = "black" if level < DARK else "white"
        return (f"its picture is all {colour}: look at lens cap and exposure",)
    if np.array_equal(first.image_bgr, last.image_bgr):
        return ("its picture has not changed in the least for a second: restart the camera",)
    return ()


def _rounded(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else round(value, 1)
