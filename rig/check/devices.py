"""``rig check``: connects to every device, checks identity, readings and noise. Nothing moves."""

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from localizer.errors import SkyfixError
from rig import sysfs, timebase
from rig.attitude.altitude_plausibility import AltitudeBounds, altitude_bounds
from rig.attitude.magnetic_model import date_problem
from rig.attitude.talker_headings import heading_notes
from rig.capture.averaged_readings import read_altitude, read_level, utc_text
from rig.check.compass import field_check, heading_check
from rig.check.result import DeviceCheck
from rig.clock import problem as clock_problem
from rig.clock import wall_clock
from rig.config.model import RigConfig
from rig.config.sections import (
    AltimeterSection,
    CameraSection,
    CompassSection,
    InclinometerSection,
    Mmc5983maSection,
    PanTiltSection,
    Place,
)
from rig.devices.bus.retry import retry
from rig.devices.bus.serial_port import MAX_LATENCY_MS
from rig.devices.camera.driver import Camera
from rig.devices.connect import open_altimeter, open_compass, open_inclinometer, open_pan_tilt
from rig.devices.dynamixel.scan import scan_hint
from rig.devices.pan_tilt import HeadState, PanTilt
from rig.devices.readings import FieldReading, HeadingReading
from rig.devices.sensors.agreement import RELABELLED
from rig.errors import DeviceError, RigError, TransientError
from rig.fault_notes import collecting

if TYPE_CHECKING:
    from localizer.dem.lattice import Dem

LEVEL_NOISE_LIMIT_DEG = 0.005
SERVO_NOISE_LIMIT_DEG = 0.3
"""The encoder's noise is one tick, 0.09 deg; more means that the head moves."""
PRESSURE_NOISE_LIMIT_HPA = 0.3
"""2.5 m of altitude."""
CAMERA_NOISE_LIMIT = 20.0
READING_S = 0.5
SERVO_STATES = 10
DARK, BRIGHT = 3.0, 252.0


def check_devices(config: RigConfig, dem: "Dem | None" = None) -> list[DeviceCheck]:
    """Connect to all configured devices in parallel and read them. A failure is reported in the result, not raised.

    An altitude that is impossible over ``dem`` is a failure.
    """
    checks: list[tuple[str, Callable[[], DeviceCheck]]] = [
        ("pan and tilt", partial(check_pan_tilt, config.pan_tilt)),
        ("inclinometer", partial(check_inclinometer, config.inclinometer)),
    ]
    if config.compass:
        checks.append(("compass", partial(check_compass, config.compass, config.place)))
    if config.altimeter:
        checks.append(("altimeter", partial(check_altimeter, config.altimeter, altitude_bounds(config, dem))))
    checks.append(("camera", partial(check_camera, config.camera)))
    with ThreadPoolExecutor(len(checks)) as pool:
        return [*pool.map(lambda check: _guarded(*check), checks), *check_clock()]


def check_clock() -> list[DeviceCheck]:
    """The computer's clock: a result if it is implausible or outside the magnetic model's validity, else none."""
    now = wall_clock()
    wrong = clock_problem(now) or date_problem(now)
    if wrong is None:
        return []
    remedy = "set it: from a GPS, the network or by hand (timedatectl), and give the computer a battery-backed clock"
    return [DeviceCheck("clock", "computer's clock", utc_text(now), "", (), (), f"{wrong}; {remedy}")]


def check_all(
    config: RigConfig, dem: "Dem | None" = None, dem_paths: Sequence[Path] = ()
) -> list[DeviceCheck]:
    """``check_devices`` with the ground of ``dem``, of the given files, or of the DEM in [run]. Unreadable files give a
    result of their own.
    """
    from localizer.dem.choice import DemChoice

    choice = DemChoice(tuple(dem_paths)) if dem_paths else config.run.chosen_dem if config.run else None
    unread = []
    if dem is None and choice is not None:
        try:
            dem = choice.load()
        except SkyfixError as error:
            unread = [DeviceCheck("elevation model", "", "", "", (), (), str(error))]
    return [*check_devices(config, dem), *unread]


def check_pan_tilt(section: PanTiltSection) -> DeviceCheck:
    """The servos, torque off."""
    try:
        head = open_pan_tilt(section)
    except TransientError as error:
        hint = scan_hint(section.port, section.baud)
        raise error if hint is None else TransientError(error.device, error.problem, hint) from error
    with head:
        begun_s = timebase.monotonic_s()
        states = [head.state() for _ in range(SERVO_STATES)]
        answer_ms = (timebase.monotonic_s() - begun_s) * 1000.0 / SERVO_STATES
        last = states[-1]
        pan_deg, tilt_deg = np.std([[state.pan_deg, state.tilt_deg] for state in states], axis=0)
        scatter_deg = float(max(pan_deg, tilt_deg))
        moves = (
            f"scatter of {scatter_deg:.2f} deg is above {SERVO_NOISE_LIMIT_DEG} deg: the head moves; shelter it from the wind, "
            "let nobody hold it"
        )
        problems = [
            *last.alerts,
            *([moves] if scatter_deg > SERVO_NOISE_LIMIT_DEG else []),
            *_turned_by_hand(head, last),
        ]
        return DeviceCheck(
            "pan and tilt",
            head.identify(),
            f"pan {last.pan_deg:z.1f}, tilt {last.tilt_deg:z.1f} deg",
            f"{scatter_deg:.3f} deg",
            last.volts,
            last.temps,
            "; ".join(problems) or None,
            {
                "pan_deg": last.pan_deg,
                "tilt_deg": last.tilt_deg,
                "noise_deg": scatter_deg,
                "answer_ms": answer_ms,
            },
            tuple(_latency_hints(section.port)),
        )


def _latency_hints(port: str) -> Sequence[str]:
    latency_ms = sysfs.serial_latency_ms(port)
    if latency_ms is None or latency_ms <= MAX_LATENCY_MS:
        return ()
    file = sysfs.serial_latency_file(port)
    return (
        f"the adapter holds each answer back for {latency_ms} ms (latency_timer): echo 1 | sudo tee {file}, and for good the "
        "udev rule that rig service install brings (70-skyfix.rules)",
    )


def _turned_by_hand(head: PanTilt, state: HeadState) -> list[str]:
    try:
        head.require_one_turn(state)
    except DeviceError as error:
        return [str(error)]
    return []


def check_inclinometer(section: InclinometerSection) -> DeviceCheck:
    """One reading, averaged as in a capture."""
    with closing(open_inclinometer(section)) as chip:
        level, _, _ = read_level(chip, section, section.average_s)
        temperature_c = retry(partial(chip.read_many, 0.0))[-1].temperature_c
        noise_deg = max(level.tilt_noise_deg, level.roll_noise_deg)
        shaky = (
            f"noise of {noise_deg:.4f} deg is above {LEVEL_NOISE_LIMIT_DEG} deg; engine off? raise average_s"
        )
        return DeviceCheck(
            "inclinometer",
            chip.identify(),
            f"tilt {level.tilt_deg:z.3f}, roll {level.roll_deg:z.3f} deg",
            f"{noise_deg:.4f} deg in {section.average_s:g} s",
            (),
            (temperature_c,) if math.isfinite(temperature_c) else (),
            shaky if noise_deg > LEVEL_NOISE_LIMIT_DEG else None,
            {
                "tilt_deg": level.tilt_deg,
                "roll_deg": level.roll_deg,
                "noise_deg": noise_deg,
                "average_s": section.average_s,
            },
        )


def check_compass(section: CompassSection, place: Place | None = None) -> DeviceCheck:
    """Field or heading over half a second; for a talker also whether a true heading can be derived from what it sends."""
    with closing(open_compass(section)) as compass:
        readings = retry(partial(compass.read_many, READING_S))
        fields = [reading for reading in readings if isinstance(reading, FieldReading)]
        headings = [reading for reading in readings if isinstance(reading, HeadingReading)]
        if isinstance(section, Mmc5983maSection):
            return field_check(compass.identify(), fields, section)
        found = heading_check(compass.identify(), headings, section, place)
        if not found.ok:
            return found
        doubts = heading_notes(headings, section, place)
        return replace(found, reading="; ".join([found.reading, *doubts]))


def check_altimeter(section: AltimeterSection, bounds: Sequence[AltitudeBounds] | None = None) -> DeviceCheck:
    """Pressure and the derived altitude, which must lie within ``bounds``."""
    with closing(open_altimeter(section)) as barometer:
        with collecting() as faults:
            altitude = read_altitude(barometer, section, bounds)
        put_right = [note.problem for note in faults.all() if note.action == RELABELLED]
        temperature_c = altitude.raw["temperature_c"]
        pressure_hpa, scatter_hpa = altitude.raw["pressure_hpa"], altitude.raw["pressure_scatter_hpa"]
        restless = (
            f"scatter of {scatter_hpa:.2f} hPa is above {PRESSURE_NOISE_LIMIT_HPA} hPa; shelter its port from the wind, "
            "and close the doors"
        )
        return DeviceCheck(
            "altimeter",
            barometer.identify(),
            "; ".join([f"{pressure_hpa:.2f} hPa, {altitude.altitude_m:.1f} m", *put_right]),
            f"{scatter_hpa:.3f} hPa",
            (),
            () if temperature_c is None else (temperature_c,),
            restless if scatter_hpa > PRESSURE_NOISE_LIMIT_HPA else None,
            {
                "pressure_hpa": pressure_hpa,
                "altitude_m": altitude.altitude_m,
                "altitude_sigma_m": altitude.sigma_m,
                "noise_hpa": scatter_hpa,
            },
        )


def check_camera(section: CameraSection) -> DeviceCheck:
    """Image size, frame rate and brightness."""
    with Camera(section) as camera:
        camera.wait_open()
        frames = camera.frames_after(timebase.monotonic_s() + section.exposure_settle_s, 3)
        first, last = (frame.image_bgr.astype(np.float32) for frame in (frames[0], frames[-1]))
        light = float(last.mean())
        noise = float((last - first).std()) / math.sqrt(2)
        problem = None
        if not DARK <= light <= BRIGHT:
            problem = (
                f"its picture is all {'black' if light < DARK else 'white'}; look at lens cap and exposure"
            )
        elif noise > CAMERA_NOISE_LIMIT:
            problem = (
                f"noise of {noise:.0f} levels is above {CAMERA_NOISE_LIMIT:.0f}: the picture changes from frame to frame; hold "
                "the vehicle still, give it more light, look at the cable"
            )
        frozen = "its pictures are all the same: see that it is no still picture that the camera sends"
        return DeviceCheck(
            "camera",
            camera.identify(),
            f"{camera.frame_rate_hz:.1f} frames/s, mean level {light:.0f} of 255",
            f"{noise:.1f} levels",
            (),
            (),
            problem,
            {
                "frame_rate_hz": camera.frame_rate_hz,
                "mean_level": light,
                "noise_levels": noise,
                "width_px": section.width_px,
                "height_px": section.height_px,
            },
            (frozen,) if noise == 0.0 else (),
        )


def _guarded(device: str, check: Callable[[], DeviceCheck]) -> DeviceCheck:
    try:
        return check()
    except RigError as error:
        return DeviceCheck(device, "", "", "", (), (), str(error))
