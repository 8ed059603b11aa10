"""What the service manager is told: systemd's notification protocol, one datagram for each state.

The protocol is in sd_notify(3): lines ``KEY=VALUE`` to the socket that ``NOTIFY_SOCKET`` names, an address that begins with
``@`` being in the abstract namespace. Without the variable nobody listens and nothing is sent.
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
"""A manager that is too busy to take a datagram must not hold the daemon up for longer."""


class Notifier:
    """Tells the service manager how the daemon is; to be used from any thread.

    A state that cannot be delivered is told in the log and otherwise left at that: the daemon's work is worth more, and
    a manager that hears nothing acts by itself.
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
        """The daemon has started, or has done with re-reading its configuration."""
        self._status = status
        self._send("READY=1", _status_line(status))

    def status(self, text: str) -> None:
        """How the daemon is, in one line for people."""
        self._status = text
        self._send(_status_line(text))

    def reloading(self) -> None:
        """The configuration is being read again; ``ready`` follows in any case."""
        now_us = time.clock_gettime_ns(time.CLOCK_MONOTONIC) // 1000
        self._send("RELOADING=1", f"MONOTONIC_USEC={now_us}", _status_line("reading the configuration again"))

    def stopping(self, status: str) -> None:
        """The daemon ends; nothing is sent after that. From here on the manager's time limit for stopping counts."""
        self._send("STOPPING=1", _status_line(status), last=True)

    def progress(self) -> None:
        """Every part of the daemon gets on with its work."""
        self._send("WATCHDOG=1")

    def trouble(self, text: str) -> None:
        """Show this instead of the status until ``trouble_over``."""
        self._send(_status_line(text))

    def trouble_over(self) -> None:
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
    """The notifier for the manager that started this process, by the variables it set.

    Raises ``RigError`` where they make no sense.
    """
    address = environment.get("NOTIFY_SOCKET") or None
    if address and address[0] not in "/@":
        raise RigError(
            f"NOTIFY_SOCKET: {address!r} is no address of a socket; give a path from / or an @name"
        )
    return Notifier(address, _watchdog_s(environment))


def _watchdog_s(environment: Mapping[str, str]) -> float | None:
    """sd_watchdog_enabled(3): a watchdog that is meant for another process is none."""
    interval, process = environment.get("WATCHDOG_USEC"), environment.get("WATCHDOG_PID")
    if not interval or (process and process != str(os.getpid())):
        return None
    if not interval.isascii() or not interval.isdigit() or int(interval) == 0:
        raise RigError(f"WATCHDOG_USEC: {interval!r} is no time; give microseconds")
    return int(interval) / 1e6


def _status_line(text: str) -> str:
    """A line feed would end the status and begin another key."""
    return "STATUS=" + " ".join(text.split())
