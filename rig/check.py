"""Is every device there, the right one, and measuring? Nothing moves."""

import math
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console
from rich.table import Table

from localizer.errors import SkyfixError
from rig.attitude.heading import PLAUSIBLE_FIELD_UT, circular_mean_deg
from rig.attitude.kinematics import wrapped_deg
from rig.attitude.level import in_axes
from rig.bus.retry import retry
from rig.camera import Camera
from rig.config import (
    AltimeterSection,
    CameraSection,
    CompassSection,
    InclinometerSection,
    Mmc5983maSection,
    PanTiltSection,
    RigConfig,
)
from rig.connect import open_altimeter, open_compass, open_inclinometer, open_pan_tilt
from rig.errors import DeviceError, RigError
from rig.measure import read_altitude, read_level
from rig.pan_tilt import HeadState, PanTilt
from rig.possible_altitude import AltitudeBounds, altitude_bounds
from rig.readings import FieldReading, HeadingReading

if TYPE_CHECKING:
    from localizer.dem import Dem

LEVEL_NOISE_LIMIT_DEG = 0.005
READING_S = 0.5
SERVO_STATES = 10
DARK, BRIGHT = 3.0, 252.0
PLAIN_WIDTH = 160  # of the table where there is no terminal to fit it into


@dataclass(frozen=True)
class DeviceCheck:
    """What one device said. ``problem`` is None where all is well; volts and temperatures may be several, or none."""

    device: str
    identity: str
    reading: str
    noise: str
    volts: tuple[float, ...]
    temperatures_c: tuple[float, ...]
    problem: str | None

    @property
    def ok(self) -> bool:
        """Whether the device is fit for a capture."""
        return self.problem is None


def check_devices(config: RigConfig, dem: "Dem | None" = None) -> list[DeviceCheck]:
    """Connect to every configured device, all at once, and read it. A failure is in its row, not raised.

    An altitude that the ground of ``dem`` cannot have is one.
    """
    checks: list[tuple[str, Callable[[], DeviceCheck]]] = [
        ("pan and tilt", partial(check_pan_tilt, config.pan_tilt)),
        ("inclinometer", partial(check_inclinometer, config.inclinometer)),
    ]
    if config.compass:
        checks.append(("compass", partial(check_compass, config.compass)))
    if config.altimeter:
        checks.append(("altimeter", partial(check_altimeter, config.altimeter, altitude_bounds(config, dem))))
    checks.append(("camera", partial(check_camera, config.camera)))
    with ThreadPoolExecutor(len(checks)) as pool:
        return list(pool.map(lambda check: _guarded(*check), checks))


def check_all(
    config: RigConfig, dem: "Dem | None" = None, dem_paths: Sequence[Path] = ()
) -> list[DeviceCheck]:
    """``check_devices`` against the ground of ``dem``, or of the files, or of what [run] searches. Files that cannot be read
    are a row of their own.
    """
    from localizer.dem_options import DemChoice

    paths = tuple(dem_paths) or (config.run.dem if config.run else ())
    unread = []
    if dem is None and paths:
        try:
            dem = DemChoice(tuple(paths)).load()
        except SkyfixError as error:
            unread = [DeviceCheck("elevation model", "", "", "", (), (), str(error))]
    return [*check_devices(config, dem), *unread]


def check_pan_tilt(section: PanTiltSection) -> DeviceCheck:
    """The servos, without torque."""
    with open_pan_tilt(section) as head:
        states = [head.state() for _ in range(SERVO_STATES)]
        last = states[-1]
        scatter = np.std([[state.pan_deg, state.tilt_deg] for state in states], axis=0)
        return DeviceCheck(
            "pan and tilt",
            head.identify(),
            f"pan {last.pan_deg:z.1f}, tilt {last.tilt_deg:z.1f} deg",
            f"{scatter.max():.3f} deg",
            last.volts,
            last.temps,
            "; ".join([*last.alerts, *_turned_by_hand(head, last)]) or None,
        )


def _turned_by_hand(head: PanTilt, state: HeadState) -> list[str]:
    try:
        head.require_one_turn(state)
    except DeviceError as error:
        return [str(error)]
    return []


def check_inclinometer(section: InclinometerSection) -> DeviceCheck:
    """One reading as a capture takes it."""
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
            (temperature_c,),
            shaky if noise_deg > LEVEL_NOISE_LIMIT_DEG else None,
        )


def check_compass(section: CompassSection) -> DeviceCheck:
    """Field or heading over half a second."""
    with closing(open_compass(section)) as compass:
        readings = retry(partial(compass.read_many, READING_S))
        fields = [reading for reading in readings if isinstance(reading, FieldReading)]
        headings = [reading for reading in readings if isinstance(reading, HeadingReading)]
        if isinstance(section, Mmc5983maSection):
            return _field_check(compass.identify(), fields, section)
        return _heading_check(compass.identify(), headings)


def check_altimeter(section: AltimeterSection, bounds: Sequence[AltitudeBounds] | None = None) -> DeviceCheck:
    """Pressure, and the altitude that it means, which has to lie within ``bounds``."""
    with closing(open_altimeter(section)) as barometer:
        altitude = read_altitude(barometer, section, bounds)
        temperature_c = altitude.raw["temperature_c"]
        return DeviceCheck(
            "altimeter",
            barometer.identify(),
            f"{altitude.raw['pressure_hpa']:.2f} hPa, {altitude.altitude_m:.1f} m",
            f"{altitude.raw['pressure_scatter_hpa']:.3f} hPa",
            (),
            () if temperature_c is None else (temperature_c,),
            None,
        )


def check_camera(section: CameraSection) -> DeviceCheck:
    """Size, rate and light."""
    with Camera(section) as camera:
        camera.wait_open()
        frames = camera.frames_after(time.monotonic() + section.exposure_settle_s, 3)
        first, last = (frame.image_bgr.astype(np.float32) for frame in (frames[0], frames[-1]))
        light = float(last.mean())
        problem = None
        if not DARK <= light <= BRIGHT:
            problem = (
                f"its picture is all {'black' if light < DARK else 'white'}; look at lens cap and exposure"
            )
        return DeviceCheck(
            "camera",
            camera.identify(),
            f"{camera.frame_rate_hz:.1f} frames/s, mean level {light:.0f} of 255",
            f"{float((last - first).std()) / math.sqrt(2):.1f} levels",
            (),
            (),
            problem,
        )


def print_table(checks: Sequence[DeviceCheck], console: Console) -> None:
    """The checks as a table, and below it a line for each problem."""
    table = Table("device", "identity", "reading", "noise", "V", "°C", "verdict")
    for check in checks:
        table.add_row(
            check.device,
            check.identity,
            check.reading,
            check.noise,
            _numbers(check.volts),
            _numbers(check.temperatures_c),
            "ok" if check.ok else "FAILED",
            style=None if check.ok else "red",
        )
    console.print(table)
    for check in checks:
        if not check.ok:
            console.print(f"{check.device}: {check.problem}", markup=False, highlight=False, soft_wrap=True)


def as_json(checks: Sequence[DeviceCheck]) -> dict[str, Any]:
    """The checks as JSON values."""
    return {"ok": all(c.ok for c in checks), "devices": [{**asdict(c), "ok": c.ok} for c in checks]}


def table_console() -> Console:
    """Standard output, wide enough for the table where it is no terminal."""
    console = Console()
    return console if console.is_terminal else Console(width=PLAIN_WIDTH)


def _guarded(device: str, check: Callable[[], DeviceCheck]) -> DeviceCheck:
    try:
        return check()
    except RigError as error:
        return DeviceCheck(device, "", "", "", (), (), str(error))


def _field_check(identity: str, fields: Sequence[FieldReading], section: Mmc5983maSection) -> DeviceCheck:
    chip_ut = np.array([[reading.x_ut, reading.y_ut, reading.z_ut] for reading in fields])
    stage_ut = in_axes(chip_ut, section.axes) - np.array(section.hard_iron_ut)
    x_ut, y_ut, z_ut = stage_ut.mean(axis=0)
    total_ut = math.hypot(x_ut, y_ut, z_ut)
    low, high = PLAUSIBLE_FIELD_UT
    not_earth = f"{total_ut:.0f} uT is not the Earth's field; check axes, hard_iron_ut, and for magnets"
    return DeviceCheck(
        "compass",
        identity,
        f"{total_ut:.1f} uT (right {x_ut:.1f}, ahead {y_ut:.1f}, up {z_ut:.1f})",
        f"{chip_ut.std(axis=0).max():.3f} uT",
        (),
        (fields[-1].temperature_c,),
        None if low <= total_ut <= high else not_earth,
    )


def _heading_check(identity: str, headings: Sequence[HeadingReading]) -> DeviceCheck:
    angles_deg = [reading.heading_deg for reading in headings]
    mean_deg = circular_mean_deg(angles_deg)
    scatter_deg = float(np.std([wrapped_deg(angle - mean_deg) for angle in angles_deg]))
    references = "/".join(sorted({reading.reference for reading in headings}))
    reading = f"{mean_deg:.1f} deg {references}"
    return DeviceCheck("compass", identity, reading, f"{scatter_deg:.2f} deg", (), (), None)


def _numbers(values: Sequence[float]) -> str:
    return " ".join(f"{value:.1f}" for value in values) or "-"
