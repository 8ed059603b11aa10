"""A serial port that never blocks for ever and fails in one way.

pyserial raises ``SerialException``, ``OSError`` and ``termios.error`` (which is no ``OSError``) for the same
unplugged cable, depending on the call; here all of them are one ``DeviceError`` that names the port.
"""

import contextlib
import errno
import logging
import select
import termios
from collections.abc import Iterator

import serial

from rig.bus.deadline import Deadline
from rig.errors import DeviceError

_log = logging.getLogger(__name__)

_READ_BYTES = 4096
_WRITE_TIMEOUT_S = 1.0

_REMEDIES = {
    errno.ENOENT: (
        "there is no such port",
        "plug the adapter in, or correct `port` (/dev/serial/by-id is stable)",
    ),
    errno.EACCES: ("may not be opened by this user", "add the user to the group of the port, often dialout"),
    errno.EBUSY: ("is in use", "end the other program that has it open"),
    errno.EAGAIN: ("is in use", "end the other program that has it open"),
}


class SerialPort:
    """A raw 8N1 serial port, opened for this process alone.

    Raises ``DeviceError`` where it cannot be opened (absent, in use, not permitted, no serial port at all).
    ``path`` is a device file, best one of /dev/serial/by-id: a re-plugged adapter gets another ttyUSB number.
    """

    def __init__(self, path: str, baud: int) -> None:
        self.path = path
        self.baud = baud
        with _device_errors(path, "cannot be opened", "check `port` and `baud`"):
            self._serial = serial.Serial(
                path,
                baud,
                timeout=0,
                write_timeout=_WRITE_TIMEOUT_S,
                exclusive=True,
                bytesize=serial.EIGHTBITS,
            )
        self._prefer_low_latency()

    def _prefer_low_latency(self) -> None:
        # FTDI adapters hold bytes back for 16 ms unless asked not to. A pty has no such setting and needs
        # none.
        try:
            self._serial.set_low_latency_mode(True)
        except (ValueError, OSError) as error:
            _log.debug("%s has no low-latency mode: %s", self.path, error)

    def read(self, deadline: Deadline) -> bytes:
        """What has arrived, waiting until the deadline for a first byte; empty if none came.

        Raises ``DeviceError`` where the port has gone away.
        """
        with self._lost_port():
            readable, _, _ = select.select([self._serial.fileno()], [], [], deadline.remaining_s)
            return self._serial.read(_READ_BYTES) if readable else b""

    def write(self, data: bytes) -> None:
        """Send all of ``data``. Raises ``DeviceError`` where the port has gone away or does not take it."""
        with self._lost_port():
            self._serial.write(data)

    def discard_input(self) -> None:
        """Throw away what has arrived and was not read. Raises ``DeviceError`` where the port has gone
        away.
        """
        with self._lost_port():
            self._serial.reset_input_buffer()

    def close(self) -> None:
        """Give the port back. Closing twice is no error."""
        with self._lost_port():
            self._serial.close()

    def _lost_port(self) -> contextlib.AbstractContextManager[None]:
        return _device_errors(self.path, "stopped working", "check the cable and the adapter")


@contextlib.contextmanager
def _device_errors(path: str, problem: str, remedy: str) -> Iterator[None]:
    try:
        yield
    except (OSError, termios.error, ValueError) as error:  # SerialException is an OSError
        problem, remedy = _REMEDIES.get(_errno(error), (f"{problem} ({_reason(error)})", remedy))
        raise DeviceError(f"serial port {path}", problem, remedy) from error


def _errno(error: Exception) -> int:
    number = error.args[0] if error.args else None
    return number if isinstance(number, int) else 0


def _reason(error: Exception) -> str:
    return str(error.args[-1]) if error.args else type(error).__name__
