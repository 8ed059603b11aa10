"""Instruments that talk by themselves on a serial port: lines, and the newest reading among them."""

from collections.abc import Callable
from typing import Generic, TypeVar

from rig.bus.deadline import Deadline
from rig.bus.serial_port import SerialPort
from rig.errors import MessageError, TransientError
from rig.fault_notes import note_fault
from rig.readings import HeadingReading, Instant, PressureReading
from rig.sensors.nmea import parse_heading, parse_pressure, parse_sentence
from rig.sensors.sampling import read_for
from rig.sensors.vaisala import SOH, parse_pa50

DEFAULT_TIMEOUT_S = 3.0

_LONGEST_LINE = 512

Reading = TypeVar("Reading")


class LineReader:
    """Lines from a port. One longer than any instrument sends is dropped: noise, or a wrong baud rate."""

    def __init__(self, port: SerialPort) -> None:
        self._port = port
        self._buffer = bytearray()

    def discard(self) -> None:
        """Forget what has arrived: the operating system keeps kilobytes of old lines for a slow reader."""
        self._port.discard_input()
        self._buffer.clear()

    def read_line(self, deadline: Deadline) -> bytes | None:
        """The next line, without its end; None where none is complete at the deadline.

        Raises ``DeviceError`` where the port has gone away.
        """
        last_try = False
        while b"\n" not in self._buffer:
            if last_try:
                return None
            if len(self._buffer) > _LONGEST_LINE:
                self._buffer.clear()
            last_try = deadline.expired
            self._buffer += self._port.read(deadline)
        line, _, self._buffer = self._buffer.partition(b"\n")
        return bytes(line).rstrip(b"\r")


class Talker(Generic[Reading]):
    """An instrument on a serial port of its own.

    ``parse`` makes a reading of a line, or None of a line that is about something else, and raises
    ``MessageError`` for a damaged one. ``what`` is what is expected, for errors ("HDG, HDM ... sentence").
    """

    def __init__(
        self, port: SerialPort, parse: Callable[[bytes, Instant], Reading | None], name: str, what: str
    ) -> None:
        self._port = port
        self._lines = LineReader(port)
        self._parse = parse
        self._name = f"{name} on {port.path}"
        self._what = what

    def read(self, timeout_s: float = DEFAULT_TIMEOUT_S) -> Reading:
        """The next reading to arrive whole: what came before the call is old, and thrown away.

        Raises ``TransientError`` where none comes in time, saying what came instead.
        """
        self._lines.discard()
        return self._next(timeout_s)

    def _next(self, timeout_s: float) -> Reading:
        deadline = Deadline.after(timeout_s)
        seen = "nothing"
        remedy = "check its power, the cable and `port`"
        last_try = False
        while not last_try:
            last_try = deadline.expired  # noise may go on for ever
            line = self._lines.read_line(deadline)
            if line is None:
                break
            try:
                reading = self._parse(line, Instant.now())
            except MessageError as problem:
                seen, remedy = f"damaged: {problem}", "check `baud` and the cable"
                note_fault(self._name, "sent a damaged line", "waited for the next")
                continue
            if reading is not None:
                if line[:1] not in (b"$", SOH):
                    note_fault(self._name, "sent other bytes before a line", "skipped")
                return reading
            seen, remedy = f"{line[:82]!r}", f"set the instrument to send a {self._what}"
        problem_text = f"no {self._what} within {timeout_s:g} s; last line: {seen}"
        raise TransientError(self._name, problem_text, remedy)

    def read_many(self, duration_s: float) -> list[Reading]:
        """All readings that begin to arrive within ``duration_s``, at least one."""
        self._lines.discard()
        return read_for(lambda: self._next(DEFAULT_TIMEOUT_S), duration_s)

    def identify(self) -> str:
        """What it is and where."""
        return f"{self._name} at {self._port.baud} baud"

    def close(self) -> None:
        """Close the port."""
        self._port.close()


def nmea_compass(port: str, baud: int) -> Talker[HeadingReading]:
    """A compass that sends HDG, HDM, HDT, THS, PTNTHPR or OHPR. Raises ``DeviceError`` without a port."""
    return Talker(
        SerialPort(port, baud),
        lambda line, at: parse_heading(parse_sentence(line), at),
        "NMEA compass",
        "HDG, HDM, HDT, THS, PTNTHPR or OHPR sentence",
    )


def nmea_barometer(port: str, baud: int) -> Talker[PressureReading]:
    """A barometer that sends XDR or MDA. Raises ``DeviceError`` without a port."""
    return Talker(
        SerialPort(port, baud),
        lambda line, at: parse_pressure(parse_sentence(line), at),
        "NMEA barometer",
        "XDR or MDA sentence with a pressure",
    )


def vaisala_pa50(port: str, baud: int) -> Talker[PressureReading]:
    """A Vaisala barometer that sends PA50. Raises ``DeviceError`` without a port."""
    return Talker(SerialPort(port, baud), parse_pa50, "Vaisala barometer", "PA50 message")
