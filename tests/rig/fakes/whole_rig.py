"""A whole rig for tests of what is above the drivers: servos at wire level, sensors as objects, one horizon.

The servos' registers say where the head is; sensors and camera see the world from there.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime

import numpy as np
import pytest

from fakes.mjpeg_camera import MjpegServer, mjpeg_server
from fakes.servos import POSITION, TORQUE, FakeServo, FakeServoBus
from fakes.timebases import FastClock, on
from rig import timebase
from rig.attitude.kinematics import Attitude, JointAngles, camera_rotation, head_rotation, pan_stage_rotation
from rig.config.model import RigConfig
from rig.devices.readings import AccelerationReading, FieldReading, PressureReading
from rig.devices.sensors.reconnecting import ReconnectingSensor

WIDTH_PX, HEIGHT_PX, FOCAL_PX = 160, 120, 124.0
DECLINATION_DEG = 13.0
ZERO_TICK = 2048
SPEED = 5.0
"""How much faster than the computer's clock the rig and its devices run."""
PATIENCE_S = 60.0
"""Of the rig's clock, for what shall not fail: the computer may be busy with other things."""


def rolling_hills_deg(azimuth_deg: np.ndarray) -> np.ndarray:
    """Elevation of a horizon that lies within a picture taken at tilt 0."""
    return 3.0 + 2.0 * np.sin(np.radians(azimuth_deg * 6.0))


@dataclass
class FakeRig:
    """The truth, and switches that break things. ``before_reading`` is called before each inclinometer reading.

    ``compass_off_deg`` says by how much the compass is turned the so manieth time that it is read, from 1 on; it may raise.
    """

    base: Attitude = field(default_factory=lambda: Attitude(30.0, 3.0, -2.0))
    boresight: Attitude = field(default_factory=lambda: Attitude(0.0, 0.0, 0.0))
    horizon_deg: Callable[[np.ndarray], np.ndarray] = rolling_hills_deg
    roll_zero_deg: float = 0.0
    swing_deg: float = 0.0
    swing_until_s: float = 0.0
    pressure_hpa: float = 950.0
    before_reading: Callable[[], None] = field(default=lambda: None)
    compass_off_deg: Callable[[int], float] = field(default=lambda number: 0.0)
    compass_readings: int = 0
    pan: FakeServo = field(default_factory=lambda: FakeServo(1))
    tilt: FakeServo = field(default_factory=lambda: FakeServo(2))
    readings_taken: int = 0
    noise: np.random.Generator = field(default_factory=lambda: np.random.default_rng(1))

    def joints(self) -> JointAngles:
        pan, tilt = ((servo.get(POSITION, 4) - ZERO_TICK) * 360 / 4096 for servo in (self.pan, self.tilt))
        return JointAngles(pan, tilt)

    @property
    def torque_is_on(self) -> bool:
        return bool(self.pan.registers[TORQUE] or self.tilt.registers[TORQUE])

    def picture(self) -> np.ndarray:
        rotation = camera_rotation(head_rotation(self.base, self.joints()), self.boresight)
        u, v = np.meshgrid(
            np.arange(WIDTH_PX) - (WIDTH_PX - 1) / 2, np.arange(HEIGHT_PX) - (HEIGHT_PX - 1) / 2
        )
        rays = np.stack([u / FOCAL_PX, v / FOCAL_PX, np.ones(u.shape)], axis=-1) @ rotation.T
        azimuth_deg = np.degrees(np.arctan2(rays[..., 0], rays[..., 1]))
        elevation_deg = np.degrees(np.arctan2(rays[..., 2], np.hypot(rays[..., 0], rays[..., 1])))
        terrain = elevation_deg < self.horizon_deg(azimuth_deg)
        noise = self.noise.normal(0.0, 3.0, (*u.shape, 3))
        return np.clip(np.where(terrain[..., None], (45, 80, 60), (235, 200, 160)) + noise, 0, 255).astype(
            np.uint8
        )


class FakeSensor:
    """What the sensors have in common: a name, and that they are closed once."""

    def __init__(self, rig: FakeRig, name: str) -> None:
        self.rig = rig
        self.name = name
        self.closed = False

    def identify(self) -> str:
        return self.name

    def close(self) -> None:
        self.closed = True


class FakeInclinometer(FakeSensor):
    def read_many(self, duration_s: float) -> list[AccelerationReading]:
        self.rig.before_reading()
        self.rig.readings_taken += 1
        samples = []
        for _ in range(24):
            now_s = timebase.monotonic_s()
            swing_deg = self.rig.swing_deg if now_s < self.rig.swing_until_s else 0.0
            head = head_rotation(self.rig.base, self.rig.joints())
            up = head.T @ np.array([0.0, 0.0, 1.0])
            up[0] -= np.sin(np.radians(self.rig.roll_zero_deg + swing_deg * np.sin(now_s * 19.0)))
            samples.append(AccelerationReading(*up.tolist(), 20.0, now_s, datetime.now(UTC)))
            timebase.sleep(duration_s / 24)
        return samples


class FakeCompass(FakeSensor):
    def read_many(self, duration_s: float) -> list[FieldReading]:
        timebase.sleep(duration_s)
        self.rig.compass_readings += 1
        d = np.radians(DECLINATION_DEG - self.rig.compass_off_deg(self.rig.compass_readings))
        field_ut = np.array([22.0 * np.sin(d), 22.0 * np.cos(d), -43.0])
        x, y, z = pan_stage_rotation(self.rig.base, self.rig.joints().pan_deg).T @ field_ut
        return [FieldReading(x, y, z, (0.0, 0.0, 0.0), 20.0, timebase.monotonic_s(), datetime.now(UTC))] * 3


class FakeBarometer(FakeSensor):
    def read_many(self, duration_s: float) -> list[PressureReading]:
        timebase.sleep(duration_s)
        now_s, utc = timebase.monotonic_s(), datetime.now(UTC)
        return [PressureReading(self.rig.pressure_hpa, 20.0, now_s, utc)] * 3


@dataclass(frozen=True)
class RunningRig:
    """A fake rig whose servos and camera can be reached."""

    rig: FakeRig
    servos: FakeServoBus
    camera: MjpegServer
    sensors: tuple[FakeSensor, ...]

    def settings(self, **changes: dict[str, object] | None) -> dict[str, object]:
        """A configuration of this rig as tables; a section of ``changes`` overrides keys, None removes it."""
        joint = {"model": "XM430-W350", "zero_tick": ZERO_TICK, "direction": 1}
        chip = {"bus": "/dev/i2c-1", "axes": ["+x", "+y", "+z"]}
        tables: dict[str, dict[str, object]] = {
            "rig": {"name": "test", "mast_height_m": 2.0},
            "pan_tilt": {
                "port": self.servos.path,
                "baud": 1_000_000,
                "settle_timeout_s": PATIENCE_S,
                "pan": {"id": 1, "min_deg": -178.0, "max_deg": 178.0, **joint},
                "tilt": {"id": 2, "min_deg": -40.0, "max_deg": 60.0, **joint},
            },
            "inclinometer": {"chip": "adxl355", "address": 0x1D, "average_s": 0.2, **chip},
            "compass": {"kind": "mmc5983ma", "address": 0x30, "declination_deg": DECLINATION_DEG, **chip},
            "altimeter": {
                "kind": "bmp390",
                "bus": "/dev/i2c-1",
                "address": 0x76,
                "reference_pressure_hpa": 1013.25,
                "reference_altitude_m": 0.0,
            },
            "camera": {
                "source": self.camera.url,
                "width_px": WIDTH_PX,
                "height_px": HEIGHT_PX,
                "fx_px": FOCAL_PX,
                "fy_px": FOCAL_PX,
                "cx_px": (WIDTH_PX - 1) / 2,
                "cy_px": (HEIGHT_PX - 1) / 2,
                "frames_per_direction": 2,
                "exposure_settle_s": 0.02,
                "read_timeout_s": PATIENCE_S,
            },
            "capture": {"base_attitude_pan_angles_deg": [-120.0, 0.0, 120.0]},
        }
        for section, keys in changes.items():
            if keys is None:
                del tables[section]
            else:
                tables[section] = {**tables.get(section, {}), **keys}
        return dict(tables)

    def config(self, **changes: dict[str, object] | None) -> RigConfig:
        return RigConfig.model_validate(self.settings(**changes))


@contextmanager
def running_rig(monkeypatch: pytest.MonkeyPatch, rig: FakeRig) -> Iterator[RunningRig]:
    """Serve ``rig``; what opens sensors in the code under test opens the fakes."""
    # These servos are a thread of this process, which waits for its turn where the computer is busy.
    monkeypatch.setattr("rig.devices.dynamixel.servo_bus._TURNAROUND_S", 0.3 * SPEED)
    sensors = (
        FakeInclinometer(rig, "inclinometer"),
        FakeCompass(rig, "compass"),
        FakeBarometer(rig, "barometer"),
    )
    names = "open_inclinometer", "open_compass", "open_altimeter"
    for module in ("rig.devices.connect", "rig.check.devices", "rig.watch.sources"):
        for name, sensor in zip(names, sensors, strict=True):
            monkeypatch.setattr(f"{module}.{name}", lambda section, s=sensor: ReconnectingSensor(lambda: s))
    monkeypatch.setattr("rig.devices.pan_tilt._STILL_S", 0.05)  # these servos do not swing
    with (
        on(FastClock(SPEED)),
        FakeServoBus(rig.pan, rig.tilt) as servos,
        mjpeg_server(rig.picture, rate_hz=100.0) as camera,
    ):
        yield RunningRig(rig, servos, camera, sensors)
