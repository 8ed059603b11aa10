"""Capture requests and their answers; the stationary trigger; devices that fail and return."""

import queue
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from rig.clock import Instant
from rig.config.load import load_config
from rig.config.model import RigConfig
from rig.config.run import RestTrigger, RunSection
from rig.daemon import stationary_trigger
from rig.daemon.device_locks import DeviceLocks
from rig.daemon.device_monitor import DeviceMonitor, next_wait_s
from rig.daemon.main_loop import MainLoop, RequestQueue
from rig.daemon.notify import Notifier
from rig.daemon.readiness import why_not_ready
from rig.daemon.state import DaemonState
from rig.daemon.stationary_trigger import SAMPLES_A_SECOND, StationaryDetector, StationaryMonitor, noise_mg
from rig.daemon.triggers import Triggers
from rig.devices.readings import AccelerationReading
from rig.errors import DeviceError
from rig.watch.sources import Reading, Source

EXAMPLE = Path(__file__).parents[3] / "configs" / "vehicle.toml"


class TestNextConfiguration:
    @pytest.fixture
    def daemon_state(self) -> DaemonState:
        daemon_state = DaemonState()
        daemon_state.set_activity("idle")
        return daemon_state

    def a_loop(self, daemon_state: DaemonState, taken: list[str]) -> tuple[MainLoop, Triggers, RequestQueue]:
        config = load_config(EXAMPLE)
        assert config.run
        requests: RequestQueue = queue.SimpleQueue()
        triggers = Triggers(daemon_state, lambda: None, requests.put)
        terrain: Future[None] = Future()
        terrain.set_result(None)
        captures = SimpleNamespace(
            take=lambda source, beat: taken.append(source),
            interrupted=lambda source: taken.append(f"{source} interrupted"),
        )
        search = SimpleNamespace(terrain=terrain, pictures=terrain, wake=lambda: None)
        parts: Any = (daemon_state, Notifier(None), triggers, captures, search, None, None, requests)
        return MainLoop(config.run, EXAMPLE, *parts), triggers, requests

    def test_a_capture_that_was_promised_meanwhile_is_still_taken(self, daemon_state: DaemonState) -> None:
        taken: list[str] = []
        loop, triggers, requests = self.a_loop(daemon_state, taken)
        requests.put("reload")
        assert triggers.trigger("command") == "started"
        requests.put("reload")  # the file may have changed once more
        assert loop.run(lambda: None, lambda: None).config == load_config(EXAMPLE)
        assert taken == ["command"]
        assert triggers.trigger("command") == "stopping"
        assert requests.get_nowait() == "reload"
        assert requests.empty()

    def test_one_that_the_end_forestalls_is_accounted_for(self, daemon_state: DaemonState) -> None:
        taken: list[str] = []
        loop, triggers, _ = self.a_loop(daemon_state, taken)
        assert triggers.trigger("command") == "started"
        triggers.stop()
        loop.on_shutdown()
        assert taken == ["command interrupted"]


class TestTriggers:
    def test_one_is_carried_out_and_every_other_is_answered_and_counted(self) -> None:
        daemon_state, started = DaemonState(), []
        triggers = Triggers(daemon_state, lambda: None, started.append)
        assert [triggers.trigger("http"), triggers.trigger("rest"), triggers.trigger("command")] == [
            "started",
            "busy",
            "busy",
        ]
        assert started == ["http"]
        triggers.done()
        assert triggers.trigger("signal") == "started"
        triggers.stop()
        assert triggers.trigger("command") == "stopping"
        counts = daemon_state.snapshot().counts
        assert counts["triggers"] == 5
        assert counts["triggers started"] + counts["triggers busy"] + counts["triggers stopping"] == 5

    def test_without_the_devices_it_is_not_ready_and_the_event_says_why(self) -> None:
        daemon_state = DaemonState()
        triggers = Triggers(daemon_state, lambda: "camera not ready", lambda source: pytest.fail("started"))
        with daemon_state.subscribed() as events:
            assert triggers.trigger("http") == "not ready"
            event = events.get(1.0)
        assert event is not None
        assert event.data == {"source": "http", "answer": "not ready", "why": "camera not ready"}

    def test_of_many_at_once_one_is_started(self) -> None:
        answers, daemon_state = [], DaemonState()
        triggers = Triggers(daemon_state, lambda: None, lambda source: None)
        threads = [
            threading.Thread(target=lambda: answers.append(triggers.trigger("http"))) for _ in range(20)
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert sorted(answers) == ["busy"] * 19 + ["started"]


class TestRest:
    SECTION = RestTrigger(still_s=10.0, still_mg=5.0)

    def drive(self, detector: StationaryDetector, noises_mg: dict[range, float]) -> list[int]:
        """Seconds at which it became stationary; a capture follows each."""
        rests = []
        for seconds, level_mg in noises_mg.items():
            for second in seconds:
                if detector.take(level_mg, float(second)):
                    rests.append(second)
                    detector.captured()
        return rests

    def test_standstill_is_reported_once_after_the_debounce_time(self) -> None:
        detector = StationaryDetector(self.SECTION)
        noises = {range(5): 40.0, range(5, 60): 0.5, range(60, 80): 40.0, range(80, 99): 0.5}
        assert self.drive(detector, noises) == [15, 90]

    def test_a_short_halt_is_no_rest(self) -> None:
        noises = {range(5): 40.0, range(5, 14): 0.5, range(14, 16): 30.0, range(16, 25): 0.5}
        assert self.drive(StationaryDetector(self.SECTION), noises) == []

    def test_who_stands_at_the_beginning_has_come_to_rest(self) -> None:
        assert self.drive(StationaryDetector(self.SECTION), {range(30): 0.5}) == [10]

    def test_a_capture_that_failed_is_worth_two_more_at_the_same_rest(self) -> None:
        detector, asked = StationaryDetector(self.SECTION), []
        for second in range(100):
            if detector.take(40.0 if second == 60 else 0.5, float(second)):
                asked.append(second)
                detector.captured()
                detector.failed()
                detector.interrupted()  # by the capture
        assert asked == [10, 21, 32, 71, 82, 93]

    def test_standstill_does_not_count_while_unobserved(self) -> None:
        detector = StationaryDetector(self.SECTION)
        assert not detector.take(0.5, 0.0)
        detector.interrupted()
        assert not detector.take(0.5, 30.0)
        assert detector.take(0.5, 40.0)

    def test_the_noise_is_that_of_all_axes_of_two_axis_chips_too(self) -> None:
        now = Instant.now()

        def readings(z: bool) -> list[AccelerationReading]:
            return [
                AccelerationReading(x, 0.0, 1.0 + x if z else None, 20.0, now.monotonic_s, now.utc)
                for x in (-0.01, 0.01)
            ]

        assert noise_mg(readings(z=False)) == pytest.approx(10.0)
        assert noise_mg(readings(z=True)) == pytest.approx(10.0 * 2**0.5)


class ShakenChip:
    """An inclinometer with vibration in the given seconds."""

    def __init__(self, shaken: set[int], over: threading.Event) -> None:
        self._shaken = shaken
        self._over = over
        self._reads = 0

    def identify(self) -> str:
        return "shaken chip"

    def read_many(self, _seconds: float) -> list[AccelerationReading]:
        second, self._reads = self._reads // SAMPLES_A_SECOND, self._reads + 1
        if second > max(self._shaken) + 1:
            self._over.set()
        x_g = 0.02 * (-1.0) ** self._reads if second in self._shaken else 0.0
        now = Instant.now()
        return [AccelerationReading(x_g, 0.0, 1.0, 20.0, now.monotonic_s, now.utc)]

    def close(self) -> None:
        pass


def test_the_state_has_the_time_of_the_last_motion(monkeypatch: pytest.MonkeyPatch) -> None:
    class Quick(threading.Event):
        def wait(self, timeout: float | None = None) -> bool:
            return super().wait(0.001 if timeout else timeout)

    daemon_state, stop = DaemonState(), Quick()
    chip = ShakenChip({2, 5}, stop)
    told: list[int] = []
    monkeypatch.setattr(daemon_state, "set_moving", lambda: told.append(chip._reads // SAMPLES_A_SECOND))
    monkeypatch.setattr(stationary_trigger, "open_inclinometer", lambda _: chip)
    config = RigConfig.model_construct(
        inclinometer=None, run=RunSection(dem=("dem.tif",), rest=RestTrigger(still_s=1e6))
    )
    StationaryMonitor(config, daemon_state, DeviceLocks(), lambda: False).run(lambda: None, stop)
    assert told == [3, 6]  # each at the end of its second


class FakeDevices:
    """Ways to open devices; those in ``broken`` fail."""

    def __init__(self, *names: str) -> None:
        self.broken: set[str] = set()
        self.opened: list[str] = []
        self.warnings: dict[str, tuple[str, ...]] = {}
        self.openers = {name: self._opener(name) for name in names}

    def _opener(self, name: str):  # type: ignore[no-untyped-def]
        @contextmanager
        def opened() -> Iterator[Source]:
            self.opened.append(name)
            if name in self.broken:
                raise DeviceError(name, "does not answer", "check its cable")
            reading = Reading({}, time.monotonic(), self.warnings.get(name, ()))
            yield Source(f"{name} X1", lambda: reading)

        return opened


class Watched:
    """A device watch that runs."""

    def __init__(self, devices: FakeDevices) -> None:
        self.daemon_state, self.device_locks, self.devices = DaemonState(), DeviceLocks(), devices
        self.daemon_state.set_activity("idle")
        run = RunSection.model_validate(
            {"dem": ["x.tif"], "retry_least_s": 0.01, "retry_most_s": 0.05, "check_every_s": 0.05}
        )
        self.watch = DeviceMonitor(
            SimpleNamespace(run=run),  # type: ignore[arg-type]
            self.daemon_state,
            self.device_locks,
            openers=devices.openers,
        )

    def until(self, **states: str) -> None:
        deadline_s = time.monotonic() + 60.0
        while time.monotonic() < deadline_s:
            now = {device.name: device.state for device in self.daemon_state.snapshot().devices}
            if all(now[name] == state for name, state in states.items()):
                return
            time.sleep(0.01)
        pytest.fail(f"never {states}: {self.daemon_state.snapshot().devices}")


@pytest.fixture
def watched() -> Iterator[Watched]:
    watched, stop = Watched(FakeDevices("head", "inclinometer", "compass", "camera")), threading.Event()
    thread = threading.Thread(target=watched.watch.run, args=(lambda: None, stop))
    watched.devices.broken = {"camera", "compass"}
    thread.start()
    yield watched
    stop.set()
    thread.join()


class TestDevices:
    def test_before_the_daemon_has_started_there_is_no_capture(self) -> None:
        daemon_state = DaemonState()
        assert why_not_ready(daemon_state) == "still starting"
        daemon_state.set_activity("idle")
        assert why_not_ready(daemon_state) is None

    def test_one_that_comes_is_found_and_one_that_goes_is_missed(self, watched: Watched) -> None:
        watched.until(head="ok", camera="failing", compass="failing", altimeter="absent")
        assert why_not_ready(watched.daemon_state) == "camera not ready"
        assert watched.daemon_state.snapshot().degraded
        watched.devices.broken = {"compass"}
        watched.until(camera="ok")
        assert why_not_ready(watched.daemon_state) is None  # without a compass it goes on
        watched.devices.broken = {"compass", "head"}
        watched.until(head="failing")
        assert why_not_ready(watched.daemon_state) == "head not ready"

    def test_a_servo_with_a_hardware_error_is_not_ready(self, watched: Watched) -> None:
        watched.devices.warnings["head"] = ("pan servo: overload",)
        watched.until(head="failing")
        (head,) = (device for device in watched.daemon_state.snapshot().devices if device.name == "head")
        assert head.detail == "pan servo: overload"

    def test_nothing_is_opened_while_a_capture_has_the_devices(self, watched: Watched) -> None:
        watched.until(head="ok")
        with watched.device_locks.all():
            watched.devices.opened.clear()
            watched.watch.probe_now()
            time.sleep(0.6)
            assert watched.devices.opened == []


def test_waits_double_up_to_the_longest() -> None:
    waits, wait_s = [], 0.0
    for _ in range(8):
        wait_s = next_wait_s(wait_s, 1.0, 60.0)
        waits.append(wait_s)
    assert waits == [1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 60.0, 60.0]
