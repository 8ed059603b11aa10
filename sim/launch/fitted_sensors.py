"""Sensors of a scenario: fake device, mounting, and the configuration keys that an installer writes for it."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.devices.adxl355 import Adxl355, Adxl357
from sim.devices.bmp3 import Bmp3
from sim.devices.i2c_chip import PoweredChip
from sim.devices.iis2iclx import Iis2iclx, Ism330dhcx
from sim.devices.mmc5983ma import Mmc5983ma
from sim.devices.ms5611 import Ms5607, Ms5611
from sim.devices.talker_quirks import BAROMETER_QUIRKS, COMPASS_QUIRKS
from sim.devices.talkers import BAROMETERS, COMPASSES, Air, Heading, Talker
from sim.world.mechanics import JointState
from sim.world.truth import World

Array = NDArray[np.float64]
Clock = Callable[[], float]
HeadNow = Callable[[], JointState]

BUS_IN_THE_HEAD, BUS_IN_THE_BASE = 1, 2
TALKER_BAUD = 4800
COMPASS_RATE_HZ, BAROMETER_RATE_HZ = 5.0, 2.0
SELF_HEATING_C = 2.0
QUIETEST_UG_RTHZ, QUIETEST_UT, QUIETEST_PA = 5.0, 0.02, 0.5
"""Least noise, also in an ideal scenario: a real chip without noise has stopped converting."""

ACCELEROMETERS: dict[str, type[Adxl355] | type[Iis2iclx]] = {
    "adxl355": Adxl355,
    "adxl357": Adxl357,
    "iis2iclx": Iis2iclx,
    "ism330dhcx": Ism330dhcx,
}
MOUNTING = {"adxl355": ("+y", "-x", "+z"), "iis2iclx": ("-x", "-y", "+z"), "mmc5983ma": ("-y", "+x", "+z")}
"""Orientation of each chip: its axes that point right, forward and up."""


@dataclass(frozen=True)
class FittedChip:
    """A chip, its bus number, and its configuration keys except ``bus``."""

    chip: PoweredChip
    bus: int
    keys: dict[str, Any]


@dataclass(frozen=True)
class FittedTalker:
    """A running talker, and its configuration keys except ``port``."""

    talker: Talker
    keys: dict[str, Any]


def chip_axes(mounting: tuple[str, str, str]) -> Array:
    """The matrix (3, 3) that turns a vector (right, forward, up) into the chip's own x, y, z."""
    matrix = np.zeros((3, 3))
    for rig_axis, name in enumerate(mounting):
        matrix["xyz".index(name[1]), rig_axis] = 1.0 if name[0] == "+" else -1.0
    return matrix


def inclinometer(world: World, head: HeadNow, clock: Clock) -> FittedChip:
    """The accelerometer in the head."""
    wanted = world.scenario.inclinometer
    mounting = MOUNTING[wanted.chip]
    to_chip, shaking = chip_axes(mounting), world.rng("shaking")

    def acceleration_g() -> Array:
        state = head()
        seen_g = world.accelerometer_in_head(state.pan_deg, state.tilt_deg)
        if world.vehicle.shaken_mg:
            seen_g = seen_g + shaking.normal(0.0, world.vehicle.shaken_mg / 1000.0, 3)
        return to_chip @ seen_g

    chip = ACCELEROMETERS[wanted.soldered or wanted.chip](
        acceleration_g,
        lambda: world.air_temperature_c + SELF_HEATING_C,
        clock=clock,
        rng=world.rng("inclinometer noise"),
        noise_density_g=max(wanted.noise_density_ug_rthz, QUIETEST_UG_RTHZ) * 1e-6,
    )
    return FittedChip(
        chip, BUS_IN_THE_HEAD, {"chip": wanted.chip, "address": chip.address, "axes": list(mounting)}
    )


def compass(world: World, head: HeadNow, clock: Clock, speed: float = 1.0) -> FittedChip | FittedTalker:
    """The magnetometer on the pan stage, or a talker there."""
    wanted, rng = world.scenario.compass, world.rng("compass noise")
    if wanted.kind != "mmc5983ma":
        return _compass_talker(world, head, rng, speed)
    mounting = MOUNTING[wanted.kind]
    to_chip = chip_axes(mounting)

    def field_ut() -> Array:
        state = head()
        return to_chip @ world.field_in_pan_stage(state.pan_deg, state.moving, state.holding)

    x, y, z = (float(offset) for offset in rng.normal(0.0, wanted.bridge_offset_sigma_ut, 3))
    chip = Mmc5983ma(
        field_ut,
        lambda: world.air_temperature_c + SELF_HEATING_C,
        clock=clock,
        rng=rng,
        noise_ut=max(wanted.noise_ut, QUIETEST_UT),
        bridge_offset_ut=(x, y, z),
    )
    keys = {
        "kind": wanted.kind,
        "address": chip.address,
        "axes": list(mounting),
        "hard_iron_ut": [round(iron, 3) for iron in world.biases.hard_iron_calibrated_ut],
    }
    return FittedChip(chip, BUS_IN_THE_BASE, keys)


def _compass_talker(world: World, head: HeadNow, rng: np.random.Generator, speed: float) -> FittedTalker:
    wanted = world.scenario.compass
    say = COMPASS_QUIRKS[wanted.quirk] if wanted.quirk else COMPASSES[wanted.kind]

    def message() -> bytes:
        state = head()
        right, forward, up = world.gravity_in_head(state.pan_deg, 0.0)  # that of the pan stage
        noise_deg = rng.normal(0.0, wanted.talker_noise_deg, 3)
        return say(
            Heading(
                magnetic_heading_deg=world.magnetic_heading_deg(state.pan_deg, state.moving) + noise_deg[0],
                pitch_deg=math.degrees(math.asin(forward)) + noise_deg[1],
                roll_deg=math.degrees(math.atan2(-right, up)) + noise_deg[2],
                declination_deg=world.field.declination_model_deg,
                temperature_c=world.air_temperature_c + SELF_HEATING_C,
            )
        )

    talker = Talker(message, rate_hz=speed * COMPASS_RATE_HZ, baud=TALKER_BAUD)
    return FittedTalker(talker, {"kind": "nmea", "baud": TALKER_BAUD})


def altimeter(
    world: World, clock: Clock, compass: FittedChip | FittedTalker | None = None, speed: float = 1.0
) -> FittedChip | FittedTalker:
    """The barometer: a chip, or a talker, on the ``compass``'s port if the scenario has one stream for both."""
    wanted, rng = world.scenario.altimeter, world.rng("altimeter noise")

    def pressure_hpa() -> float:
        return world.pressure_hpa(clock()) + world.biases.altimeter_bias_hpa

    def pressure_pa() -> float:
        return 100.0 * pressure_hpa()

    def chip_temperature_c() -> float:
        return world.air_temperature_c + SELF_HEATING_C

    if wanted.kind in BAROMETERS:
        say = BAROMETER_QUIRKS[wanted.quirk] if wanted.quirk else BAROMETERS[wanted.kind]
        talker = Talker(
            lambda: say(Air(pressure_hpa() + rng.normal(0.0, wanted.noise_hpa), world.air_temperature_c)),
            rate_hz=speed * BAROMETER_RATE_HZ,
            baud=TALKER_BAUD,
            port=compass.talker.port
            if wanted.on_compass_port and isinstance(compass, FittedTalker)
            else None,
        )
        kind = wanted.kind if wanted.kind == "vaisala-pa50" else "nmea"
        return FittedTalker(talker, {"kind": kind, "baud": TALKER_BAUD})
    noise_pa = max(100.0 * wanted.noise_hpa, QUIETEST_PA)
    chip: PoweredChip
    if wanted.kind in ("ms5611", "ms5607"):
        chip = (Ms5611 if (wanted.soldered or wanted.kind) == "ms5611" else Ms5607)(
            pressure_pa, chip_temperature_c, clock=clock, rng=rng, noise_pa=noise_pa
        )
    else:
        chip = Bmp3(wanted.kind, pressure_pa, chip_temperature_c, clock=clock, rng=rng, noise_pa=noise_pa)
    return FittedChip(chip, BUS_IN_THE_BASE, {"kind": wanted.kind, "address": chip.address})
