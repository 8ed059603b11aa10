"""Quick captures on the wire-level simulator: a small camera, short averages, a horizon that is drawn and not computed."""

import contextlib
import threading
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from fakes.timebases import FastClock, on
from rig.capture.sequence import capture
from rig.config.directions import parse_directions
from rig.config.load import load_config
from sim.commands.options import EMBEDDED_DEM
from sim.faults.script import Fault
from sim.launch.launcher import SimulatedRig, simulated_rig
from sim.world.scenario import Altimeter, CameraOptics, Compass, Inclinometer, Scenario, Servo
from sim.world.truth import World

WIDTH_PX, HEIGHT_PX, FOCAL_PX = 160, 120, 124.0
HASTE = {
    "[pan_tilt]": "velocity_deg_s = 1000.0\nacceleration_deg_s2 = 4000.0\nsettle_timeout_s = 4.0\nbus_watchdog_ms = 400",
    "[inclinometer]": "average_s = 0.25",
    "[camera]": "frames_per_direction = 2\nexposure_settle_s = 0.05\nopen_timeout_s = 1.0\nread_timeout_s = 0.6",
}
SPEED = 3.0
"""Of rig and devices together, as against the computer's clock, where nothing of the rig runs in another process."""
AT_SPEED = {
    "settle_timeout_s = 4.0": f"settle_timeout_s = {4.0 * SPEED}",
    "bus_watchdog_ms = 400": f"bus_watchdog_ms = {400 * SPEED:.0f}",
    "open_timeout_s = 1.0": f"open_timeout_s = {1.0 * SPEED}",
    "read_timeout_s = 0.6": f"read_timeout_s = {0.6 * SPEED}",
}
"""Time limits that last as long on the computer's clock: what is waited for is done by threads of this computer."""
CAPTURE = "\n[capture]\nbase_attitude_pan_angles_deg = [-45.0, 0.0, 45.0]\n"


@cache
def world(
    inclinometer: str = "adxl355",
    compass: str = "mmc5983ma",
    altimeter: str = "bmp390",
    compass_quirk: str | None = None,
    altimeter_quirk: str | None = None,
    one_stream: bool = False,
) -> World:
    """A world with these devices; with ``one_stream`` the barometer shares the compass's port."""
    scenario = Scenario(
        inclinometer=Inclinometer.model_validate({"chip": inclinometer}),
        compass=Compass.model_validate({"kind": compass, "quirk": compass_quirk}),
        altimeter=Altimeter.model_validate(
            {"kind": altimeter, "quirk": altimeter_quirk, "on_compass_port": one_stream}
        ),
        servo=Servo(swing_deg=0.0, max_velocity_deg_s=2000.0),
        camera=CameraOptics(
            width_px=WIDTH_PX,
            height_px=HEIGHT_PX,
            fx_px=FOCAL_PX,
            fy_px=FOCAL_PX,
            cx_px=(WIDTH_PX - 1) / 2,
            cy_px=(HEIGHT_PX - 1) / 2,
            distortion=(0.0, 0.0, 0.0, 0.0, 0.0),
            frame_rate_hz=25.0,
        ),
    )
    return World.create([EMBEDDED_DEM], scenario, 5)


def hills(rotation: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.uint8]:
    """A horizon that is another one in each direction."""
    u, v = np.meshgrid(np.arange(WIDTH_PX) - (WIDTH_PX - 1) / 2, np.arange(HEIGHT_PX) - (HEIGHT_PX - 1) / 2)
    rays = np.stack([u / FOCAL_PX, v / FOCAL_PX, np.ones(u.shape)], axis=-1) @ rotation.T
    azimuth = np.arctan2(rays[..., 0], rays[..., 1])
    elevation_deg = np.degrees(np.arctan2(rays[..., 2], np.hypot(rays[..., 0], rays[..., 1])))
    terrain = elevation_deg < 4.0 + 2.0 * np.sin(5.0 * azimuth) + 1.5 * np.sin(13.0 * azimuth + 1.0)
    levels = np.where(terrain[..., None], (45, 80, 60), (215, 190, 150)) + rng.normal(0.0, 3.0, (*u.shape, 3))
    return np.clip(levels, 0, 255).astype(np.uint8)


@dataclass(frozen=True)
class Quick:
    """A simulated rig that is captured in a hurry."""

    world: World
    rig: SimulatedRig
    bundles: Path
    faults: list[str]
    """What the fault script said."""
    speed: float
    """Of rig and devices, as against the computer's clock."""

    def capture(self) -> Path:
        """A bundle of two directions ahead. The servos of these tests do not swing."""
        config = load_config(self.rig.config_path)
        ahead_deg = round(self.world.mechanics.base.heading_deg)
        directions = [str((ahead_deg + aside_deg) % 360) for aside_deg in (-25, 25)]
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("rig.devices.pan_tilt._STILL_S", 0.08)
            return capture(config, parse_directions(directions), config.rig.bundle_dir, Silent())

    @property
    def is_safe(self) -> bool:
        """Whether the head does not move, and will not: without torque, or stopped for good."""
        return not any(servo.shaft()[1] for servo in (self.rig.pan, self.rig.tilt))

    @property
    def torques(self) -> list[int]:
        """Torque Enable of pan and tilt."""
        return [servo.register("torque_enable") for servo in (self.rig.pan, self.rig.tilt)]

    def left_over(self) -> list[str]:
        """What lies where the bundles go, hidden things included."""
        return sorted(path.name for path in self.bundles.iterdir()) if self.bundles.exists() else []


class Silent:
    """A progress reporter without output."""

    def doing(self, what: str) -> None:
        pass

    def done(self, what: str) -> None:
        pass


@contextlib.contextmanager
def quick_rig(
    world: World,
    folder: Path,
    faults: Sequence[Fault] = (),
    dem_paths: Sequence[Path] = (),
    *,
    in_this_process: bool = False,
) -> Iterator[Quick]:
    """A rig with a fault script and a configuration that asks for a quick capture; with ``dem_paths`` for a daemon, too.

    With ``in_this_process`` the devices and ``rig`` in this process run ``SPEED`` times as fast as the computer's clock.
    """
    said: list[str] = []
    bundles = folder / "bundles"
    speed = SPEED if in_this_process else 1.0
    with contextlib.ExitStack() as running:
        if in_this_process:
            patch = running.enter_context(pytest.MonkeyPatch.context())
            patch.setattr("rig.devices.dynamixel.servo_bus._TURNAROUND_S", 0.15 * SPEED)
            running.enter_context(on(FastClock(SPEED)))
        rig = running.enter_context(
            simulated_rig(
                world,
                picture=hills,
                bundle_dir=bundles,
                faults=faults,
                say=said.append,
                dem_paths=dem_paths,
                speed=speed,
            )
        )
        text = rig.config_path.read_text()
        for section, keys in HASTE.items():
            text = text.replace(section + "\n", f"{section}\n{keys}\n")
        for limit, longer in AT_SPEED.items() if in_this_process else ():
            text = text.replace(limit, longer)
        rig.config_path.write_text(text + CAPTURE)
        yield Quick(world, rig, bundles, said, speed)


def open_descriptors() -> int:
    """How many file descriptors this process has."""
    return len(list(Path("/proc/self/fd").iterdir()))


def threads() -> list[str]:
    """The names of the threads of this process."""
    return sorted(thread.name for thread in threading.enumerate())
