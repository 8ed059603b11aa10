"""``[run.mavlink]``: sends each new fix to an autopilot, once. A broken link is reopened without limit."""

import logging
import threading
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from types import ModuleType
from typing import Any

from rig import timebase
from rig.clock import Instant
from rig.config.run import MavlinkOutput
from rig.daemon.heartbeat import Heartbeats
from rig.daemon.publish.mavlink_link import Link, check, opened, why_no_link
from rig.daemon.publish.mavlink_messages import dialect, external_position_estimate, gps_input, heartbeat
from rig.daemon.publish.published import PublishedFix, current_fix, expiry_reason
from rig.daemon.state import DaemonState
from rig.errors import DeviceError

NAME = "mavlink"
HEARTBEAT_EVERY_S = 1.0
HEARTBEAT_TIMEOUT_S = 5.0
"""Heartbeat timeout of the autopilot (the MAVLink guide says four to five seconds)."""
POLL_EVERY_S = 0.2
ACK_TIMEOUT_S = 1.5
MAX_SENDS = 3
"""A command without acknowledgement is sent again (MAVLink's command protocol), with its age updated."""
MAX_READS = 500
"""Reads per round: an autopilot that streams must not block sending."""
LOOP_LONGEST_S = 30.0
MIN_RETRY_S, MAX_RETRY_S = 1.0, 60.0

_log = logging.getLogger(__name__)


@contextmanager
def publishing(
    section: MavlinkOutput, daemon_state: DaemonState, heartbeats: Heartbeats | None = None
) -> Iterator[None]:
    """Send new fixes while the context lasts; the link is a device in the daemon state.

    Raises ``ConfigError`` if pymavlink is missing or the connection string is invalid.
    """
    check(section.connection)
    common = dialect()
    stop = threading.Event()
    publisher = _Publisher(section, daemon_state, common)
    daemon_state.set_device(NAME, "connecting", section.connection)
    thread = threading.Thread(target=publisher.run, args=(stop, heartbeats), name=NAME, daemon=True)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join(timeout=2.0 * POLL_EVERY_S + HEARTBEAT_EVERY_S)  # longer during a name lookup


class _Publisher:
    def __init__(self, section: MavlinkOutput, daemon_state: DaemonState, common: ModuleType) -> None:
        self._section = section
        self._state = daemon_state
        self._common = common
        latest = daemon_state.snapshot().last_fix
        self._sent_up_to_s = latest.captured.monotonic_s if latest else float("-inf")
        """Captures up to here have been sent: none is sent twice, and none after a later one."""
        newest_answer = daemon_state.snapshot().last
        self._seen = newest_answer.bundle if newest_answer else None
        self._heard = False
        self._owed = False
        """The current fix was sent where no autopilot was heard, or one that has gone: who comes now has not got it."""

    def run(self, stop: threading.Event, heartbeats: Heartbeats | None) -> None:
        """Keep a link open until ``stop``."""
        wait_s = MIN_RETRY_S
        with nullcontext() if heartbeats is None else heartbeats.watched(NAME, LOOP_LONGEST_S):
            while not stop.is_set():
                try:
                    with opened(self._section.connection, self._section.baud) as link:
                        for autopilot_present in self._run_link(link, stop):
                            wait_s = MIN_RETRY_S if autopilot_present else wait_s
                            if heartbeats is not None:
                                heartbeats.beat(NAME)
                except (OSError, DeviceError) as error:
                    self._state.set_device(
                        NAME, "failing", f"{self._section.connection}: {why_no_link(error)}"
                    )
                    if heartbeats is not None:
                        heartbeats.beat(NAME, within_s=wait_s + LOOP_LONGEST_S)
                    timebase.wait(stop, wait_s)
                    wait_s = min(2.0 * wait_s, MAX_RETRY_S)

    def _run_link(self, link: Link, stop: threading.Event) -> Iterator[bool]:
        """After each round yield whether an autopilot is present."""
        session = _LinkSession(link, self._section, self._common, self._state)
        while not stop.is_set():
            session.step()
            self._send_new(session)
            yield session.autopilot_present
            timebase.wait(stop, POLL_EVERY_S)

    def _send_new(self, session: "_LinkSession") -> None:
        now, snapshot = Instant.now(), self._state.snapshot()
        fix = current_fix(snapshot, now, self._section.valid_s)
        if fix is not None and fix.captured.monotonic_s > self._sent_up_to_s:
            session.send_fix(fix, now)
            self._sent_up_to_s = fix.captured.monotonic_s
            self._owed = not session.autopilot_present
        elif fix is not None and self._owed and session.autopilot_present:
            session.send_current_fix(fix, now)
            self._owed = False
        elif fix is not None:
            session.retransmit(fix, now)
        if self._heard and not session.autopilot_present:
            self._owed = True
        self._heard = session.autopilot_present
        last = snapshot.last
        if last is not None and last.bundle != self._seen:
            self._seen = last.bundle
            why = expiry_reason(last, snapshot, now, self._section.valid_s)
            if last.fix.status == "fix" and why is not None:
                self._state.count("mavlink fixes not sent")
                _log.warning("mavlink: the fix of %s is not sent: %s", last.bundle, why)


class _LinkSession:
    """One link from opening to closing."""

    def __init__(
        self, link: Link, section: MavlinkOutput, common: ModuleType, daemon_state: DaemonState
    ) -> None:
        self._link = link
        self._section = section
        self._common = common
        self._state = daemon_state
        self._mav = common.MAVLink(link, srcSystem=section.system_id, srcComponent=section.component_id)
        self._mav.robust_parsing = True  # noise comes as BAD_DATA
        self._opened_s = timebase.monotonic_s()
        self._heard_s: float | None = None
        self._due_s = self._opened_s
        self._awaited_s: float | None = None
        """Until when the acknowledgement of the latest fix may come; None where none is missing."""
        self._times = 0

    @property
    def autopilot_present(self) -> bool:
        """Whether an autopilot's heartbeat is received."""
        return self._heard_s is not None and timebase.monotonic_s() - self._heard_s < HEARTBEAT_TIMEOUT_S

    def step(self) -> None:
        """Receive messages, and send a heartbeat once a second."""
        for _ in range(MAX_READS):
            if not (data := self._link.read()):
                break
            for message in self._mav.parse_buffer(data) or ():
                self._take(message)
        now_s = timebase.monotonic_s()
        if now_s < self._due_s:
            return
        self._due_s = max(self._due_s + HEARTBEAT_EVERY_S, now_s)
        self._mav.send(heartbeat(self._common))
        if "GPS_INPUT" in self._section.messages:
            self._mav.send(gps_input(self._common, None, Instant.now().utc))
        self._update_device_state()

    def send_fix(self, fix: PublishedFix, now: Instant) -> None:
        """Send a fix as each of the configured messages."""
        self._send(fix, now)
        self._state.count("mavlink fixes sent")

    def send_current_fix(self, fix: PublishedFix, now: Instant) -> None:
        """Send an earlier fix to an autopilot that has connected since; it is already counted."""
        self._send(fix, now)

    def _send(self, fix: PublishedFix, now: Instant) -> None:
        if "EXTERNAL_POSITION_ESTIMATE" in self._section.messages:
            self._command(fix, now)
            self._times = 1
        if "GPS_INPUT" in self._section.messages:
            self._mav.send(gps_input(self._common, fix, now.utc))

    def retransmit(self, fix: PublishedFix, now: Instant) -> None:
        """Send the command of the latest fix again if a present autopilot has not acknowledged it."""
        if self._awaited_s is None or now.monotonic_s < self._awaited_s or not self.autopilot_present:
            return
        if self._times == MAX_SENDS:
            self._awaited_s = None
            self._state.count("mavlink fixes unanswered")
            _log.warning("mavlink: the autopilot does not answer the fix of %s", fix.bundle)
            return
        self._command(fix, now)
        self._times += 1

    def _command(self, fix: PublishedFix, now: Instant) -> None:
        self._mav.send(external_position_estimate(self._common, fix, now, self._section.system_id))
        self._awaited_s = now.monotonic_s + ACK_TIMEOUT_S

    def _take(self, message: Any) -> None:
        if message.get_srcSystem() != self._section.system_id:
            return
        match message.get_type():
            case "HEARTBEAT" if message.autopilot != self._common.MAV_AUTOPILOT_INVALID:
                self._heard_s = timebase.monotonic_s()
            case "COMMAND_ACK" if message.command == self._common.MAV_CMD_EXTERNAL_POSITION_ESTIMATE:
                self._acknowledged(message.result)

    def _acknowledged(self, result: int) -> None:
        if self._awaited_s is None:  # a duplicate acknowledgement after a retransmission
            return
        self._awaited_s = None
        if result == self._common.MAV_RESULT_ACCEPTED:
            self._state.count("mavlink fixes accepted")
            return
        self._state.count("mavlink fixes refused")
        known = self._common.enums["MAV_RESULT"].get(result)
        _log.warning("mavlink: the autopilot did not take a fix: %s", known.name if known else result)

    def _update_device_state(self) -> None:
        where = self._section.connection
        if self.autopilot_present:
            self._state.set_device(NAME, "ok", f"{where}: autopilot heard")
        elif self._heard_s is not None or timebase.monotonic_s() - self._opened_s > HEARTBEAT_TIMEOUT_S:
            self._state.set_device(
                NAME, "failing", f"{where}: no heartbeat of system {self._section.system_id}"
            )
