"""One thread per device reads it continuously and reopens it after failures; the newest readings are available at any
time.
"""

import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import TracebackType
from typing import Literal, Self

from rig import timebase
from rig.errors import RigError
from rig.watch.sources import Opener, Reading

RETRY_FIRST_S, RETRY_MOST_S = 0.5, 4.0
STALE_AFTER_S = 3.0
"""An older reading is stale: an exchange hangs, or is being retried."""
END_S = 6.0
"""A thread ends after its current reading, which takes this long only if a port was unplugged."""

ReadState = Literal["connecting", "ok", "warning", "silent", "failing"]


@dataclass(frozen=True)
class DeviceStatus:
    """State of one device. ``problem`` is its present fault, ``reading`` the last good one, of any age."""

    name: str
    state: ReadState
    identity: str
    reading: Reading | None
    problem: str | None
    failures: int

    @property
    def age_s(self) -> float | None:
        """Age of the reading."""
        return None if self.reading is None else timebase.monotonic_s() - self.reading.monotonic_s

    def with_staleness(self) -> "DeviceStatus":
        """The status, with a stale reading turned into a problem."""
        age_s = self.age_s
        if age_s is None or age_s <= STALE_AFTER_S or self.state == "failing":
            return self
        return replace(self, state="silent", problem=f"no reading for {age_s:.0f} s")


class Watcher:
    """Reads devices while the context lasts."""

    def __init__(self, openers: Mapping[str, Opener]) -> None:
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._statuses = {name: DeviceStatus(name, "connecting", "", None, None, 0) for name in openers}
        self._threads = [
            threading.Thread(target=self._watch, args=each, name=f"watch {each[0]}", daemon=True)
            for each in openers.items()
        ]

    def __enter__(self) -> Self:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop.set()
        deadline_s = time.monotonic() + END_S
        for thread in self._threads:
            thread.join(max(0.0, deadline_s - time.monotonic()))

    def statuses(self) -> list[DeviceStatus]:
        """The status of all devices now."""
        with self._lock:
            return [status.with_staleness() for status in self._statuses.values()]

    def wait_first_readings(self, timeout_s: float) -> None:
        """Wait until each device has been read or has failed."""
        deadline_s = timebase.monotonic_s() + timeout_s
        while timebase.monotonic_s() < deadline_s and any(s.state == "connecting" for s in self.statuses()):
            timebase.sleep(0.02)

    def _watch(self, name: str, opener: Opener) -> None:
        wait_s = RETRY_FIRST_S
        while not self._stop.is_set():
            try:
                with opener() as source:
                    while not self._stop.is_set():
                        self._read(name, source.identity, source.read())
                        wait_s = RETRY_FIRST_S
            except RigError as error:
                self._failed(name, str(error))
                timebase.wait(self._stop, wait_s)
                wait_s = min(2.0 * wait_s, RETRY_MOST_S)

    def _read(self, name: str, identity: str, reading: Reading) -> None:
        problem = "; ".join(reading.warnings) or None
        state: ReadState = "warning" if problem else "ok"
        with self._lock:
            failures = self._statuses[name].failures
            self._statuses[name] = DeviceStatus(name, state, identity, reading, problem, failures)

    def _failed(self, name: str, problem: str) -> None:
        with self._lock:
            before = self._statuses[name]
            self._statuses[name] = replace(
                before, state="failing", problem=problem, failures=before.failures + 1
            )
