"""Talkers: instruments that send unprompted on a serial port. Lines, and the newest reading among them."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

from rig.clock import Instant
from rig.devices.bus.deadline import Deadline
from rig.devices.bus.shared_port import SharedPort
from rig.devices.closing import ClosedOnExit
from rig.devices.readings import HeadingReading, PressureReading
from rig.devices.sensors.agreement import one_pressure_source
from rig.devices.sensors.families import baud_advice, family_of, is_text, other_format
from rig.devices.sensors.nmea_heading import HEADING_KINDS, parse_heading
from rig.devices.sensors.nmea_pressure import PRESSURE_KINDS, parse_pressure
from rig.devices.sensors.nmea_sentence import SentenceReader
from rig.devices.sensors.sampling import read_for
from rig.devices.sensors.vaisala import SOH, parse_pa50
from rig.errors import MessageError, NoChecksumError, NoReadingError, TransientError
from rig.fault_notes import note_fault

DEFAULT_TIMEOUT_S = 3.0
SURVEY_S = 2.2
"""Most weather instruments send once a second, some every two seconds."""
COMPASS_SURVEY_S = 1.2
"""A compass sends at least once a second, and the head waits for it."""

_LONGEST_LINE = 512
_RECENT_BYTES = 256
_IDLE = b"\x00\xff \t"
"""Bytes between lines, from an open line or a sender of C strings."""

# A line ends with CR, LF or both; some instruments end it with zeros, or start the next one at once.
_LINE_END = re.compile(rb"[\r\n][\r\n\x00]*|(?<=\*[0-9A-Fa-f]{2})(?:\x00+|(?=[$!]))")

Reading = TypeVar("Reading")


class Port(Protocol):
    """The part of a serial port that is used here."""

    @property
    def path(self) -> str: ...
    @property
    def baud(self) -> int: ...
    def read(self, deadline: Deadline) -> bytes: ...
    def discard_input(self) -> None: ...
    def close(self) -> None: ...


class LineReader:
    """Lines from a port. Overlong ones are dropped: noise, or a wrong baud rate."""

    def __init__(self, port: Port) -> None:
        self._port = port
        self._buffer = bytearray()
        self._dropping = False
        self.recent = b""
        """The last bytes that arrived since ``discard``, complete lines or not."""

    def discard(self) -> None:
        """Discard received bytes: the operating system buffers kilobytes of old lines."""
        self._port.discard_input()
        self._buffer.clear()
        self._dropping = False
        self.recent = b""

    def read_line(self, deadline: Deadline) -> bytes | None:
        """The next non-empty line, without its end; None if none is complete at the deadline.

        Raises ``DeviceError`` if the port has disappeared.
        """
        last_try = False
        while True:
            while end := _LINE_END.search(self._buffer):
                line = bytes(self._buffer[: end.start()])
                del self._buffer[: end.end()]
                if line.strip(_IDLE) or self._dropping:
                    self._dropping = False
                    return line
            if last_try:
                return None
            if len(self._buffer) > _LONGEST_LINE:
                self._buffer.clear()
                self._dropping = True
            last_try = deadline.expired
            data = self._port.read(deadline)
            self._buffer += data
            self.recent = (self.recent + data)[-_RECENT_BYTES:]


@dataclass
class _NoReadingReason:
    """What was received instead of a reading; the most informative line (highest ``rank``) is reported."""

    rank: int = 0
    said: str = "nothing"
    remedy: str = "check its power, the cable and `port`, and that it talks at least so often"
    noise: bytes = b""

    def tell(self, rank: int, said: str, remedy: str) -> None:
        """Record a line, unless an earlier one has a higher rank."""
        if rank >= self.rank:
            self.rank, self.said, self.remedy = rank, said, remedy


_DAMAGED, _FOREIGN, _OTHER, _NO_CHECKSUM, _WITHOUT_VALUE = range(1, 6)


class Talker(ClosedOnExit, Generic[Reading]):
    """An instrument on a serial port, of its own or shared with another one.

    ``parse`` converts a line into a reading, or None if it is about something else, and raises ``MessageError`` for an
    unusable one. ``what`` is the expected input, for errors ("HDG, HDM ... sentence"). ``agreed`` selects the readings
    to be averaged. The first readings are collected for at least ``survey_s``, as several instruments on a line may
    alternate.
    """

    def __init__(
        self,
        port: Port,
        parse: Callable[[bytes, Instant], Reading | None],
        name: str,
        what: str,
        agreed: Callable[[str, list[Reading]], list[Reading]] = lambda name, readings: readings,
        survey_s: float = 0.0,
    ) -> None:
        self._port = port
        self._lines = LineReader(port)
        self._parse = parse
        self._name = f"{name} on {port.path}"
        self._what = what
        self._agreed = agreed
        self._survey_s = survey_s

    def read(self, timeout_s: float = DEFAULT_TIMEOUT_S) -> Reading:
        """The next complete reading; older input is discarded.

        Parameters
        ----------
        timeout_s : float
            How long to wait for it, in seconds.

        Returns
        -------
        HeadingReading or PressureReading
            What the instrument says.

        Raises
        ------
        TransientError
            None comes in time; the message says what came instead.
        """
        self._lines.discard()
        return self._next(timeout_s)

    def _next(self, timeout_s: float) -> Reading:
        deadline = Deadline.after(timeout_s)
        heard = _NoReadingReason()
        last_try = False
        while not last_try:
            last_try = deadline.expired  # noise may go on for ever
            line = self._lines.read_line(deadline)
            if line is None:
                break
            reading = self._reading_in(line, heard)
            if reading is not None:
                return reading
        if heard.rank == 0:
            self._tell_unended(heard)
        problem_text = f"no {self._what} within {timeout_s:g} s; last line: {heard.said}"
        raise TransientError(self._name, problem_text, heard.remedy)

    def _reading_in(self, line: bytes, heard: _NoReadingReason) -> Reading | None:
        set_up = f"set the instrument to send a {self._what}"
        try:
            reading = self._parse(line, Instant.now())
        except NoReadingError as problem:
            heard.tell(_WITHOUT_VALUE, str(problem), problem.remedy)
            note_fault(self._name, f"gave no value: {problem}", "waited for the next")
        except NoChecksumError as problem:
            heard.tell(
                _NO_CHECKSUM,
                str(problem),
                "switch the checksum on in the instrument, or say require_checksum = false in its section",
            )
            note_fault(self._name, "sent a line without a checksum", "waited for the next")
        except MessageError as problem:
            other = other_format(line)
            if other:
                heard.tell(_FOREIGN, other, f"{set_up}, or give the right `kind` and `port`")
            else:
                heard.noise = (heard.noise + line)[-_RECENT_BYTES:]
                heard.tell(_DAMAGED, f"damaged: {problem}", baud_advice(self._port.baud, heard.noise))
                note_fault(self._name, "sent a damaged line", "waited for the next")
        else:
            if reading is None:
                heard.tell(_OTHER, f"{line[:82]!r}", set_up)
            elif line.lstrip(_IDLE)[:1] not in (b"$", b"\\", SOH):
                note_fault(self._name, "sent other bytes before a line", "skipped")
            return reading
        return None

    def _tell_unended(self, heard: _NoReadingReason) -> None:
        """Report bytes without a line end: at a wrong baud rate there is none."""
        recent = self._lines.recent
        family = family_of(recent)
        if family:
            heard.tell(_FOREIGN, f"{family}, no lines", f"set the instrument to send a {self._what}")
        elif recent and not is_text(recent):
            damaged = f"damaged: {recent[:16].hex(' ')} and so on, which is no text"
            heard.tell(_DAMAGED, damaged, baud_advice(self._port.baud, recent))
        elif recent:
            heard.tell(_DAMAGED, f"{recent[:82]!r} without an end", "check `baud` and the cable")

    def read_many(self, duration_s: float) -> list[Reading]:
        """Read for some time.

        Parameters
        ----------
        duration_s : float
            For how long, in seconds.

        Returns
        -------
        list of HeadingReading or of PressureReading
            All readings that begin to arrive within that time, at least one.

        Raises
        ------
        TransientError
            No reading comes within 3 s.
        DeviceError
            Two sources on the line do not agree.
        """
        self._lines.discard()
        survey = Deadline.after(self._survey_s if duration_s > 0.0 else 0.0)  # one reading alone is no mean
        readings = read_for(lambda: self._next(DEFAULT_TIMEOUT_S), duration_s)
        while not survey.expired:
            try:
                readings.append(self._next(survey.remaining_s))
            except TransientError:
                break
        agreed = self._agreed(self._name, readings)
        if duration_s > 0.0:
            self._survey_s = 0.0
        return agreed

    def identify(self) -> str:
        """Name and port."""
        return f"{self._name} at {self._port.baud} baud"

    def close(self) -> None:
        """Close the port."""
        self._port.close()


def nmea_compass(
    port: str, baud: int, *, require_checksum: bool = True, sentence: str | None = None
) -> Talker[HeadingReading]:
    """Listen to a compass that sends HDG, HDM, HDT, THS, PTNTHPR, OHPR or OceanServer's $C.

    Parameters
    ----------
    port : str
        The serial port's device file, best one of /dev/serial/by-id. Several talkers may be on one port.
    baud : int
        Its baud rate, 4800 by NMEA 0183.
    require_checksum : bool
        Whether a sentence without a checksum is none.
    sentence : str, optional
        Listen to this one alone: ``"HDG"``, or ``"HCHDG"`` of one talker.

    Returns
    -------
    Talker
        With ``read``, which gives a `HeadingReading`, ``read_many``, ``identify`` and ``close``; for a ``with`` block.

    Raises
    ------
    DeviceError
        There is no such port, or it is in use.

    Examples
    --------
    >>> import rig
    >>> with rig.nmea_compass(compass_port, 4800) as compass:  # compass_port = "/dev/ttyUSB1"
    ...     reading = compass.read()
    >>> print(f"{reading.heading_deg:.1f} deg {reading.reference}, variation {reading.variation_deg:.1f} deg")
    123.4 deg magnetic, variation 13.0 deg
    """
    read_sentence = SentenceReader(HEADING_KINDS, require_checksum=require_checksum)

    def parse(line: bytes, at: Instant) -> HeadingReading | None:
        found = read_sentence(line)
        wanted = sentence is None or sentence.upper() in (found.address, found.kind)
        return parse_heading(found, at) if wanted else None

    what = "HDG, HDM, HDT, THS, PTNTHPR or OHPR sentence" if sentence is None else f"{sentence} sentence"
    return Talker(SharedPort(port, baud), parse, "NMEA compass", what, survey_s=COMPASS_SURVEY_S)


def nmea_barometer(
    port: str, baud: int, *, require_checksum: bool = True, transducer: str | None = None
) -> Talker[PressureReading]:
    """Listen to a barometer that sends XDR, MDA or MMB.

    Parameters
    ----------
    port : str
        The serial port's device file, which may be that of a compass, too.
    baud : int
        Its baud rate, 4800 by NMEA 0183.
    require_checksum : bool
        Whether a sentence without a checksum is none.
    transducer : str, optional
        Take the pressure of the XDR transducer of this name alone, or of this sentence (``"WIMDA"``).

    Returns
    -------
    Talker
        With ``read``, which gives a `PressureReading`, ``read_many``, ``identify`` and ``close``; for a ``with`` block.

    Raises
    ------
    DeviceError
        There is no such port, or it is in use.

    Examples
    --------
    >>> import rig
    >>> with rig.nmea_barometer(barometer_port, 4800) as barometer:  # barometer_port = "/dev/ttyUSB2"
    ...     reading = barometer.read()
    >>> print(f"{reading.pressure_hpa:.1f} hPa from {reading.source}")
    900.0 hPa from ...
    """
    read_sentence = SentenceReader(PRESSURE_KINDS, require_checksum=require_checksum)
    what = "XDR or MDA sentence with a pressure"
    return Talker(
        SharedPort(port, baud),
        lambda line, at: parse_pressure(read_sentence(line), at, transducer),
        "NMEA barometer",
        what if transducer is None else f"{what} of {transducer}",
        one_pressure_source,
        SURVEY_S,
    )


def vaisala_pa50(port: str, baud: int) -> Talker[PressureReading]:
    """Listen to a Vaisala barometer that sends the message PA50.

    Parameters
    ----------
    port : str
        The serial port's device file.
    baud : int
        Its baud rate.

    Returns
    -------
    Talker
        With ``read``, which gives a `PressureReading`, ``read_many``, ``identify`` and ``close``; for a ``with`` block.

    Raises
    ------
    DeviceError
        There is no such port, or it is in use.

    Examples
    --------
    >>> import rig
    >>> with rig.vaisala_pa50(vaisala_port, 4800) as barometer:  # vaisala_port = "/dev/ttyUSB2"
    ...     print(f"{barometer.read().pressure_hpa:.1f} hPa")
    900.0 hPa
    """
    return Talker(SharedPort(port, baud), parse_pa50, "Vaisala barometer", "PA50 message")
