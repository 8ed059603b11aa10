"""Clocks to put in place of the computer's (``rig.timebase.running_on``): one that runs faster, one that a test steps."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from typing import TypeVar

from rig.clock import begin_session
from rig.timebase import Clock, running_on

C = TypeVar("C", bound=Clock)

GIVES_UP_S = 120.0
"""Of the computer's clock; only a failing test lasts so long."""


@contextmanager
def on(clock: C) -> Iterator[C]:
    """Let all of ``rig`` run on this clock while the context lasts."""
    try:
        with running_on(clock):
            begin_session()
            yield clock
    finally:
        begin_session()


class FastClock:
    """Runs ``speed`` times as fast as the computer's clock, from now on.

    Whatever times out then times out as much earlier: the limits of what shall not fail must be as much longer.
    """

    def __init__(self, speed: float) -> None:
        self.speed = speed
        self._skipped_s = 0.0
        self._begun_s, self._begun_utc = time.monotonic(), datetime.now(UTC)

    def monotonic_s(self) -> float:
        return self._begun_s + self._passed_s()

    def wall_utc(self) -> datetime:
        return self._begun_utc + timedelta(seconds=self._passed_s())

    def _passed_s(self) -> float:
        return self._skipped_s + self.speed * (time.monotonic() - self._begun_s)

    def sleep(self, seconds: float) -> None:
        time.sleep(seconds / self.speed)

    def wait(self, event: threading.Event, seconds: float) -> bool:
        return event.wait(seconds / self.speed)

    def wait_for(self, changed: threading.Condition, ready: Callable[[], bool], seconds: float) -> bool:
        return changed.wait_for(ready, seconds / self.speed)

    def computer_s(self, seconds: float) -> float:
        return seconds / self.speed

    def skip(self, seconds: float) -> None:
        """Let so much time have passed."""
        self._skipped_s += seconds


class SteppedClock:
    """Stands still until the test lets time pass. Threads that wait on it run in between, each until it waits again.

    What a thread does between two waits takes no time on it, so that nothing depends on how busy the computer is.
    """

    def __init__(self) -> None:
        self._now_s, self._utc = 1000.0, datetime(2026, 11, 27, tzinfo=UTC)
        self._changed = threading.Condition()
        self._due_s: dict[threading.Thread, float] = {}
        """When each of the waiting threads goes on."""
        self._running: set[threading.Thread] = set()
        """Threads that have waited and go on now."""

    def monotonic_s(self) -> float:
        return self._now_s

    def wall_utc(self) -> datetime:
        return self._utc + timedelta(seconds=self._now_s - 1000.0)

    def sleep(self, seconds: float) -> None:
        self._wait(lambda: False, seconds)

    def wait(self, event: threading.Event, seconds: float) -> bool:
        self._wait(event.is_set, seconds)
        return event.is_set()

    def wait_for(self, changed: threading.Condition, ready: Callable[[], bool], seconds: float) -> bool:
        raise NotImplementedError("no test steps what waits on a condition")

    def computer_s(self, seconds: float) -> float:
        return 0.0

    def _wait(self, is_over: Callable[[], bool], seconds: float) -> None:
        thread = threading.current_thread()
        with self._changed:
            self._running.discard(thread)
            self._due_s[thread] = self._now_s + seconds
            self._changed.notify_all()
            while thread in self._due_s and not is_over():
                self._changed.wait(0.002)  # an event that is set does not notify
            self._due_s.pop(thread, None)
            self._running.add(thread)

    def until_waiting(self, number: int) -> None:
        """Wait until so many threads wait on this clock."""
        with self._changed:
            assert self._changed.wait_for(lambda: len(self._due_s) >= number, GIVES_UP_S), "nothing waits"

    def advance(self, seconds: float) -> None:
        """Let time pass. Whoever waited for a moment of it has gone on, and waits again, when this returns."""
        end_s = self._now_s + seconds
        while True:
            with self._changed:
                assert self._changed.wait_for(self._is_quiet, GIVES_UP_S), f"{self._running} never wait again"
                next_s = min(self._due_s.values(), default=end_s)
                self._now_s = max(self._now_s, min(next_s, end_s))
                self._running.clear()  # those have ended
                for thread in [each for each, due_s in self._due_s.items() if due_s <= self._now_s]:
                    del self._due_s[thread]
                    self._running.add(thread)
                self._changed.notify_all()
                if next_s > end_s or not self._running:
                    return

    def _is_quiet(self) -> bool:
        return not any(thread.is_alive() for thread in self._running)
