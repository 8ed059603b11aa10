"""One time base for all of ``rig``, and the clocks that tests put there."""

import ast
import threading
import time
from datetime import timedelta
from pathlib import Path

import pytest
from fakes.timebases import FastClock, SteppedClock, on

from rig import clock, timebase
from rig.clock import Instant, utc_now

RIG = Path(timebase.__file__).parent
WAIT_FOR_THE_SYSTEM = {
    "bundle/archive.py": "the date of a file",
    "daemon/boot.py": "the clock that counts the time asleep",
    "daemon/control.py": "sockets",
    "daemon/http/access_control.py": "sockets",
    "daemon/notify.py": "the service manager's clock",
    "daemon/runtime.py": "the end of threads",
    "daemon/search/process.py": "the end of a process",
    "daemon/search/worker.py": "what a search takes of the processor",
    "devices/bus/i2c.py": "a lock between processes",
    "devices/camera/driver.py": "the end of threads; how long a grab blocks",
    "timebase.py": "the time base itself",
    "watch/watcher.py": "the end of threads",
}
"""Modules of ``rig`` that use the computer's clock, and for what."""


def test_rig_takes_its_time_from_the_time_base_and_what_waits_for_the_system_is_listed() -> None:
    found = set()
    for path in RIG.rglob("*.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        names = {
            alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names
        } | {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
        if "time" in names:
            found.add(str(path.relative_to(RIG)))
    assert found == set(WAIT_FOR_THE_SYSTEM)


def test_it_is_the_computer_s_clock_unless_another_is_put_there() -> None:
    assert timebase.monotonic_s() == pytest.approx(time.monotonic(), abs=5.0)
    with pytest.raises(KeyError), on(SteppedClock()):
        raise KeyError
    assert timebase.monotonic_s() == pytest.approx(time.monotonic(), abs=5.0)
    assert abs(clock.step_s()) < 5.0, "the session's UTC belongs to it again"


def test_on_a_fast_clock_both_clocks_and_all_waits_are_fast() -> None:
    begun_s = time.monotonic()
    with on(FastClock(100.0)):
        before = Instant.now()
        timebase.sleep(10.0)
        assert not timebase.wait(threading.Event(), 10.0)
        with (changed := threading.Condition()):
            assert not timebase.wait_for(changed, lambda: False, 10.0)
        after = Instant.now()
        assert abs(clock.step_s()) < 25.0, "UTC goes with it"
    assert after.monotonic_s - before.monotonic_s >= 30.0
    assert after.utc - before.utc >= timedelta(seconds=30)
    assert time.monotonic() - begun_s < 60.0


def test_a_stepped_clock_lets_each_thread_run_until_it_waits_again() -> None:
    seen: list[tuple[str, float]] = []
    stop = threading.Event()

    def beat(name: str, every_s: float) -> None:
        while not timebase.wait(stop, every_s):
            seen.append((name, timebase.monotonic_s()))

    with on(SteppedClock()) as stepped:
        begun_s, begun_utc = timebase.monotonic_s(), utc_now()
        threads = [threading.Thread(target=beat, args=each) for each in (("a", 2.0), ("b", 3.0))]
        for thread in threads:
            thread.start()
        stepped.until_waiting(2)
        stepped.advance(1.9)
        assert seen == []
        stepped.advance(4.3)
        assert sorted((round(at_s - begun_s, 6), name) for name, at_s in seen) == [
            (2.0, "a"),
            (3.0, "b"),
            (4.0, "a"),
            (6.0, "a"),
            (6.0, "b"),
        ]
        assert utc_now() - begun_utc == timedelta(seconds=6.2)
        stop.set()
        for thread in threads:
            thread.join(60.0)
            assert not thread.is_alive()
