"""A serial port with time limits and a single error for a lost port.

For an unplugged cable pyserial raises ``SerialException``, ``OSError`` or ``termios.error`` (which is no ``OSError``),
depending on the call. Here all become ``LostPortError`` with the port's name. The port is then closed and reopened by
the next call: a replugged adapter is another device under the same persistent name.
"""

import contextlib
import errno
import logging
import select
import termios
from collections.abc import Iterator
from pathlib import Path

import serial

from rig import sysfs, timebase
from rig.devices.bus import monitor
from rig.devices.bus.deadline import Deadline
from rig.devices.closing import ClosedOnExit
from rig.errors import DeviceError, LostPortError
from rig.fault_notes import note_fault

_log = logging.getLogger(__name__)

_READ_BYTES = 4096
_WRITE_TIMEOUT_S = 1.0
MAX_LATENCY_MS = 4
_FAILURES = (OSError, termios.error, ValueError)  # SerialException is an OSError

_REMEDIES = {
    errno.ENOENT: (
        "there is no such port",
        "plug the adapter in, or correct `port` (/dev/serial/by-id is stable)",
    ),
    errno.EACCES: ("may not be opened by this user", "add the user to the group of the port, often dialout"),
    errno.EBUSY: ("is in use", "end the other program that has it open"),
    errno.EAGAIN: ("is in use", "end the other program that has it open"),
    errno.ENOTTY: ("cannot be opened: it is no serial port", "correct `port` (/dev/serial/by-id is stable)"),
    errno.EISDIR: ("cannot be opened: it is a folder", "name the port in it, with `port`"),
    errno.ENOTDIR: ("there is no such port", "correct `port` (/dev/serial/by-id is stable)"),
    errno.ENXIO: ("has gone away", "plug the adapter in again"),
    errno.ENODEV: ("has gone away", "plug the adapter in again"),
    errno.ELOOP: ("is a link that leads to itself", "correct `port`"),
}
_PORTS = ("serial/by-id/*", "ttyUSB*", "ttyACM*")
_PORTS_SHOWN = 4
_BAUD = ("cannot be opened: it has no such baud rate", "correct `baud`, or take another adapter")


class SerialPort(ClosedOnExit):
    """A raw serial port, 8 data bits, no parity, 1 stop bit, opened for this process alone.

    Parameters
    ----------
    path : str
        A device file, best one of /dev/serial/by-id: an adapter that is plugged in again gets another ttyUSB number.
    baud : int
        Bits a second.

    Raises
    ------
    DeviceError
        It cannot be opened: absent, in use, not permitted, no serial port at all.
    LostPortError
        Of every method but ``close``: the port has gone away and is not back.

    Examples
    --------
    >>> import rig
    >>> with rig.SerialPort(servo_port, 1_000_000) as port:  # servo_port = "/dev/ttyUSB0"
    ...     port.write(bytes.fromhex("ff ff fd 00 01 03 00 01 19 4e"))  # Protocol 2.0: ping servo 1
    ...     answer = port.read(rig.Deadline.after(1.0))
    >>> answer[:4].hex(" ")
    'ff ff fd 00'
    """

    def __init__(self, path: str, baud: int) -> None:
        self.path = path
        self.baud = baud
        with _errors(DeviceError, path, "cannot be opened", "check `port` and `baud`"):
            self._serial: serial.Serial | None = self._open()

    def _open(self) -> serial.Serial:
        port = serial.Serial(
            self.path,
            self.baud,
            timeout=0,
            write_timeout=_WRITE_TIMEOUT_S,
            exclusive=True,
            bytesize=serial.EIGHTBITS,
        )
        # FTDI adapters buffer bytes for 16 ms by default. A pty has no such setting and needs none.
        try:
            port.set_low_latency_mode(True)
        except (ValueError, OSError) as error:
            _log.debug("%s has no low-latency mode: %s", self.path, error)
        latency_ms = sysfs.serial_latency_ms(self.path)
        if latency_ms is not None and latency_ms > MAX_LATENCY_MS:
            note_fault(
                f"serial port {self.path}",
                f"its adapter holds bytes back for {latency_ms} ms, and keeps doing so",
                f"went on, slower; as root: echo 1 > {sysfs.serial_latency_file(self.path)}, or a udev rule for it",
            )
        return port

    def read(self, deadline: Deadline) -> bytes:
        """Take what has arrived.

        Parameters
        ----------
        deadline : Deadline
            Until when a first byte is waited for.

        Returns
        -------
        bytes
            What has arrived; empty if nothing came.

        Raises
        ------
        LostPortError
            The port has gone away and is not back.
        """
        with self._working() as port:
            readable, _, _ = select.select([port.fileno()], [], [], timebase.computer_s(deadline.remaining_s))
            data: bytes = port.read(_READ_BYTES) if readable else b""
        if data:
            monitor.serial_bytes(self.path, "received", data)
        return data

    def write(self, data: bytes) -> None:
        """Send bytes.

        Parameters
        ----------
        data : bytes
            All of it is sent.

        Raises
        ------
        LostPortError
            The port has gone away, or does not take it within a second.
        """
        with self._working() as port:
            monitor.serial_bytes(self.path, "sent", data)
            port.write(data)

    def discard_input(self) -> None:
        """Discard received bytes."""
        with self._working() as port:
            port.reset_input_buffer()

    def close(self) -> None:
        """Close the port. May be called twice, and after the port has disappeared."""
        port, self._serial = self._serial, None
        if port is not None:
            with contextlib.suppress(*_FAILURES):
                port.close()

    @contextlib.contextmanager
    def _working(self) -> Iterator[serial.Serial]:
        try:
            with _errors(LostPortError, self.path, "stopped working", "check the cable and the adapter"):
                if self._serial is None:
                    self._serial = self._open()
                yield self._serial
        except LostPortError:
            self.close()
            raise


@contextlib.contextmanager
def _errors(kind: type[DeviceError], path: str, problem: str, remedy: str) -> Iterator[None]:
    try:
        yield
    except _FAILURES as error:
        problem, remedy = _REMEDIES.get(_errno(error), (f"{problem} ({_reason(error)})", remedy))
        if _errno(error) == errno.ENOENT:
            remedy += _ports_there(path)
        if isinstance(error, ValueError) and "aud rate" in str(error):
            problem, remedy = _BAUD
        elif isinstance(error, serial.SerialTimeoutException):
            problem, remedy = (
                "takes nothing that is sent",
                "see that no flow control holds it; plug the adapter in again",
            )
        elif "multiple access" in str(error):
            remedy = "check the cable and the adapter, and that no other program reads the port"
        raise kind(f"serial port {path}", problem, remedy) from error


def _ports_there(path: str) -> str:
    """The serial ports of this computer, for a remedy; the intended one if only /dev is missing."""
    if not path.startswith("/") and Path("/dev", path).exists():
        return f"; did you mean /dev/{path}?"
    there = [str(each) for pattern in _PORTS for each in sorted(Path("/dev").glob(pattern))]
    shown = ", ".join(there[:_PORTS_SHOWN]) + (
        f" and {len(there) - _PORTS_SHOWN} more" if len(there) > _PORTS_SHOWN else ""
    )
    return f"; there is {shown}" if there else ""


def _errno(error: Exception) -> int:
    number = error.args[0] if error.args else None
    return number if isinstance(number, int) else 0


def _reason(error: Exception) -> str:
    return str(error.args[-1]) if error.args else type(error).__name__
