"""One serial port shared by several listeners in this process, as for a stream with both compass and barometer.

Each read distributes the received bytes to all listeners, so none loses what another one has read.
"""

import os
import threading
from collections.abc import Callable

from rig.devices.bus.deadline import Deadline
from rig.devices.bus.serial_port import SerialPort
from rig.errors import DeviceError

MAX_WAITING_BYTES = 65536
"""Buffer limit of a listener that does not read; the oldest bytes are discarded, as its next ``discard_input`` would
do.
"""

_TURN_S = 0.01
"""Poll interval of a listener while another one is reading."""


class _Line:
    """The open port and its listeners."""

    def __init__(self, port: SerialPort) -> None:
        self.port = port
        self.reading = threading.Lock()
        self.listeners: list[SharedPort] = []

    def receive(self, deadline: Deadline) -> None:
        """Read, waiting until the deadline for the first byte, and distribute to all. ``reading`` is held."""
        data = self.port.read(deadline)
        for listener in list(self.listeners):
            listener.take(data)

    def is_at(self, path: str) -> bool:
        """Whether the path is this port: a persistent name and ttyUSB0 may be the same."""
        return os.path.realpath(self.port.path) == os.path.realpath(path)


_lines: list[_Line] = []
_registry = threading.Lock()


class SharedPort:
    """A listener's handle with the read methods of ``SerialPort``; ``close`` ends this handle only.

    Raises ``DeviceError`` as ``SerialPort`` does, and if the port is already open at another baud rate.
    """

    def __init__(
        self, path: str, baud: int, open_port: Callable[[str, int], SerialPort] = SerialPort
    ) -> None:
        self.path = path
        self.baud = baud
        self._waiting = bytearray()
        self._lock = threading.Lock()
        with _registry:
            line = next((each for each in _lines if each.is_at(path)), None)
            if line is None:
                line = _Line(open_port(path, baud))
                _lines.append(line)
            elif line.port.baud != baud:
                raise DeviceError(
                    f"serial port {path}",
                    f"is open at {line.port.baud} baud for another device, {baud} are asked for",
                    "give both sections the same `baud`",
                )
            line.listeners.append(self)
        self._line: _Line | None = line

    def take(self, data: bytes) -> None:
        """Add received bytes; called by the reading listener."""
        with self._lock:
            self._waiting += data
            del self._waiting[:-MAX_WAITING_BYTES]

    def read(self, deadline: Deadline) -> bytes:
        """Received bytes, waiting until the deadline for the first one; empty if none came."""
        line = self._require_line()
        while True:
            last_try = deadline.expired
            if data := self._taken():
                return data
            if line.reading.acquire(timeout=_TURN_S):
                try:
                    if data := self._taken():
                        return data
                    line.receive(deadline)
                finally:
                    line.reading.release()
                if data := self._taken():
                    return data
            if last_try:
                return b""

    def discard_input(self) -> None:
        """Discard this listener's unread bytes; the others keep theirs."""
        line = self._require_line()
        if line.reading.acquire(
            timeout=_TURN_S
        ):  # otherwise another listener has just emptied the system's buffer
            try:
                line.receive(Deadline.after(0.0))
            finally:
                line.reading.release()
        self._taken()

    def close(self) -> None:
        """Close this handle; the last one closes the port. May be called twice."""
        line, self._line = self._line, None
        if line is None:
            return
        with _registry:
            line.listeners.remove(self)
            if not line.listeners:
                _lines.remove(line)
                line.port.close()

    def _taken(self) -> bytes:
        with self._lock:
            data = bytes(self._waiting)
            self._waiting.clear()
        return data

    def _require_line(self) -> _Line:
        if self._line is None:
            raise DeviceError(f"serial port {self.path}", "is closed", "open it again")
        return self._line
