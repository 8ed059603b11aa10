"""Dynamixel protocol 2.0 as the servo sees it: instruction packets in, status packets out.

Source: the manual of protocol 2.0 (header, byte stuffing, CRC-16 with polynomial 0x8005, not reflected).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum

HEADER = b"\xff\xff\xfd\x00"
STUFFED = b"\xff\xff\xfd"
BROADCAST_ID = 0xFE
MAX_LENGTH = 1024
STATUS = 0x55
ALERT = 0x80


class Instruction(IntEnum):
    """Instruction codes that an X-series servo knows."""

    PING = 0x01
    READ = 0x02
    WRITE = 0x03
    REG_WRITE = 0x04
    ACTION = 0x05
    FACTORY_RESET = 0x06
    REBOOT = 0x08
    CLEAR = 0x10
    SYNC_READ = 0x82
    SYNC_WRITE = 0x83
    FAST_SYNC_READ = 0x8A
    BULK_READ = 0x92
    BULK_WRITE = 0x93
    FAST_BULK_READ = 0x9A


class StatusError(IntEnum):
    """Error numbers of a status packet, bits 6 to 0."""

    NONE = 0
    RESULT_FAIL = 1
    INSTRUCTION = 2
    CRC = 3
    DATA_RANGE = 4
    DATA_LENGTH = 5
    DATA_LIMIT = 6
    ACCESS = 7


@dataclass(frozen=True)
class Request:
    """One instruction packet, un-stuffed. ``instruction`` is a plain number, as a servo must also answer unknown ones."""

    servo_id: int
    instruction: int
    parameters: bytes
    crc_ok: bool


def crc16(data: bytes) -> int:
    """CRC-16 of ``data`` (polynomial 0x8005, first value 0): 0xFEE8 for b"123456789"."""
    crc = 0
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = ((crc << 1) ^ 0x8005 if crc & 0x8000 else crc << 1) & 0xFFFF
    return crc


def stuff(payload: bytes) -> bytes:
    """Append FD to each FF FF FD, so that no header appears within a packet."""
    return payload.replace(STUFFED, STUFFED + b"\xfd")


def unstuff(payload: bytes) -> bytes:
    """Undo ``stuff``: after each FF FF FD of the *original* the next byte was added."""
    original = bytearray()
    added = False
    for byte in payload:
        if added:
            added = False
            continue
        original.append(byte)
        added = original.endswith(STUFFED)
    return bytes(original)


def packet(servo_id: int, payload: bytes) -> bytes:
    """Frame ``payload`` (instruction and parameters, not yet stuffed) with header, length and CRC."""
    payload = stuff(payload)
    head = HEADER + bytes([servo_id]) + (len(payload) + 2).to_bytes(2, "little") + payload
    return head + crc16(head).to_bytes(2, "little")


def status_packet(servo_id: int, error: int, parameters: bytes = b"") -> bytes:
    """The status packet of a servo. ``error`` includes the alert bit."""
    return packet(servo_id, bytes([STATUS, error]) + parameters)


def fast_status_packet(parts: list[tuple[int, int, bytes]], announced_length: int) -> bytes:
    """The combined answer to a fast read: (id, error, data) of each servo, each followed by the CRC so far.

    ``announced_length`` is the length field; parts may be missing at the end if a servo did not answer.
    """
    line = HEADER + bytes([BROADCAST_ID]) + announced_length.to_bytes(2, "little") + bytes([STATUS])
    for servo_id, error, data in parts:
        line += bytes([error, servo_id]) + data
        line += crc16(line).to_bytes(2, "little")
    return line


class RequestReader:
    """Finds instruction packets in a byte stream and skips everything else."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    def forget(self) -> None:
        """Drop an incomplete packet after the line was idle for too long."""
        self._buffer.clear()

    def feed(self, data: bytes) -> Iterator[Request]:
        """Yield the packets that ``data`` completes. Status packets, a servo's own echo, are skipped."""
        self._buffer += data
        while True:
            start = self._buffer.find(HEADER)
            if start < 0:
                del self._buffer[: -len(HEADER) + 1]
                return
            del self._buffer[:start]
            if len(self._buffer) < 7:
                return
            length = int.from_bytes(self._buffer[5:7], "little")
            if not 3 <= length <= MAX_LENGTH:
                del self._buffer[: len(HEADER)]
                continue
            end = 7 + length
            if len(self._buffer) < end:
                return
            frame = bytes(self._buffer[:end])
            del self._buffer[:end]
            payload = unstuff(frame[7:-2])
            crc_ok = crc16(frame[:-2]) == int.from_bytes(frame[-2:], "little")
            if payload[0] != STATUS:
                yield Request(frame[4], payload[0], payload[1:], crc_ok)
