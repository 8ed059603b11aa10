"""Dynamixel Protocol 2.0 as pure functions: packets to bytes and back.

Written from the ROBOTIS e-manual, "Protocol 2.0". The vendor's SDK (4.1.0) does not stuff what it sends and does not
un-stuff everything that it receives, so only its control tables are used.
"""

from dataclasses import dataclass
from enum import IntEnum

from rig.errors import MessageError

BROADCAST_ID = 254

_HEADER = b"\xff\xff\xfd\x00"
_PREFIX_BYTES = len(_HEADER) + 3  # header, id, length
_CRC_BYTES = 2
_STATUS = 0x55
_MIN_LENGTH = 3  # instruction and CRC
_MAX_LENGTH = 1024  # more than any register block: a larger length is noise


class Instruction(IntEnum):
    """The instructions that the rig sends."""

    PING = 0x01
    READ = 0x02
    WRITE = 0x03
    REBOOT = 0x08
    CLEAR = 0x10
    SYNC_READ = 0x82


class StatusError(IntEnum):
    """Why a servo rejected an instruction (bits 6..0 of the error byte)."""

    RESULT_FAIL = 1
    INSTRUCTION = 2
    CRC = 3
    DATA_RANGE = 4
    DATA_LENGTH = 5
    DATA_LIMIT = 6
    ACCESS = 7


@dataclass(frozen=True)
class Status:
    """A status packet, un-stuffed and with a good CRC."""

    servo_id: int
    error_byte: int
    parameters: bytes

    @property
    def alert(self) -> bool:
        """Whether the servo's hardware error status (register 70) is not zero."""
        return bool(self.error_byte & 0x80)

    @property
    def error_number(self) -> int:
        """0, or why the instruction was rejected: a ``StatusError`` in all known firmware."""
        return self.error_byte & 0x7F


def _crc_table() -> tuple[int, ...]:
    table = []
    for byte in range(256):
        crc = byte << 8
        for _ in range(8):
            crc = (crc << 1) ^ (0x8005 if crc & 0x8000 else 0)
        table.append(crc & 0xFFFF)
    return tuple(table)


_CRC_TABLE = _crc_table()


def crc16(data: bytes | bytearray) -> int:
    """CRC-16/UMTS (polynomial 0x8005, initial value 0, not reflected)."""
    crc = 0
    for byte in data:
        crc = (crc << 8 & 0xFFFF) ^ _CRC_TABLE[crc >> 8 ^ byte]
    return crc


def stuff(body: bytes) -> bytes:
    """Instruction and parameters with FD added after each FF FF FD, so that no header appears among them."""
    return body.replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")


def unstuff(body: bytes) -> bytes:
    """The inverse of ``stuff``."""
    return body.replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")


def frame(servo_id: int, instruction: int, parameters: bytes = b"") -> bytes:
    """The instruction packet that goes on the wire. The length is that after stuffing."""
    body = stuff(bytes([instruction]) + parameters)
    packet = _HEADER + bytes([servo_id]) + (len(body) + _CRC_BYTES).to_bytes(2, "little") + body
    return packet + crc16(packet).to_bytes(_CRC_BYTES, "little")


class StatusParser:
    """Splits a byte stream into status packets and resynchronises after garbage.

    Stuffing keeps FF FF FD 00 out of every packet, so a header always starts one, and a header inside a packet proves
    that packet truncated. ``problem`` says what was dropped last, for the error message after a timeout.
    """

    def __init__(self) -> None:
        self._buffer = bytearray()
        self.problem: MessageError | None = None

    def feed(self, data: bytes) -> list[Status]:
        """The packets that ``data`` completes, in order. Instruction packets (our own echoes) are skipped."""
        self._buffer += data
        found = []
        while (packet := self._next_packet()) is not None:
            body = unstuff(packet[_PREFIX_BYTES:-_CRC_BYTES])
            if body[0] == _STATUS and len(body) >= 2:
                found.append(Status(packet[4], body[1], body[2:]))
        return found

    def _next_packet(self) -> bytes | None:
        while self._skip_to_header() and len(self._buffer) >= _PREFIX_BYTES:
            length = int.from_bytes(self._buffer[5:7], "little")
            end = _PREFIX_BYTES + length
            # The CRC is not stuffed: parameters that end in FF FF before a CRC of FD 00 are no header.
            cut_short = self._buffer.find(_HEADER, 1, end - 1) >= 0
            if not _MIN_LENGTH <= length <= _MAX_LENGTH:
                self._drop(len(_HEADER), f"a packet of the impossible length {length}")
            elif cut_short:
                self._drop(len(_HEADER), "a packet that was cut short")
            elif len(self._buffer) < end:
                return None
            elif crc16(self._buffer[: end - _CRC_BYTES]) != int.from_bytes(
                self._buffer[end - _CRC_BYTES : end], "little"
            ):
                self._drop(len(_HEADER), "a packet with a wrong CRC")
            else:
                packet = bytes(self._buffer[:end])
                del self._buffer[:end]
                return packet
        return None

    def _skip_to_header(self) -> bool:
        start = self._buffer.find(_HEADER)
        if start < 0:  # the start of a header may be at the end
            start = max(0, len(self._buffer) - len(_HEADER) + 1)
        if start:  # the rest of a dropped packet needs no report
            earlier = self.problem
            self._drop(start, "bytes that are no packet")
            self.problem = earlier or self.problem
        return self._buffer.startswith(_HEADER)

    def _drop(self, count: int, why: str) -> None:
        del self._buffer[:count]
        self.problem = MessageError(f"received {why}")
