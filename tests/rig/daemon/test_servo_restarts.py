"""A head that has shut down is brought back, with care."""

import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from fakes.daemon import add_keys
from fakes.simulated import quick_rig, world

from rig.config.load import load_config
from rig.daemon.device_locks import DeviceLocks
from rig.daemon.device_monitor import DeviceMonitor
from rig.daemon.servo_restarts import ServoRestarts, restart_servos
from rig.daemon.state import DaemonState
from rig.errors import DeviceError
from sim.commands.cli import EMBEDDED_DEM
from sim.devices.servo import ENCODER_ERROR, OVERLOAD_ERROR


def test_a_servo_that_shut_down_for_an_overload_comes_back_without_torque_and_the_other_is_left_alone(
    tmp_path: Path,
) -> None:
    with quick_rig(world(), tmp_path, in_this_process=True) as quick:
        section = load_config(quick.rig.config_path).pan_tilt
        quick.rig.pan.fail(OVERLOAD_ERROR)
        (restarted,) = restart_servos(section)
        assert restarted.startswith("pan servo")
        assert restarted.endswith(": overload")
        assert [servo.register("hardware_error_status") for servo in (quick.rig.pan, quick.rig.tilt)] == [
            0,
            0,
        ]
        assert quick.torques == [0, 0]
        assert restart_servos(section) == []
        quick.capture()


def test_the_daemon_is_ready_again_after_an_overload(tmp_path: Path) -> None:
    with quick_rig(world(), tmp_path, dem_paths=[EMBEDDED_DEM], in_this_process=True) as quick:
        add_keys(quick.rig.config_path, "run", retry_least_s=0.1, retry_most_s=0.2, check_every_s=0.2)
        config, daemon_state, stop = load_config(quick.rig.config_path), DaemonState(), threading.Event()
        restarts = ServoRestarts(lambda: restart_servos(config.pan_tilt), (0.5,))
        watch = DeviceMonitor(config, daemon_state, DeviceLocks(), restarts=restarts)
        thread = threading.Thread(target=watch.run, args=(lambda: None, stop))
        with daemon_state.subscribed() as events:
            quick.rig.pan.fail(OVERLOAD_ERROR)
            thread.start()
            said: list[Mapping[str, Any]] = []
            while not said or said[-1]["state"] != "ok":
                event = events.get(60.0)
                assert event is not None, said
                if event.data.get("name") == "head":
                    said.append(event.data)
            stop.set()
            thread.join()
        assert [each["state"] for each in said] == ["failing", "ok"]
        assert said[0]["detail"].endswith("overload")
        assert daemon_state.snapshot().counts["servo restarts"] == 1


def test_a_broken_encoder_is_not_restarted(tmp_path: Path) -> None:
    with quick_rig(world(), tmp_path, in_this_process=True) as quick:
        quick.rig.tilt.fail(ENCODER_ERROR | OVERLOAD_ERROR)
        assert restart_servos(load_config(quick.rig.config_path).pan_tilt) == []
        assert quick.rig.tilt.register("hardware_error_status") == ENCODER_ERROR | OVERLOAD_ERROR


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    now_s = [1000.0]
    monkeypatch.setattr("rig.timebase.monotonic_s", lambda: now_s[0])
    return now_s


def restarts_within(restarts: ServoRestarts, clock: list[float], seconds: int) -> int:
    """Number of restarts while the error persists, probed once a second."""
    count = 0
    for _ in range(seconds):
        count += len(restarts.hardware_error_seen())
        clock[0] += 1.0
    return count


def test_restarts_grow_rarer_and_end_until_a_capture_has_worked(clock: list[float]) -> None:
    restarts = ServoRestarts(lambda: ["pan servo: overload"], (10.0, 60.0, 360.0))
    assert restarts_within(restarts, clock, 10) == 0
    assert restarts_within(restarts, clock, 2) == 1
    assert restarts_within(restarts, clock, 59) == 0
    assert restarts_within(restarts, clock, 3) == 1
    assert restarts_within(restarts, clock, 365) == 1
    assert restarts.exhausted
    assert restarts_within(restarts, clock, 100_000) == 0
    restarts.capture_succeeded()
    assert restarts_within(restarts, clock, 12) == 1


def test_a_transient_error_restarts_the_wait(clock: list[float]) -> None:
    restarts = ServoRestarts(lambda: ["tilt servo: overheated"], (10.0,))
    assert restarts_within(restarts, clock, 9) == 0
    restarts.healthy()
    assert restarts_within(restarts, clock, 10) == 0
    assert restarts_within(restarts, clock, 2) == 1


def test_a_restart_that_fails_is_one_of_the_few(clock: list[float]) -> None:
    def fails() -> list[str]:
        raise DeviceError("pan servo", "does not answer", "check its cable")

    restarts = ServoRestarts(fails, (10.0,))
    assert restarts_within(restarts, clock, 30) == 0
    assert restarts.exhausted
