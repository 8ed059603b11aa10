"""Prometheus metrics: the daemon state at the time of the request, and durations of answers."""

import threading
from collections.abc import Iterator
from typing import get_args

from prometheus_client import CollectorRegistry, Histogram, disable_created_metrics
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from rig.clock import Instant
from rig.daemon.http.event_streams import EventStreams
from rig.daemon.http.models import age_s
from rig.daemon.state import Activity, Answer, DaemonState, DeviceState

SECONDS = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0)


def metrics_registry(daemon_state: DaemonState, event_streams: EventStreams) -> CollectorRegistry:
    """A separate registry: nothing of the default one is exported."""
    disable_created_metrics()  # type: ignore[no-untyped-call]  # when a histogram was made says nothing of the rig
    registry = CollectorRegistry()
    registry.register(_StateCollector(daemon_state, event_streams))
    return registry


class _StateCollector(Collector):
    """Reads the daemon state at each request. Each answer's durations are counted once, however many clients ask."""

    def __init__(self, daemon_state: DaemonState, event_streams: EventStreams) -> None:
        self._state = daemon_state
        self._relay = event_streams
        self._lock = threading.Lock()
        self._last: Answer | None = None
        self._delay = Histogram(
            "skyfix_answer_delay_seconds",
            "From the capture to its answer, of the answers seen when asked.",
            registry=None,
            buckets=SECONDS,
        )
        self._search = Histogram(
            "skyfix_search_seconds",
            "Of the search's parts, of the answers seen when asked.",
            ["part"],
            registry=None,
            buckets=SECONDS,
        )

    def describe(self) -> list[Metric]:
        return []

    def collect(self) -> Iterator[Metric]:
        snapshot, now = self._state.snapshot(), Instant.now()
        self._take_durations(snapshot.last)
        yield _gauge("skyfix_up_seconds", "Since the daemon's start.", age_s(snapshot.started, now))
        activity = GaugeMetricFamily("skyfix_activity", "1 for what the daemon does.", labels=["activity"])
        for name in get_args(Activity):
            activity.add_metric([name], float(name == snapshot.activity))
        yield activity
        device = GaugeMetricFamily(
            "skyfix_device", "1 for the state each device is in.", labels=["device", "state"]
        )
        for each in snapshot.devices:
            for state in get_args(DeviceState):
                device.add_metric([each.name, state], float(state == each.state))
        yield device
        yield _gauge(
            "skyfix_degraded", "1 where a device that should work does not.", float(snapshot.degraded)
        )
        yield _gauge("skyfix_bundles_waiting", "Bundles not located yet.", snapshot.waiting)
        yield _gauge("skyfix_event_streams", "Readers of /events.", self._relay.streams)
        counts = CounterMetricFamily(
            "skyfix_happened", "What has happened so often since the start.", labels=["what"]
        )
        for what, count in sorted(snapshot.counts.items()):
            counts.add_metric([what], count)
        yield counts
        yield from _answer_metrics(snapshot.last, snapshot.last_fix, now)
        yield from self._delay.collect()
        yield from self._search.collect()

    def _take_durations(self, last: Answer | None) -> None:
        with self._lock:
            if last is None or last is self._last or last.before_start:
                return
            self._last = last
        self._delay.observe(age_s(last.captured, last.answered))
        for part, seconds in last.fix.timing_s.items():
            self._search.labels(part).observe(seconds)


def _answer_metrics(last: Answer | None, last_fix: Answer | None, now: Instant) -> Iterator[Metric]:
    """Absent without an answer: an age of 0 would be wrong."""
    if last is not None:
        yield _gauge(
            "skyfix_answer_age_seconds", "Since the capture of the latest answer.", age_s(last.captured, now)
        )
    if last_fix is not None:
        yield _gauge(
            "skyfix_fix_age_seconds", "Since the capture of the latest fix.", age_s(last_fix.captured, now)
        )
        yield _gauge("skyfix_fix_probability", "Of the latest fix.", last_fix.fix.probability)


def _gauge(name: str, what: str, value: float) -> Metric:
    return GaugeMetricFamily(name, what, value=value)
