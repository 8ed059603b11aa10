"""``rig watch``: what the devices say, without touching them; one that fails is shown and comes back."""

import io
import json
import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from fakes.command import Run, one_line, written
from fakes.servos import TORQUE
from fakes.whole_rig import RunningRig
from rich.console import Console

from rig import timebase
from rig.errors import TransientError
from rig.watch import text
from rig.watch.attitudes import Attitudes, attitudes
from rig.watch.sources import Reading, Source
from rig.watch.watcher import STALE_AFTER_S, DeviceStatus, Watcher


@pytest.fixture
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """A computer that is busy with other things makes no reading old."""
    monkeypatch.setattr("rig.watch.watcher.STALE_AFTER_S", 60.0)


def wait_for_state(watcher: Watcher, state: str) -> DeviceStatus:
    end_s = time.monotonic() + 20.0
    while (status := watcher.statuses()[0]).state != state:
        assert time.monotonic() < end_s, f"{status} does not become {state}"
        time.sleep(0.01)
    return status


@pytest.mark.usefixtures("patient")
def test_once_everything_that_is_read(run: Run, running: RunningRig, tmp_path: Path) -> None:
    running.rig.pan.put(132, 4, 2048 + 512)
    running.rig.pan.put(116, 4, 2048 + 512)
    running.rig.pan.registers[TORQUE] = 1
    config = written(running, tmp_path)
    status, out, err = run("watch", "--config", config, "--once", "--json")
    found = json.loads(out)
    assert [device["problem"] for device in found["devices"].values()] == [None] * 5
    assert (status, err, found["ok"]) == (0, "", True)
    assert list(found["devices"]) == ["head", "inclinometer", "compass", "altimeter", "camera"]
    assert {device["state"] for device in found["devices"].values()} == {"ok"}
    assert all(device["age_s"] < 30.0 for device in found["devices"].values())
    head = found["devices"]["head"]["values"]
    assert head["pan_deg"] == pytest.approx(45.0)
    assert head["torque"] == [True, False]
    assert head["volts_v"] == [12.1, 12.1]
    assert found["devices"]["camera"]["values"]["frames_per_s"] > 0.0
    stands = found["attitude"]
    assert stands["vehicle_heading_deg"] == pytest.approx(30.0, abs=0.1)
    assert stands["vehicle_pitch_deg"] == pytest.approx(3.0, abs=0.05)
    assert stands["vehicle_roll_deg"] == pytest.approx(-2.0, abs=0.05)
    assert stands["camera_azimuth_deg"] == pytest.approx(75.0, abs=0.3)
    assert stands["altitude_m"] == pytest.approx(540.3, abs=1.0)


def test_nothing_is_written_to_the_servos(run: Run, running: RunningRig, tmp_path: Path) -> None:
    running.rig.pan.registers[TORQUE] = 1
    run("watch", "--config", written(running, tmp_path), "--for", "1", "--device", "head")
    assert running.servos.requests
    assert running.servos.writes == []
    assert running.rig.pan.registers[TORQUE] == 1
    assert running.rig.tilt.registers[TORQUE] == 0


@pytest.mark.usefixtures("patient")
def test_a_line_or_an_object_each_time(run: Run, running: RunningRig, tmp_path: Path) -> None:
    options = (
        "--config",
        written(running, tmp_path),
        "--every",
        "0.1",
        "--for",
        "3",
        "--device",
        "altimeter",
    )
    status, out, _ = run("watch", *options)
    assert status == 0
    assert len(out.splitlines()) > 1
    assert "altitude 540.3 m" in out.splitlines()[-1]
    status, out, _ = run("watch", *options, "--json")
    moments = [json.loads(line) for line in out.splitlines()]
    assert len(moments) > 1
    assert {moment["rig"] for moment in moments} == {"test"}


@pytest.mark.usefixtures("patient")
def test_what_ails_a_device_is_said(run: Run, running: RunningRig, tmp_path: Path) -> None:
    running.rig.pan.put(70, 1, 0x20)
    config = written(running, tmp_path, camera={"source": "http://127.0.0.1:9/"})
    status, out, _ = run("watch", "--config", config, "--once", "--json")
    devices = json.loads(out)["devices"]
    assert status == 1
    assert devices["head"]["state"] == "warning"
    assert "overload" in devices["head"]["problem"]
    assert devices["camera"]["state"] == "failing"
    assert "cannot be opened" in devices["camera"]["problem"]
    assert devices["camera"]["values"] is None
    assert devices["compass"]["state"] == "ok"


@pytest.mark.usefixtures("patient")
def test_ctrl_c_is_the_ordinary_end(run: Run, running: RunningRig, tmp_path: Path) -> None:
    def interrupt() -> None:
        while running.rig.readings_taken < 2:
            time.sleep(0.02)
        timebase.sleep(1.5)
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=interrupt, daemon=True).start()
    status, out, err = run("watch", "--config", written(running, tmp_path), "--device", "inclinometer")
    assert (status, err) == (0, "")
    assert "head tilt" in out
    assert all(sensor.closed for sensor in running.sensors if sensor.name == "inclinometer")


def test_a_device_that_the_configuration_has_not(run: Run, running: RunningRig, tmp_path: Path) -> None:
    config = written(running, tmp_path, compass=None)
    assert "has no compass" in one_line(run("watch", "--config", config, "--device", "compass"))


def test_a_device_that_fails_is_opened_again_until_it_is_back(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rig.watch.watcher.RETRY_FIRST_S", 0.01)
    broken = threading.Event()
    opened = 0

    @contextmanager
    def opener() -> Iterator[Source]:
        nonlocal opened
        opened += 1
        if broken.is_set():
            raise TransientError("compass", "no answer", "look at its cable")

        def read() -> Reading:
            time.sleep(0.01)
            if broken.is_set():
                raise TransientError("compass", "fell silent", "look at its cable")
            return Reading({"heading_deg": 1.0, "reference": "true"}, timebase.monotonic_s())

        yield Source("a compass", read)

    with Watcher({"compass": opener}) as watcher:
        assert wait_for_state(watcher, "ok").failures == 0
        broken.set()
        failing = wait_for_state(watcher, "failing")
        assert failing.problem is not None
        assert failing.problem.startswith("compass: ")
        assert failing.reading is not None, "the last reading stays, with its age"
        while opened < 4:
            time.sleep(0.01)
        broken.clear()
        back = wait_for_state(watcher, "ok")
        assert back.failures >= 3
        assert back.problem is None


def test_a_reading_that_grows_old_is_a_problem_and_stands_for_nothing(running: RunningRig) -> None:
    old = Reading(
        {"tilt_deg": 1.0, "roll_deg": 2.0, "noise_deg": 0.0}, timebase.monotonic_s() - STALE_AFTER_S - 1.0
    )
    status = DeviceStatus("inclinometer", "ok", "chip", old, None, 0).with_staleness()
    assert status.state == "silent"
    assert status.problem is not None
    assert status.problem.startswith("no reading for ")
    assert attitudes(running.config(), [status]) == Attitudes()


def test_the_table_of_a_terminal() -> None:
    values = {
        "pan_deg": 35.0,
        "tilt_deg": -12.0,
        "moving": False,
        "torque": [False, False],
        "volts_v": [12.0, 11.9],
        "temperatures_c": [31.0, 42.0],
    }
    statuses = [
        DeviceStatus("head", "ok", "two servos", Reading(values, timebase.monotonic_s()), None, 0),
        DeviceStatus("compass", "failing", "", None, "NMEA compass: nothing arrives; check its power", 3),
    ]
    console = Console(record=True, width=120, file=io.StringIO())
    console.print(text.table("vehicle-1", statuses, Attitudes(head_tilt_deg=1.25), []))
    shown = console.export_text()
    for words in ("pan 35.00, tilt -12.00 deg", "12.0/11.9 V", "31/42 °C", "torque off", "tilt 1.25, roll -"):
        assert words in shown
    assert "compass: NMEA compass: nothing arrives; check its power" in shown
