"""systemd's notification protocol: one datagram to the service manager for each state.

The protocol is in sd_notify(3): lines ``KEY=VALUE`` to the socket in ``NOTIFY_SOCKET``; an address that begins with
``@`` is in the abstract namespace. Without the variable nothing is sent.
"""

import logging
import os
import socket
import threading
import time
from collections.abc import Mapping

from rig.errors import RigError

_log = logging.getLogger(__name__)

SEND_TIMEOUT_S = 1.0
"""A busy manager must not block the daemon for longer."""


class Notifier:
    """Sends the daemon's state to the service manager. Thread-safe.

    An undelivered state is only logged: the daemon continues, and a manager that hears nothing acts by itself.
    """

    def __init__(self, address: str | None, watchdog_s: float | None = None) -> None:
        self._address = "\0" + address[1:] if address and address.startswith("@") else address
        self._lock = threading.Lock()
        self._status = ""
        self._stopping = False
        self._delivers = True
        self.watchdog_s = watchdog_s
        """How often the manager wants to hear ``watchdog`` at least; None where it does not watch."""

    def ready(self, status: str) -> None:
        """The daemon has started or finished a reload."""
        self._status = status
        self._send("READY=1", _status_line(status))

    def status(self, text: str) -> None:
        """A status line."""
        self._status = text
        self._send(_status_line(text))

    def reloading(self) -> None:
        """A reload has begun; ``ready`` follows in any case."""
        now_us = time.clock_gettime_ns(time.CLOCK_MONOTONIC) // 1000
        self._send("RELOADING=1", f"MONOTONIC_USEC={now_us}", _status_line("reading the configuration again"))

    def stopping(self, status: str) -> None:
        """The daemon ends; nothing is sent afterwards. The manager's stop timeout starts now."""
        self._send("STOPPING=1", _status_line(status), last=True)

    def progress(self) -> None:
        """All heartbeats are on time: reset the watchdog."""
        self._send("WATCHDOG=1")

    def set_fault(self, text: str) -> None:
        """Show this instead of the status until ``clear_fault``."""
        self._send(_status_line(text))

    def clear_fault(self) -> None:
        """Show the status again."""
        self._send(_status_line(self._status))

    def _send(self, *lines: str, last: bool = False) -> None:
        if not self._address:
            return
        with self._lock, socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as out:
            if self._stopping:
                return
            self._stopping = last
            out.settimeout(SEND_TIMEOUT_S)
            try:
                out.connect(self._address)
                out.sendall("\n".join(lines).encode())
            except OSError as error:
                if self._delivers:
                    _log.warning("the service manager cannot be told %s: %s", lines[0], error)
                self._delivers = False
            else:
                self._delivers = True


def notifier_of(environment: Mapping[str, str]) -> Notifier:
    """The notifier for the manager that started this process, from its environment variables.

    Raises ``RigError`` if they are invalid.
    """
    address = environment.get("NOTIFY_SOCKET") or None
    if address and address[0] not in "/@":
        raise RigError(
            f"NOTIFY_SOCKET: {address!r} is no address of a socket; give a path from / or an @name"
        )
    return Notifier(address, _watchdog_s(environment))


def _watchdog_s(environment: Mapping[str, str]) -> float | None:
    """The watchdog's timeout by sd_watchdog_enabled(3); one meant for another process does not count."""
    interval, process = environment.get("WATCHDOG_USEC"), environment.get("WATCHDOG_PID")
    if not interval or (process and process != str(os.getpid())):
        return None
    if not interval.isascii() or not interval.isdigit() or int(interval) == 0:
        raise RigError(f"WATCHDOG_USEC: {interval!r} is no time; give microseconds")
    return int(interval) / 1e6


def _status_line(text: str) -> str:
    """A line feed would end the status and begin another key."""
    return "STATUS=" + " ".join(text.split())
