"""Dynamixel X servos on a pty, seen from the wire: registers, refusals, faults on demand.

The CRC is the vendor's own, so that nothing of the codec under test serves to check it.
"""

import os
import pty
import select
import struct
import tempfile
import threading
import time
import tty
from dataclasses import dataclass, field
from pathlib import Path

from dynamixel_sdk.protocol2_packet_handler import Protocol2PacketHandler

from rig import timebase

HEADER = b"\xff\xff\xfd\x00"
TORQUE, HARDWARE_ERROR, WATCHDOG, GOAL, MOVING, POSITION = 64, 70, 98, 116, 122, 132
RESULT_OK, DATA_RANGE, DATA_LIMIT, ACCESS = 0, 4, 6, 7


def crc(data: bytes) -> bytes:
    return struct.pack("<H", Protocol2PacketHandler().updateCRC(0, list(data), len(data)))


def status_packet(servo_id: int, error: int, parameters: bytes) -> bytes:
    body = bytearray()
    for byte in bytes([0x55, error]) + parameters:
        body.append(byte)
        if body[-3:] == b"\xff\xff\xfd":
            body.append(0xFD)
    head = HEADER + bytes([servo_id]) + struct.pack("<H", len(body) + 2) + bytes(body)
    return head + crc(head)


@dataclass
class FakeServo:
    """One servo: 147 registers and a shaft that turns at ``speed_tick_s`` while its torque is on.

    The shaft turns by the rig's clock; the bus watchdog guards this computer's threads and runs on the computer's.
    """

    servo_id: int
    model_number: int = 1020
    firmware: int = 45
    speed_tick_s: float = 20_000.0
    silent: bool = False
    false_alert: bool = False
    stuck: bool = False
    creeps: bool = False
    registers: bytearray = field(default_factory=lambda: bytearray(147))

    def __post_init__(self) -> None:
        self.put(0, 2, self.model_number)
        self.put(6, 1, self.firmware)
        self.put(7, 1, self.servo_id)
        initial = [(9, 1, 250), (11, 1, 3), (48, 4, 4095), (144, 2, 121), (146, 1, 31)]
        for address, length, value in [*initial, (GOAL, 4, 2048), (POSITION, 4, 2048)]:
            self.put(address, length, value)
        self.last_s = timebase.monotonic_s()
        self.heard_s = time.monotonic()

    def get(self, address: int, length: int) -> int:
        return int.from_bytes(self.registers[address : address + length], "little", signed=length == 4)

    def put(self, address: int, length: int, value: int) -> None:
        self.registers[address : address + length] = value.to_bytes(length, "little", signed=value < 0)

    def step(self) -> None:
        heard_s, self.heard_s = self.heard_s, time.monotonic()
        watchdog = self.registers[WATCHDOG]
        if self.registers[TORQUE] and 0 < watchdog <= 127 and self.heard_s - heard_s > watchdog * 0.020:
            self.trip_watchdog()
        now_s = timebase.monotonic_s()
        way = self.get(GOAL, 4) - self.get(POSITION, 4)
        reach = int(self.speed_tick_s * (now_s - self.last_s))
        if reach == 0 and way:
            return
        self.last_s = now_s
        if self.registers[TORQUE] and not self.stuck and self.registers[WATCHDOG] != 0xFF:
            self.put(POSITION, 4, self.get(POSITION, 4) + max(-reach, min(reach, way)))
        going = self.creeps or (way != 0 and abs(way) > reach and not self.stuck)
        self.registers[MOVING] = int(
            going and bool(self.registers[TORQUE]) and self.registers[WATCHDOG] != 0xFF
        )

    def trip_watchdog(self) -> None:
        self.registers[WATCHDOG] = 0xFF
        self.put(108, 4, 0)
        self.put(112, 4, 0)

    def write(self, address: int, data: bytes) -> int:
        if address < 64 and self.registers[TORQUE]:
            return ACCESS
        if address == GOAL and self.registers[WATCHDOG] == 0xFF:
            return DATA_RANGE
        value = int.from_bytes(data, "little", signed=True)
        if address == GOAL and not self.get(52, 4) <= value <= self.get(48, 4):
            return DATA_LIMIT
        self.registers[address : address + len(data)] = data
        if address == 11:  # a change of mode means no profile: full speed
            self.put(108, 4, 0)
            self.put(112, 4, 0)
        return RESULT_OK


class FakeServoBus:
    """Servos behind the pty ``path``. ``requests`` is all it received, ``writes`` the write instructions."""

    def __init__(self, *servos: FakeServo) -> None:
        self.servos = {servo.servo_id: servo for servo in servos}
        self.requests: list[bytes] = []
        self.writes: list[tuple[int, int, bytes]] = []
        self.noise_before = b""
        self.corrupt_next = 0
        self.drop_next = 0
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        # A name of its own: the terminal's may be another test's as soon as the bus is unplugged.
        self._folder = tempfile.TemporaryDirectory(prefix="servos-")
        self.path = str(Path(self._folder.name, "port"))
        Path(self.path).symlink_to(os.ttyname(self._slave))
        self._stop_read, self._stop_write = os.pipe()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def __enter__(self) -> "FakeServoBus":
        return self

    def __exit__(self, *_: object) -> None:
        self.unplug()
        os.close(self._stop_read)
        os.close(self._stop_write)
        self._folder.cleanup()

    def unplug(self) -> None:
        """An unplugged USB port: every call fails."""
        if self._thread.is_alive():
            os.write(self._stop_write, b"x")
            self._thread.join()
            Path(self.path).unlink()
            os.close(self._slave)
            os.close(self._master)

    def written(self, address: int) -> list[tuple[int, int]]:
        """(id, value) of every write to a register."""
        return [
            (i, int.from_bytes(data, "little", signed=True)) for i, a, data in self.writes if a == address
        ]

    def _serve(self) -> None:
        buffer = b""
        while True:
            ready, _, _ = select.select([self._master, self._stop_read], [], [])
            if self._stop_read in ready:
                return
            buffer += os.read(self._master, 4096)
            while len(buffer) >= 7 and len(buffer) >= (end := 7 + int.from_bytes(buffer[5:7], "little")):
                self._answer(buffer[:end])
                buffer = buffer[end:]

    def _answer(self, packet: bytes) -> None:
        self.requests.append(packet)
        if crc(packet[:-2]) != packet[-2:]:
            return
        body = packet[7:-2].replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")
        instruction, parameters = body[0], body[1:]
        for servo in self.servos.values():
            servo.step()
        asked = parameters[4:] if instruction == 0x82 else packet[4:5]
        for servo_id in asked:
            servo = self.servos.get(servo_id)
            if servo is not None and not servo.silent:
                self._send(self._status(servo, instruction, parameters))

    def _status(self, servo: FakeServo, instruction: int, parameters: bytes) -> bytes:
        alert = 0x80 if servo.registers[HARDWARE_ERROR] or servo.false_alert else 0
        if instruction == 0x01:
            return status_packet(servo.servo_id, alert, bytes(servo.registers[0:2] + servo.registers[6:7]))
        if instruction in (0x02, 0x82):
            address, length = struct.unpack("<HH", parameters[:4])
            return status_packet(servo.servo_id, alert, bytes(servo.registers[address : address + length]))
        if instruction == 0x03:
            address = int.from_bytes(parameters[:2], "little")
            self.writes.append((servo.servo_id, address, parameters[2:]))
            return status_packet(servo.servo_id, alert | servo.write(address, parameters[2:]), b"")
        return status_packet(servo.servo_id, alert, b"")

    def _send(self, packet: bytes) -> None:
        if self.drop_next:
            self.drop_next -= 1
            return
        if self.corrupt_next:
            self.corrupt_next -= 1
            packet = packet[:-1] + bytes([packet[-1] ^ 0x55])
        os.write(self._master, self.noise_before + packet)
