"""The daemon's shared state: updated by its loops, read by its publishers.

One ``DaemonState`` per daemon, thread-safe. A snapshot is immutable and never blocks on a device. Subscribers get each
event once, in order; a slow one loses the oldest events and is told how many.
"""

import dataclasses
import queue
import threading
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Literal, Protocol

from localizer.fix import Fix
from localizer.track.document import TrackHypothesis
from localizer.track.tracker import Mode
from rig.clock import Instant
from rig.daemon.boot import suspended_s

EVENTS_WAITING = 256
MIN_SUSPEND_S = 1.0
"""Shorter ones are clock differences."""

TriggerSource = Literal["interval", "rest", "command", "http", "signal", "found"]
"""``found``: a bundle found in the spool without a known trigger."""
TriggerAnswer = Literal["started", "busy", "not ready", "stopping"]
DeviceState = Literal["absent", "connecting", "ok", "failing"]
Activity = Literal["starting", "connecting", "idle", "capturing", "stopping"]
EventKind = Literal["status", "device", "trigger", "capture", "answer", "log"]


@dataclass(frozen=True)
class DeviceHealth:
    """State of one device: ``absent`` is not configured, ``failing`` is configured and not working."""

    name: str
    state: DeviceState
    detail: str
    """Identity of a working device, else its fault in one line."""
    since: Instant


@dataclass(frozen=True)
class Answer:
    """The answer to one bundle. Its position is that at the time of the capture, not of the answer."""

    bundle: str
    captured: Instant
    answered: Instant
    trigger: TriggerSource
    fix: Fix
    mode: Mode
    hypotheses: tuple[TrackHypothesis, ...]
    elsewhere: float
    altitude_m: float | None
    """Of the camera, above the DEM's vertical datum, as solved for; None where ``fix.status`` is none."""
    vehicle_heading_deg: float | None
    """Of the vehicle's forward axis, from true north, corrected by the solved azimuth bias."""
    vehicle_heading_sigma_deg: float | None
    before_start: bool = False
    """Captured before the daemon started: motion since then is unknown, so it is never current."""
    wgs84_accuracy_m: float = 0.0
    """Additional uncertainty of latitude and longitude from the transformation of the DEM's datum."""


@dataclass(frozen=True)
class Event:
    """An event; ``data`` are JSON values."""

    number: int
    kind: EventKind
    at: Instant
    data: Mapping[str, Any]


@dataclass(frozen=True)
class Snapshot:
    """The whole state at one time. ``counts``: number of events since the start, by name."""

    started: Instant
    activity: Activity
    activity_since: Instant
    locating: str | None
    """The bundle that is being searched for."""
    waiting: int
    """Bundles in the spool that have not been located yet, that one among them."""
    devices: tuple[DeviceHealth, ...]
    last: Answer | None
    """The latest answer, whatever its status."""
    last_fix: Answer | None
    """The latest answer that is a fix: possibly of long ago."""
    storage: str | None = None
    """Why the spool takes no further bundle; None where it does."""
    moved: Instant | None = None
    """When the vehicle last moved, as far as known, or the computer was suspended."""
    counts: Mapping[str, int] = field(default_factory=lambda: MappingProxyType({}))

    @property
    def degraded(self) -> bool:
        """Whether a configured device fails."""
        return any(device.state in ("connecting", "failing") for device in self.devices)


class Actions(Protocol):
    """Actions that publishers may request."""

    def trigger(self, source: TriggerSource) -> TriggerAnswer:
        """Request a capture; answered at once, nothing is queued."""
        ...


class Subscription:
    """The events since its start, for one reader."""

    def __init__(self) -> None:
        self._events: queue.Queue[Event] = queue.Queue(EVENTS_WAITING)
        self.lost = 0

    def get(self, timeout_s: float) -> Event | None:
        """The next event; None after the timeout."""
        try:
            return self._events.get(timeout=timeout_s)
        except queue.Empty:
            return None

    def put(self, event: Event) -> None:
        """Add an event; for one writer at a time."""
        while True:
            try:
                self._events.put_nowait(event)
                return
            except queue.Full:
                try:
                    self._events.get_nowait()
                    self.lost += 1
                except queue.Empty:
                    continue


class DaemonState:
    """The daemon's shared state; see the module."""

    def __init__(self) -> None:
        now = Instant.now()
        self._lock = threading.Lock()
        self._counts: Counter[str] = Counter()
        self._subscriptions: list[Subscription] = []
        self._events = 0
        self._devices: dict[str, DeviceHealth] = {}
        self._now = Snapshot(now, "starting", now, None, 0, (), None, None)
        self._asleep_s = suspended_s()

    def snapshot(self) -> Snapshot:
        """The present state."""
        with self._lock:
            self._note_suspend()
            counts = MappingProxyType(dict(self._counts))
            return dataclasses.replace(self._now, devices=tuple(self._devices.values()), counts=counts)

    def _note_suspend(self) -> None:
        """Detect a suspend: motion was not observed, and the monotonic clock stood still."""
        now_s = suspended_s()
        if now_s - self._asleep_s > MIN_SUSPEND_S:
            self._asleep_s = now_s
            self._now = dataclasses.replace(self._now, moved=Instant.now())
            self._counts["times asleep"] += 1

    def set_activity(self, activity: Activity) -> None:
        """Set the activity; no event if unchanged."""
        with self._lock:
            if activity != self._now.activity:
                self._now = dataclasses.replace(self._now, activity=activity, activity_since=Instant.now())
                self._emit("status", {"activity": activity})

    def set_locating(self, bundle: str | None) -> None:
        """Set the bundle being located; no event if unchanged."""
        with self._lock:
            if bundle != self._now.locating:
                self._now = dataclasses.replace(self._now, locating=bundle)
                self._emit("status", {"locating": bundle})

    def set_waiting(self, bundles: int) -> None:
        """Set the number of waiting bundles; no event if unchanged."""
        with self._lock:
            if bundles != self._now.waiting:
                self._now = dataclasses.replace(self._now, waiting=bundles)
                self._emit("status", {"waiting": bundles})

    def set_storage(self, problem: str | None) -> None:
        """Set why the spool accepts no bundle, None if it does; no event if unchanged."""
        with self._lock:
            if problem != self._now.storage:
                self._now = dataclasses.replace(self._now, storage=problem)
                self._emit("status", {"storage": problem})

    def set_device(self, name: str, state: DeviceState, detail: str) -> None:
        """Set a device's state; if unchanged there is no event, and ``since`` stays."""
        with self._lock:
            before = self._devices.get(name)
            if before is None or (before.state, before.detail) != (state, detail):
                since = before.since if before and before.state == state else Instant.now()
                self._devices[name] = DeviceHealth(name, state, detail, since)
                self._emit("device", {"name": name, "state": state, "detail": detail})

    def set_answer(self, answer: Answer) -> None:
        """Set the answer to a bundle."""
        with self._lock:
            is_fix = answer.fix.status == "fix"
            last_fix = answer if is_fix else self._now.last_fix
            self._now = dataclasses.replace(self._now, last=answer, last_fix=last_fix)
            self._counts[f"answers {answer.fix.status}"] += 1
            self._emit("answer", {"bundle": answer.bundle, "status": answer.fix.status, "mode": answer.mode})

    def restore(self, last: Answer, last_fix: Answer | None) -> None:
        """Restore answers from before a restart; without event or count."""
        with self._lock:
            self._now = dataclasses.replace(self._now, last=last, last_fix=last_fix)

    def set_moving(self) -> None:
        """Record that the vehicle moves now; no event, as it may be called many times a second."""
        with self._lock:
            self._now = dataclasses.replace(self._now, moved=Instant.now())

    def count(self, what: str, by: int = 1) -> None:
        """Increase a counter."""
        with self._lock:
            self._counts[what] += by

    def emit(self, kind: EventKind, **data: Any) -> None:
        """Send an event that does not change the state."""
        with self._lock:
            self._emit(kind, data)

    @contextmanager
    def subscribed(self) -> Iterator[Subscription]:
        """Subscribe to events while the context lasts."""
        subscription = Subscription()
        with self._lock:
            self._subscriptions.append(subscription)
        try:
            yield subscription
        finally:
            with self._lock:
                self._subscriptions.remove(subscription)

    def _emit(self, kind: EventKind, data: Mapping[str, Any]) -> None:
        self._events += 1
        event = Event(self._events, kind, Instant.now(), data)
        for subscription in self._subscriptions:
            subscription.put(event)
