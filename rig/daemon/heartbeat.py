"""Heartbeats of the daemon's loops; the service manager's watchdog is reset only while all are on time."""

import dataclasses
import logging
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from rig import timebase
from rig.daemon.notify import Notifier

_log = logging.getLogger(__name__)

CHECK_EVERY_S = 5.0
"""Check interval without a manager; else a third of its timeout, so that one datagram may be lost."""


@dataclass
class _Loop:
    max_interval_s: float
    due_monotonic_s: float
    beat_monotonic_s: float
    thread: int
    failed: str | None = None
    """The error that ended the loop."""


@dataclass(frozen=True)
class StalledLoop:
    """A loop without a timely heartbeat."""

    name: str
    why: str
    """Since when its heartbeat is missing and where its thread is, or the error that ended it."""

    def __str__(self) -> str:
        return f"{self.name} {self.why}"


class Heartbeats:
    """The supervised loops by name. Thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._heartbeats: dict[str, _Loop] = {}

    @contextmanager
    def watched(self, name: str, max_interval_s: float) -> Iterator[None]:
        """Supervise this thread's loop while the context lasts; ``max_interval_s`` is the longest allowed time between
        heartbeats.

        A loop that ends with an ``Exception`` stays listed as stalled until it is started again; other endings were
        requested.
        """
        now = timebase.monotonic_s()
        loop = _Loop(max_interval_s, now + max_interval_s, now, threading.get_ident())
        with self._lock:
            if name in self._heartbeats and self._heartbeats[name].failed is None:
                raise ValueError(f"two loops are called {name!r}")
            self._heartbeats[name] = loop
        try:
            yield
        except Exception as error:
            loop.failed = f"{type(error).__name__}: {error}"
            raise
        finally:
            with self._lock:
                if loop.failed is None:
                    del self._heartbeats[name]

    def beat(self, name: str, within_s: float | None = None) -> None:
        """A heartbeat of this loop. ``within_s`` allows the next one that long, once, for a slow step."""
        with self._lock:
            loop = self._heartbeats[name]
            loop.beat_monotonic_s = timebase.monotonic_s()
            loop.due_monotonic_s = loop.beat_monotonic_s + (
                loop.max_interval_s if within_s is None else within_s
            )
            loop.thread = threading.get_ident()

    def stalled(self) -> tuple[StalledLoop, ...]:
        """The stalled loops."""
        with self._lock:
            named = [(name, dataclasses.replace(loop)) for name, loop in self._heartbeats.items()]
        now = timebase.monotonic_s()
        found = []
        for name, loop in named:
            if loop.failed is not None:
                found.append(StalledLoop(name, f"ended by {loop.failed}"))
            elif now > loop.due_monotonic_s:
                silent_s = now - loop.beat_monotonic_s
                found.append(StalledLoop(name, f"hangs: nothing for {silent_s:.0f} s, {_where(loop.thread)}"))
        return tuple(found)


def _where(thread: int) -> str:
    """The innermost line of our code in this thread's stack; library frames below it only wait."""
    innermost = frame = sys._current_frames().get(thread)
    if frame is None:
        return "its thread has ended"
    while frame is not None and not frame.f_globals.get("__name__", "").startswith(("rig.", "localizer.")):
        frame = frame.f_back
    frame = frame or innermost
    assert frame is not None
    return f"at {frame.f_globals.get('__name__')} line {frame.f_lineno}, in {frame.f_code.co_name}"


@contextmanager
def watchdog(heartbeats: Heartbeats, notifier: Notifier) -> Iterator[None]:
    """Reset the manager's watchdog while all loops are alive and the context lasts; else log and report the stalled
    one.
    """
    ended = threading.Event()
    thread = threading.Thread(target=_watch, args=(heartbeats, notifier, ended), name="watchdog", daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def _watch(heartbeats: Heartbeats, notifier: Notifier, ended: threading.Event) -> None:
    every_s = notifier.watchdog_s / 3 if notifier.watchdog_s else CHECK_EVERY_S
    hung: set[str] = set()
    while True:
        stalled = heartbeats.stalled()
        hanging = {each.name for each in stalled}
        for each in stalled:
            if each.name not in hung:
                _log.error("%s", each)
        for name in sorted(hung - hanging):
            _log.warning("%s gets on again", name)
        if stalled:
            notifier.set_fault("; ".join(map(str, stalled)))
        elif hung:
            notifier.clear_fault()
        if not stalled:
            notifier.progress()
        hung = hanging
        if timebase.wait(ended, every_s):
            return
