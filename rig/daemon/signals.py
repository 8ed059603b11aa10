"""The daemon's signals: SIGTERM and SIGINT end it, SIGHUP has the configuration read anew, SIGUSR1 asks for a capture.

Only the first that ends it interrupts the main thread, and not within ``deferring_stop``. A handler takes no lock: it may
interrupt whoever holds it.
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
"""After that the process ends whatever it does; the head was let go first of all."""

SignalRequest = Literal["reload", "trigger"]


class StopRequestedError(BaseException):
    """The daemon is to end. No ``Exception``: nobody but the daemon itself may take care of it."""


class Signals:
    """Takes the signals while the context lasts. To be used by the main thread, but for ``requests``."""

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
        """What is begun here is ended, before a stop that came meanwhile is raised."""
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
