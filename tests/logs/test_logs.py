"""Logs of devices, played back at wire level: the drivers read today what they read when the log was stored.

Each ``NAME.log`` of this folder is a test; ``NAME.json`` holds the readings. ``SKYFIX_UPDATE_LOGS=1`` writes the readings of
a log that is new.
"""

import json
import os
from pathlib import Path
from typing import Any

import pytest

from rig.config.load import load_config
from rig.config.model import RigConfig
from rig.devices.bus.retry import retry
from rig.devices.connect import open_altimeter, open_compass, open_inclinometer, open_pan_tilt
from rig.devices.readings import FieldReading
from rig.devices.sensors.reconnecting import Sensor
from sim.errors import SimulationError
from sim.replay.log_file import load_log
from sim.replay.playback import replayed

LOGS = sorted(Path(__file__).parent.glob("*.log"))
FIRST = 2
AVERAGED = "adxl355", "iis2iclx", "mmc5983ma"
"""These are read several times for a mean, more often than the logs go on for."""


def one_by_one(sensor: Sensor[Any]) -> list[Any]:
    """The first readings, each asked for alone: how many come in some time is the machine's business."""
    return [retry(lambda: sensor.read_many(0.0))[0] for _ in range(FIRST)]


def readings(config: RigConfig) -> dict[str, Any]:
    """The first readings of every device but the camera."""
    found: dict[str, Any] = {}
    with open_pan_tilt(config.pan_tilt) as head:
        state = head.state()
        found["pan_tilt"] = {
            "ticks": list(state.ticks),
            "volts": list(state.volts),
            "alerts": list(state.alerts),
        }
    sensor = open_inclinometer(config.inclinometer)
    found["inclinometer"] = [[r.x_g, r.y_g, r.z_g, r.temperature_c] for r in one_by_one(sensor)]
    sensor.close()
    assert config.compass is not None
    assert config.altimeter is not None
    compass = open_compass(config.compass)
    found["compass"] = [
        [r.x_ut, r.y_ut, r.z_ut] if isinstance(r, FieldReading) else [r.heading_deg, r.reference]
        for r in one_by_one(compass)
    ]
    compass.close()
    altimeter = open_altimeter(config.altimeter)
    found["altimeter"] = [[r.pressure_hpa, r.temperature_c] for r in one_by_one(altimeter)]
    altimeter.close()
    return found


def rounded(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: rounded(each) for key, each in value.items()}
    if isinstance(value, list):
        return [rounded(each) for each in value]
    return round(value, 6) if isinstance(value, float) else value


@pytest.mark.parametrize("log", LOGS, ids=lambda log: log.stem)
def test_a_log_gives_the_readings_that_are_stored_with_it(log: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for driver in AVERAGED:
        monkeypatch.setattr(f"rig.devices.sensors.{driver}.MIN_READINGS", 1)
    with replayed(log) as config_path:
        found = rounded(readings(load_config(config_path)))
    expected = log.with_suffix(".json")
    if os.environ.get("SKYFIX_UPDATE_LOGS"):
        expected.write_text(json.dumps(found, indent=1) + "\n")
    assert expected.exists(), "no readings are stored with it: run with SKYFIX_UPDATE_LOGS=1 and look at them"
    assert found == json.loads(expected.read_text())


def test_there_are_logs() -> None:
    assert len(LOGS) >= 5


def test_a_last_line_that_a_crash_cut_off_is_left_out(tmp_path: Path) -> None:
    text = LOGS[0].read_text()
    (tmp_path / "cut.log").write_text(text[:-30])
    assert len(load_log(tmp_path / "cut.log")[1]) == len(load_log(LOGS[0])[1]) - 1


@pytest.mark.parametrize(
    "text", ["", "{}\n", "[1]\n", "$GPGGA,1*00\n", '{"skyfix_log": 1, "config": {}}\nx\ny\n']
)
def test_what_is_no_log_is_named(tmp_path: Path, text: str) -> None:
    (tmp_path / "x.log").write_text(text)
    with pytest.raises(SimulationError, match=r"x\.log: is no log of rig record"):
        load_log(tmp_path / "x.log")


def test_a_log_of_nothing_is_refused(tmp_path: Path) -> None:
    (tmp_path / "x.log").write_text('{"skyfix_log": 1, "config": {}}\n')
    with pytest.raises(SimulationError, match=r"x\.log: holds nothing"):
        load_log(tmp_path / "x.log")
