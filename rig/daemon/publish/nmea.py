"""``[run.nmea]``: NMEA 0183 to TCP clients and to configured UDP addresses."""

import logging
import threading
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, nullcontext
from dataclasses import dataclass

from rig import timebase
from rig.clock import Instant
from rig.clock import problem as clock_problem
from rig.config.run import NmeaOutput
from rig.daemon.heartbeat import Heartbeats
from rig.daemon.publish.nmea_sentences import epoch, epoch_for_datagrams
from rig.daemon.publish.published import current_fix, expiry_reason
from rig.daemon.publish.tcp_broadcast import TcpBroadcast
from rig.daemon.publish.udp_targets import UdpTarget
from rig.daemon.state import Answer, DaemonState

LOOP = "nmea"
STOP_NOTICED_S = 0.2
LOOP_LONGEST_S = 10.0
MIN_RETRY_S, MAX_RETRY_S = 1.0, 60.0

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class NmeaPublisher:
    """The running publisher."""

    tcp: tuple[str, int] | None
    """Host and port of the TCP server."""


@contextmanager
def publishing(
    section: NmeaOutput, daemon_state: DaemonState, heartbeats: Heartbeats | None = None
) -> Iterator[NmeaPublisher]:
    """Publish the current fix every ``section.every_s`` while the context lasts.

    Raises ``ConfigError`` where the address cannot be listened on.
    """
    stop = threading.Event()
    targets = [UdpTarget(address, daemon_state) for address in section.udp]
    with ExitStack() as stack:
        server = None if section.tcp is None else TcpBroadcast(section.tcp, "[run.nmea] tcp")
        if server is not None:
            stack.callback(server.close)
        for target in targets:
            stack.callback(target.close)
        names = [target for target in targets if not target.find(numeric=True)]
        if names:
            threading.Thread(
                target=_resolve_names, args=(names, stop), name="nmea names", daemon=True
            ).start()
        publisher = _Publisher(section, daemon_state, server, targets)
        thread = threading.Thread(target=publisher.run, args=(stop, heartbeats), name=LOOP, daemon=True)
        thread.start()
        stack.callback(thread.join)
        stack.callback(stop.set)
        yield NmeaPublisher(None if server is None else server.address)


def _resolve_names(targets: Sequence[UdpTarget], stop: threading.Event) -> None:
    """Resolve host names, in a separate thread: without a network that blocks, and a name may become resolvable hours
    later.
    """
    wait_s = MIN_RETRY_S
    left = list(targets)
    while left := [target for target in left if not target.find()]:
        if timebase.wait(stop, wait_s):
            return
        wait_s = min(2.0 * wait_s, MAX_RETRY_S)


class _Publisher:
    def __init__(
        self,
        section: NmeaOutput,
        daemon_state: DaemonState,
        server: TcpBroadcast | None,
        targets: Sequence[UdpTarget],
    ) -> None:
        self._section = section
        self._state = daemon_state
        self._server = server
        self._targets = targets
        latest = daemon_state.snapshot().last
        self._seen = latest.bundle if latest else None

    def run(self, stop: threading.Event, heartbeats: Heartbeats | None) -> None:
        """Send an epoch whenever one is due, by the monotonic clock, until ``stop``."""
        with nullcontext() if heartbeats is None else heartbeats.watched(LOOP, LOOP_LONGEST_S):
            due_s = timebase.monotonic_s()
            while not stop.is_set():
                if heartbeats is not None:
                    heartbeats.beat(LOOP)
                now_s = timebase.monotonic_s()
                if now_s >= due_s:
                    self._send()
                    due_s = max(due_s + self._section.every_s, now_s)  # missed epochs are skipped
                self._wait(min(due_s - now_s, STOP_NOTICED_S), stop)

    def _wait(self, timeout_s: float, stop: threading.Event) -> None:
        if self._server is None:
            timebase.wait(stop, max(timeout_s, 0.0))
        else:
            self._server.serve(max(timeout_s, 0.0))

    def _send(self) -> None:
        now, snapshot = Instant.now(), self._state.snapshot()
        fix = current_fix(snapshot, now, self._section.valid_s)
        if snapshot.last is not None and snapshot.last.bundle != self._seen:
            self._seen = snapshot.last.bundle
            self._log_expiry(
                snapshot.last, expiry_reason(snapshot.last, snapshot, now, self._section.valid_s)
            )
        how = now.utc, self._section.quality, self._section.sentences
        dated = not any(clock_problem(utc) for utc in (now.utc, now.utc if fix is None else fix.utc))
        if self._server is not None:
            # a client that connects during a repeated fix sees no time change, which gpsd needs to end an
            # epoch
            first = b"" if fix is None else epoch(None, *how, dated=dated)
            self._server.send(epoch(fix, *how, dated=dated), first=first)
        for target in self._targets:
            target.send(epoch_for_datagrams(fix, *how, dated=dated))

    def _log_expiry(self, answer: Answer, why: str | None) -> None:
        if answer.fix.status == "fix" and why is not None:
            self._state.count("nmea fixes never current")
            _log.warning("nmea: the fix of %s is not published: %s", answer.bundle, why)
