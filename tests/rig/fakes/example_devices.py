"""The devices and files that the examples in docstrings of ``rig`` and ``sim`` name, all simulated."""

import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from fakes.simulated import quick_rig, world
from sim.devices.adxl355 import Adxl355
from sim.devices.bmp3 import Bmp3
from sim.devices.i2c_bridge import I2cBridge
from sim.devices.iis2iclx import Iis2iclx
from sim.devices.mmc5983ma import Mmc5983ma
from sim.devices.ms5611 import Ms5611
from sim.devices.pty_port import PtyPort
from sim.devices.servo import Servo
from sim.devices.servo_bus import ServoBus
from sim.devices.talkers import Air, Heading, Talker, hdg, vaisala_pa50, xdr
from sim.devices.x_series import BAUD_RATES, MODELS

FAST_DEG_S = 2000.0


def chips() -> list[Any]:
    """One of each, level, in a field that points north and down, at 900 hPa and 20 degrees Celsius."""
    parts: dict[str, Any] = {"clock": time.monotonic, "rng": np.random.default_rng(1)}

    def temperature_c() -> float:
        return 20.0

    def pressure_pa() -> float:
        return 90_000.0

    return [
        Adxl355(lambda: np.array([0.001, 0.001, 1.0]), temperature_c, **parts),
        Iis2iclx(lambda: np.array([0.001, 0.001, 1.0]), temperature_c, **parts),
        Mmc5983ma(
            lambda: np.array([0.0, 22.0, -42.0]), temperature_c, bridge_offset_ut=(10.0, 0.0, 0.0), **parts
        ),
        Bmp3("bmp390", pressure_pa, temperature_c, **parts),
        Ms5611(pressure_pa, temperature_c, **parts),
    ]


@contextmanager
def example_names(folder: Path) -> Iterator[dict[str, Any]]:
    """What the examples call ``i2c_bus``, ``config_file`` and so on."""
    with ExitStack() as running:
        bridge = I2cBridge({1: chips()})
        running.callback(bridge.close)
        servo_port = PtyPort()
        running.callback(servo_port.close)
        model = replace(MODELS["XM430-W350"], speed_deg_s=FAST_DEG_S)
        eeprom = {"baud_rate": BAUD_RATES.index(1_000_000), "return_delay_time": 0}
        servos = [
            Servo(model, number, clock=time.monotonic, rng=np.random.default_rng(number), eeprom=dict(eeprom))
            for number in (1, 2)
        ]
        ServoBus(servos).serve(servo_port)
        heading = Heading(123.4, 0.0, 0.0, 13.0, 20.0)
        messages = {
            "compass_port": lambda: hdg(heading),
            "barometer_port": lambda: xdr(Air(900.0, 20.0)),
            "vaisala_port": lambda: vaisala_pa50(Air(900.0, 20.0)),
        }
        talkers = {name: Talker(say, rate_hz=20.0, baud=4800) for name, say in messages.items()}
        for talker in talkers.values():
            running.callback(talker.close)
        quick = running.enter_context(quick_rig(world(), folder))
        yield {
            "i2c_bus": bridge.url(1),
            "servo_port": servo_port.path,
            **{name: talker.path for name, talker in talkers.items()},
            "config_file": quick.rig.config_path,
            "small_camera": world().scenario,
        }
