"""The daemon's signals: SIGTERM and SIGINT stop it, SIGHUP reloads the configuration, SIGUSR1 requests a capture.

Only the first stop signal interrupts the main thread, and not within ``deferring_stop``. The handlers take no locks, as
they may interrupt the holder of one.
"""

import os
import queue
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType, TracebackType
from typing import Literal, Self

KILL_AFTER_S = 9.0
"""After this time the process is ended by force; the torque is switched off first."""

SignalRequest = Literal["reload", "trigger"]


class StopRequestedError(BaseException):
    """The daemon has to stop. Not an ``Exception``: only the daemon itself may handle it."""


class Signals:
    """Handles the signals while the context lasts. For the main thread, except ``requests``."""

    def __init__(self) -> None:
        self.requests: queue.SimpleQueue[SignalRequest] = queue.SimpleQueue()
        """What was asked for, in order; its ``put`` may interrupt itself."""
        self.stopping = False
        self._shields = 0

    def __enter__(self) -> Self:
        handlers = {
            signal.SIGTERM: self._stop,
            signal.SIGINT: self._stop,
            signal.SIGHUP: lambda number, frame: self.requests.put("reload"),
            signal.SIGUSR1: lambda number, frame: self.requests.put("trigger"),
        }
        self._before = {number: signal.signal(number, handler) for number, handler in handlers.items()}
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    @contextmanager
    def deferring_stop(self) -> Iterator[None]:
        """Defer a stop signal until the end of the context."""
        self._shields += 1
        try:
            yield
        finally:
            self._shields -= 1
        if self.stopping and not self._shields:
            raise StopRequestedError

    def _stop(self, number: int, frame: FrameType | None) -> None:
        if self.stopping:
            return
        self.stopping = True
        last_resort = threading.Timer(KILL_AFTER_S, os._exit, (1,))
        last_resort.daemon = True
        last_resort.start()
        if not self._shields:
            raise StopRequestedError
