"""A half-duplex bus of Dynamixel servos: one instruction, then its status packets."""

from collections.abc import Sequence

from rig.devices.bus.deadline import Deadline
from rig.devices.bus.serial_port import SerialPort
from rig.devices.closing import ClosedOnExit
from rig.devices.dynamixel.protocol2 import (
    BROADCAST_ID,
    Instruction,
    Status,
    StatusError,
    StatusParser,
    frame,
)
from rig.errors import DeviceError, MessageError, TransientError
from rig.fault_notes import note_fault

_BITS_PER_BYTE = 10  # start, 8 data, stop
_STATUS_OVERHEAD_BYTES = 11
_STUFFING = 4 / 3
# Two of FTDI's default 16 ms latency periods, and what a loaded computer needs to notice.
_TURNAROUND_S = 0.05

_CLEAR_MULTI_TURN = bytes([0x01, 0x44, 0x58, 0x4C, 0x22])  # e-manual, "Protocol 2.0", Clear

_REFUSALS: dict[int, str] = {
    StatusError.RESULT_FAIL: "could not carry out the instruction",
    StatusError.INSTRUCTION: "does not know the instruction",
    StatusError.CRC: "received a packet with a wrong CRC",
    StatusError.DATA_RANGE: "says that the value is out of range",
    StatusError.DATA_LENGTH: "says that the value has a wrong length",
    StatusError.DATA_LIMIT: "says that the value is beyond its limit registers",
    StatusError.ACCESS: "does not allow that register to be accessed now",
}
_LATE = "shorten the adapter's latency (rig check says how), or take a faster computer"
_OF_VALUES = (StatusError.DATA_RANGE, StatusError.DATA_LIMIT)
"""Rejections of a value: impossible for an instruction without one."""


class RefusedError(DeviceError):
    """A servo received an instruction and rejected it; ``number`` says why."""

    def __init__(self, device: str, problem: str, number: int) -> None:
        super().__init__(
            device, problem, "check the servo's firmware and its registers with Dynamixel Wizard"
        )
        self.number = number


class ServoBus(ClosedOnExit):
    """A half-duplex bus of Dynamixel servos, Protocol 2.0: instructions to servos by id.

    Every call waits a bounded time, and none of its errors leaves the bus unusable.

    Parameters
    ----------
    port : SerialPort
        Open; the bus takes it over.

    Raises
    ------
    TransientError
        Of each call: a servo does not answer.
    DeviceError
        Of each call: a servo refuses the instruction, or the port is lost.

    Examples
    --------
    >>> import rig
    >>> with rig.ServoBus(rig.SerialPort(servo_port, 1_000_000)) as bus:  # servo_port = "/dev/ttyUSB0"
    ...     bus.ping_all(0.1)  # model numbers by id: 1020 is an XM430-W350
    {1: 1020, 2: 1020}
    """

    def __init__(self, port: SerialPort) -> None:
        self._port = port
        self.path = port.path
        self.baud = port.baud

    def ping(self, servo_id: int) -> tuple[int, int]:
        """Ask one servo who it is.

        Parameters
        ----------
        servo_id : int
            0 to 252.

        Returns
        -------
        tuple of int
            Model number and firmware version.

        Raises
        ------
        TransientError
            The servo does not answer.
        DeviceError
            The servo refuses, or the port is lost.
        """
        parameters = self._exchange(servo_id, Instruction.PING, b"", 3)
        return int.from_bytes(parameters[:2], "little"), parameters[2]

    def ping_all(self, wait_s: float) -> dict[int, int]:
        """Ask all servos who they are.

        Parameters
        ----------
        wait_s : float
            How long answers are waited for: 3 ms for each id that there may be.

        Returns
        -------
        dict of int
            Model numbers by id.
        """
        self._port.discard_input()
        self._port.write(frame(BROADCAST_ID, Instruction.PING))
        deadline, parser = Deadline.after(wait_s), StatusParser()
        found: dict[int, int] = {}
        while not deadline.expired:
            for status in parser.feed(self._port.read(deadline)):
                if len(status.parameters) == 3:
                    found[status.servo_id] = int.from_bytes(status.parameters[:2], "little")
        return found

    def answers_protocol_1(self, servo_id: int) -> bool:
        """Whether a servo that is silent to Protocol 2.0 answers a ping in Protocol 1.0 (e-manual, "Protocol 1.0").

        Parameters
        ----------
        servo_id : int
            0 to 252.

        Returns
        -------
        bool
            Whether it does.
        """
        body = bytes([servo_id, 2, Instruction.PING])
        request = b"\xff\xff" + body + bytes([~sum(body) & 0xFF])
        self._port.discard_input()
        self._port.write(request)
        deadline = Deadline.after(2 * len(request) * _BITS_PER_BYTE / self.baud + _TURNAROUND_S)
        received = b""
        while not deadline.expired:
            received += self._port.read(deadline)
        # An adapter may echo what was sent, which is as long as the answer.
        return request[:4] in received.replace(request, b"")

    def read(self, servo_id: int, address: int, length: int) -> bytes:
        """Read from one servo's control table.

        Parameters
        ----------
        servo_id : int
            0 to 252.
        address : int
            Of the first register.
        length : int
            Bytes.

        Returns
        -------
        bytes
            So many.

        Raises
        ------
        TransientError
            The servo does not answer.
        DeviceError
            The servo refuses, or the port is lost.
        """
        return self._exchange(servo_id, Instruction.READ, _u16(address) + _u16(length), length)

    def write(self, servo_id: int, address: int, data: bytes) -> None:
        """Write into one servo's control table.

        Parameters
        ----------
        servo_id : int
            0 to 252.
        address : int
            Of the first register.
        data : bytes
            Low byte first.

        Raises
        ------
        TransientError
            The servo does not answer.
        DeviceError
            The servo refuses, or the port is lost.
        """
        self._exchange(servo_id, Instruction.WRITE, _u16(address) + data, 0)

    def write_unanswered(self, servo_id: int, address: int, data: bytes) -> None:
        """Write into the control table of a servo that may be set not to answer a write.

        Parameters
        ----------
        servo_id : int
            0 to 252.
        address : int
            Of the first register.
        data : bytes
            Low byte first.
        """
        self._collect(frame(servo_id, Instruction.WRITE, _u16(address) + data), [servo_id], 0)

    def reboot(self, servo_id: int) -> None:
        """Restart one servo, which ends a shutdown. It takes some tenths of a second to come back.

        Parameters
        ----------
        servo_id : int
            0 to 252.

        Raises
        ------
        TransientError
            The servo does not answer.
        DeviceError
            The servo refuses, or the port is lost.
        """
        self._exchange(servo_id, Instruction.REBOOT, b"", 0)

    def clear_multi_turn(self, servo_id: int) -> None:
        """Have one servo, at rest, count its position within one turn again (firmware 42 and later).

        Parameters
        ----------
        servo_id : int
            0 to 252.

        Raises
        ------
        TransientError
            The servo does not answer.
        DeviceError
            The servo refuses, or the port is lost.
        """
        self._exchange(servo_id, Instruction.CLEAR, _CLEAR_MULTI_TURN, 0)

    def sync_read(self, servo_ids: Sequence[int], address: int, length: int) -> dict[int, Status]:
        """Read the same block of several servos with one instruction.

        One silent servo does not hide the others.

        Parameters
        ----------
        servo_ids : sequence of int
            Whose.
        address : int
            Of the first register.
        length : int
            Bytes.

        Returns
        -------
        dict of int to Status
            By id; the alert bit of each is in its ``Status``. A servo is in it only where it answered with the whole block.
        """
        request = frame(BROADCAST_ID, Instruction.SYNC_READ, _u16(address) + _u16(length) + bytes(servo_ids))
        statuses, _ = self._collect(request, servo_ids, length)
        return {
            status.servo_id: status
            for status in statuses
            if not status.error_number and len(status.parameters) == length
        }

    def close(self) -> None:
        """Close the port."""
        self._port.close()

    def _exchange(self, servo_id: int, instruction: Instruction, parameters: bytes, length: int) -> bytes:
        device = f"servo id {servo_id} on {self.path}"
        statuses, problem = self._collect(frame(servo_id, instruction, parameters), [servo_id], length)
        if not statuses:
            what = f"no valid answer ({problem})" if problem else "no answer"
            raise TransientError(device, what, "check power, cable, `id` and `baud`")
        status = statuses[0]
        if status.error_number == StatusError.CRC:
            raise TransientError(device, _REFUSALS[StatusError.CRC], "check the cable")
        if status.error_number in _OF_VALUES and instruction in (Instruction.READ, Instruction.PING):
            raise TransientError(device, "answered an earlier instruction, late", _LATE)
        if status.error_number:
            number = status.error_number
            why = _REFUSALS.get(number, f"refuses with the unknown error {number}")
            raise RefusedError(device, f"{why} ({instruction.name} {parameters.hex(' ')})", number)
        if len(status.parameters) != length:
            problem_text = f"answered {len(status.parameters)} bytes instead of {length}"
            raise TransientError(device, problem_text, "check that no two servos have one id")
        return status.parameters

    def _collect(
        self, request: bytes, servo_ids: Sequence[int], length: int
    ) -> tuple[list[Status], MessageError | None]:
        """Send ``request``; the status packets of ``servo_ids`` that arrived in time."""
        answer_bytes = len(servo_ids) * (_STATUS_OVERHEAD_BYTES + length) * _STUFFING
        on_the_wire_s = (len(request) + answer_bytes) * _BITS_PER_BYTE / self.baud
        self._port.discard_input()
        self._port.write(request)
        deadline = Deadline.after(on_the_wire_s + _TURNAROUND_S)
        parser = StatusParser()
        found: dict[int, Status] = {}
        last_try = False
        while len(found) < len(servo_ids) and not last_try:
            last_try = deadline.expired  # bytes received while this process was not scheduled still count
            data = self._port.read(deadline)
            found |= {s.servo_id: s for s in parser.feed(data) if s.servo_id in servo_ids}
        if parser.problem and len(found) == len(servo_ids):
            note_fault(f"servo bus {self.path}", str(parser.problem), "skipped")
        return list(found.values()), parser.problem


def _u16(value: int) -> bytes:
    return value.to_bytes(2, "little")
