"""One serial port for several listeners of this process: a stream that carries compass and barometer alike is common.

Whoever reads gets what arrives for all of them; nobody loses what another one has taken from the system's buffer.
"""

import os
import threading
from collections.abc import Callable

from rig.devices.bus.deadline import Deadline
from rig.devices.bus.serial_port import SerialPort
from rig.errors import DeviceError

MAX_WAITING_BYTES = 65536
"""Of a listener that does not read for long: what is older is thrown away, as its next ``discard_input`` would do."""

_TURN_S = 0.01
"""So often a listener looks whether another one, who is reading, has got something for it."""


class _Line:
    """The open port and its listeners."""

    def __init__(self, port: SerialPort) -> None:
        self.port = port
        self.reading = threading.Lock()
        self.listeners: list[SharedPort] = []

    def receive(self, deadline: Deadline) -> None:
        """Read what has arrived, waiting until the deadline for a first byte, and hand it to all. ``reading`` is held."""
        data = self.port.read(deadline)
        for listener in list(self.listeners):
            listener.take(data)

    def is_at(self, path: str) -> bool:
        """Whether the path leads to this port: a lasting name and ttyUSB0 may be the same."""
        return os.path.realpath(self.port.path) == os.path.realpath(path)


_lines: list[_Line] = []
_registry = threading.Lock()


class SharedPort:
    """A listener's end of a port, with the methods of ``SerialPort`` that only read; ``close`` gives up its own part.

    Raises ``DeviceError`` as ``SerialPort`` does, and where the port is open at another baud rate already.
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
        """Bytes that have arrived; called by whoever reads."""
        with self._lock:
            self._waiting += data
            del self._waiting[:-MAX_WAITING_BYTES]

    def read(self, deadline: Deadline) -> bytes:
        """What has arrived, waiting until the deadline for a first byte; empty if none came."""
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
        """Forget what has arrived and was not read; the other listeners keep it."""
        line = self._require_line()
        if line.reading.acquire(timeout=_TURN_S):  # else another one has just emptied the system's buffer
            try:
                line.receive(Deadline.after(0.0))
            finally:
                line.reading.release()
        self._taken()

    def close(self) -> None:
        """Listen no more; the last one closes the port. Twice is no error."""
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
