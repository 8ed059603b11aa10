"""Recovered faults of a session, stored with the measurement.

Code that recovers from a fault calls ``note_fault``; code that records a measurement collects the notes. An error that
ends the command is not noted: it is the command's message.
"""

import logging
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from rig import event_bus
from rig.clock import Instant

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class FaultNote:
    """One kind of fault of one device: how often it occurred, first and last time."""

    device: str
    problem: str
    action: str
    count: int
    first: Instant
    last: Instant

    def as_json(self) -> dict[str, Any]:
        """JSON values; ages are ``monotonic_s``."""
        return {
            "device": self.device,
            "problem": self.problem,
            "action": self.action,
            "count": self.count,
            "first": _time(self.first),
            "last": _time(self.last),
        }


class FaultNotes:
    """The notes of one session in order of first occurrence. Thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._notes: dict[tuple[str, str, str], FaultNote] = {}

    def add(self, device: str, problem: str, action: str) -> None:
        """Note a fault; a repeated one only increases its count."""
        key, now = (device, problem, action), Instant.now()
        with self._lock:
            before = self._notes.get(key)
            count, first = (before.count + 1, before.first) if before else (1, now)
            self._notes[key] = FaultNote(*key, count, first, now)

    def all(self) -> list[FaultNote]:
        """All notes so far."""
        with self._lock:
            return list(self._notes.values())

    def as_json(self) -> list[dict[str, Any]]:
        """For the bundle's ``raw.faults``."""
        return [note.as_json() for note in self.all()]


_collectors: list[FaultNotes] = []


def note_fault(device: str, problem: str, action: str) -> None:
    """Note a recovered fault: the device, what happened, what was done about it."""
    _log.info("%s: %s; %s", device, problem, action)
    event_bus.publish(event_bus.Step("warning", device, f"{problem}; {action}"))
    for notes in list(_collectors):
        notes.add(device, problem, action)


@contextmanager
def collecting() -> Iterator[FaultNotes]:
    """Collect the notes of all threads while the context lasts."""
    notes = FaultNotes()
    _collectors.append(notes)
    try:
        yield notes
    finally:
        _collectors.remove(notes)


def _time(instant: Instant) -> dict[str, Any]:
    utc = instant.utc.isoformat(timespec="milliseconds").replace("+00:00", "Z")
    return {"time": utc, "monotonic_s": round(instant.monotonic_s, 3)}
