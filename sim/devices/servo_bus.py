"""A half-duplex Dynamixel bus on a pseudo-terminal: servos receive instructions and answer in order."""

import threading
import time
from collections.abc import Callable, Iterable, Sequence

from sim.devices.dynamixel_packet import (
    BROADCAST_ID,
    Instruction,
    Request,
    RequestReader,
    StatusError,
    fast_status_packet,
    status_packet,
)
from sim.devices.pty_port import PtyPort
from sim.devices.servo import Servo
from sim.devices.x_series import BAUD_RATES

IDLE_LINE_S = 0.1
"""A packet interrupted for this long is dropped, as in the firmware."""

PROTOCOL_1, PROTOCOL_1_PING = 1, 1
PING_LEVEL, READ_LEVEL, WRITE_LEVEL = 0, 1, 2


class ServoBus:
    """The servos of one bus. ``reply`` maps bytes to bytes; ``serve`` connects it to a port.

    ``on_wire`` models the cable: it may change, truncate or drop the servos' answers. ``contacted`` is set once a host
    has sent something.
    """

    def __init__(self, servos: Sequence[Servo], *, on_wire: Callable[[bytes], bytes] = bytes) -> None:
        self.servos = list(servos)
        self.on_wire = on_wire
        self.contacted = threading.Event()
        self._reader = RequestReader()
        self._heard_s = time.monotonic()

    def serve(self, port: PtyPort) -> None:
        """Answer on ``port`` until it is closed. A servo set to another baud rate stays silent."""
        port.answer(lambda data: self._on_line(data, port.baud))

    def reply(self, data: bytes, baud: int | None = None) -> bytes:
        """The servos' answer to ``data``; with ``baud`` only of those set to it."""
        now = time.monotonic()
        if now - self._heard_s > IDLE_LINE_S:
            self._reader.forget()
        self._heard_s = now
        answers = b"".join(self._answer(request, baud) for request in self._reader.feed(data))
        return answers + b"".join(_protocol_1_status(servo, data) for servo in self.servos)

    def _on_line(self, data: bytes, baud: int) -> bytes:
        self.contacted.set()
        answer = self.reply(data, baud)
        if answer:
            time.sleep(max(servo.register("return_delay_time") for servo in self.servos) * 2e-6)
        return self.on_wire(answer)

    def _answer(self, request: Request, baud: int | None) -> bytes:
        there = {
            servo.register("id"): servo
            for servo in self.servos
            if servo.is_listening() and baud in (None, BAUD_RATES[servo.register("baud_rate")])
        }
        broadcast = request.servo_id == BROADCAST_ID
        addressed = (
            list(there.values()) if broadcast else [s for i, s in there.items() if i == request.servo_id]
        )
        if not request.crc_ok:
            if broadcast:
                return b""
            return b"".join(_status(servo, StatusError.CRC) for servo in addressed)
        for servo in addressed:
            servo.feed_watchdog()
        _follow(there.values(), request)
        if request.instruction in GROUP_INSTRUCTIONS:
            return GROUP_INSTRUCTIONS[request.instruction](there, request.parameters) if broadcast else b""
        return b"".join(_single(servo, request, broadcast=broadcast) for servo in addressed)


def _protocol_1_status(servo: Servo, data: bytes) -> bytes:
    """The answer of a servo set to Protocol 1.0 to a ping in that protocol; nothing else is supported."""
    if not servo.is_there() or servo.register("protocol_type") != PROTOCOL_1:
        return b""
    body = bytes([servo.register("id"), 2, PROTOCOL_1_PING])
    answer = bytes([servo.register("id"), 2, 0])
    return _protocol_1(answer) if data == _protocol_1(body) else b""


def _protocol_1(body: bytes) -> bytes:
    """A packet of Protocol 1.0: header, body and the complement of its sum."""
    return b"\xff\xff" + body + bytes([~sum(body) & 0xFF])


def _follow(servos: Iterable[Servo], request: Request) -> None:
    """Let servos with a Secondary ID execute another servo's instruction: RAM only, unanswered (manual, 2.4.8)."""
    for servo in servos:
        if not servo.has_secondary_id(request.servo_id):
            continue
        servo.feed_watchdog()
        if request.instruction == Instruction.WRITE:
            address = int.from_bytes(request.parameters[:2], "little")
            servo.write(address, request.parameters[2:], ram_only=True)
        elif request.instruction == Instruction.REBOOT:
            servo.reboot()


def _status(servo: Servo, error: int, data: bytes = b"") -> bytes:
    return status_packet(servo.register("id"), error | servo.alert(), data)


def _single(servo: Servo, request: Request, *, broadcast: bool) -> bytes:
    """Execute an instruction to one servo. A ping is always answered, others by Status Return Level."""
    answer_id, level = servo.register("id"), servo.register("status_return_level")
    needed, data = WRITE_LEVEL, b""
    parameters = request.parameters
    address = int.from_bytes(parameters[:2], "little")
    match request.instruction:
        case Instruction.PING:
            needed, error = PING_LEVEL, 0
            data = servo.read(0, 2)[1] + servo.read(6, 1)[1]
        case Instruction.READ:
            needed = READ_LEVEL
            error, data = servo.read(address, int.from_bytes(parameters[2:4], "little"))
        case Instruction.WRITE:
            error = servo.write(address, parameters[2:])
        case Instruction.REG_WRITE:
            error = servo.keep(address, parameters[2:])
        case Instruction.ACTION:
            error = servo.act()
        case Instruction.CLEAR:
            error = servo.clear(parameters)
        case Instruction.REBOOT:
            error = servo.reboot()
        case Instruction.FACTORY_RESET:
            error = servo.factory_reset(parameters[0] if parameters else 0, broadcast=broadcast)
        case _:
            error = StatusError.INSTRUCTION
    if level < needed or (broadcast and request.instruction != Instruction.PING):
        return b""
    return status_packet(answer_id, error | servo.alert(), data)


Places = list[tuple[int, int, int]]
"""(id, address, length) of each servo of a group read."""


def _sync_places(parameters: bytes) -> Places:
    address, length = int.from_bytes(parameters[:2], "little"), int.from_bytes(parameters[2:4], "little")
    return [(servo_id, address, length) for servo_id in parameters[4:]]


def _bulk_places(parameters: bytes) -> Places:
    return [
        (part[0], int.from_bytes(part[1:3], "little"), int.from_bytes(part[3:5], "little"))
        for part in (parameters[i : i + 5] for i in range(0, len(parameters) - 4, 5))
    ]


def _read_in_turn(there: dict[int, Servo], places: Places) -> list[tuple[Servo, int, bytes]]:
    """Each servo waits for the answer of the one before it: after a missing one all are silent."""
    answers: list[tuple[Servo, int, bytes]] = []
    for servo_id, address, length in places:
        servo = there.get(servo_id)
        if servo is None or servo.register("status_return_level") < READ_LEVEL:
            break
        error, data = servo.read(address, length)
        answers.append((servo, error, data))
    return answers


def _group_read(there: dict[int, Servo], places: Places) -> bytes:
    return b"".join(_status(servo, error, data) for servo, error, data in _read_in_turn(there, places))


def _fast_group_read(there: dict[int, Servo], places: Places) -> bytes:
    parts = [
        (servo.register("id"), error | servo.alert(), data or bytes(length))
        for (servo, error, data), (_, _, length) in zip(_read_in_turn(there, places), places, strict=False)
    ]
    return fast_status_packet(parts, 1 + sum(length + 4 for _, _, length in places)) if parts else b""


def _sync_write(there: dict[int, Servo], parameters: bytes) -> bytes:
    address, length = int.from_bytes(parameters[:2], "little"), int.from_bytes(parameters[2:4], "little")
    for start in range(4, len(parameters), 1 + length):
        part = parameters[start + 1 : start + 1 + length]
        if (servo := there.get(parameters[start])) and len(part) == length:
            servo.write(address, part)
    return b""


def _bulk_write(there: dict[int, Servo], parameters: bytes) -> bytes:
    while len(parameters) >= 5:
        ((servo_id, address, length),) = _bulk_places(parameters[:5])
        data, parameters = parameters[5 : 5 + length], parameters[5 + length :]
        if (servo := there.get(servo_id)) and len(data) == length:
            servo.write(address, data)
    return b""


GROUP_INSTRUCTIONS: dict[int, Callable[[dict[int, Servo], bytes], bytes]] = {
    Instruction.SYNC_READ: lambda there, parameters: _group_read(there, _sync_places(parameters)),
    Instruction.BULK_READ: lambda there, parameters: _group_read(there, _bulk_places(parameters)),
    Instruction.FAST_SYNC_READ: lambda there, parameters: _fast_group_read(there, _sync_places(parameters)),
    Instruction.FAST_BULK_READ: lambda there, parameters: _fast_group_read(there, _bulk_places(parameters)),
    Instruction.SYNC_WRITE: _sync_write,
    Instruction.BULK_WRITE: _bulk_write,
}
