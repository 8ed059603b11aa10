"""What is broken in dynamixel-sdk 4.1.0, each defect shown on the SDK alone beside what ours does.

These are why the rig frames and parses by itself. Should a later SDK mend one, its half of the test fails
and says so.
"""

import os
import pty
import termios
import time
import tty
from collections.abc import Iterator

import dynamixel_sdk
import dynamixel_sdk.port_handler
import pytest
import serial
from dynamixel_sdk import COMM_PORT_BUSY, COMM_RX_TIMEOUT, COMM_SUCCESS
from fakes.servos import HARDWARE_ERROR, POSITION, FakeServo, FakeServoBus, status_packet

from rig.devices.bus.serial_port import SerialPort
from rig.devices.dynamixel.protocol2 import frame, stuff, unstuff
from rig.devices.dynamixel.servo_bus import ServoBus
from rig.errors import DeviceError, TransientError

STUFFED_WRITE = frame(1, 0x03, bytes.fromhex("66 00 FF FF FD FF FF FF"))


@pytest.fixture
def servos() -> Iterator[FakeServoBus]:
    with FakeServoBus(FakeServo(1), FakeServo(2)) as bus:
        yield bus


class Vendor:
    """The SDK as its examples use it."""

    def __init__(self, path: str) -> None:
        self.port = dynamixel_sdk.PortHandler(path)
        self.port.setBaudRate(1_000_000)
        self.packets = dynamixel_sdk.PacketHandler(2.0)

    def read_position(self, servo_id: int) -> tuple[int, int, int]:
        return self.packets.read4ByteTxRx(self.port, servo_id, POSITION)

    def sync_read_positions(self, *servo_ids: int) -> tuple[int, dynamixel_sdk.GroupSyncRead]:
        group = dynamixel_sdk.GroupSyncRead(self.port, self.packets, POSITION, 4)
        for servo_id in servo_ids:
            group.addParam(servo_id)
        return group.txRxPacket(), group


@pytest.fixture
def vendor(servos: FakeServoBus) -> Iterator[Vendor]:
    vendor = Vendor(servos.path)
    yield vendor
    vendor.port.closePort()


@pytest.fixture
def ours(servos: FakeServoBus) -> Iterator[ServoBus]:
    bus = ServoBus(SerialPort(servos.path, 1_000_000))
    yield bus
    bus.close()


def test_what_is_sent_is_stuffed():
    master, slave = pty.openpty()
    tty.setraw(slave)
    vendor = Vendor(os.ttyname(slave))
    goal = [0xFF, 0xFF, 0xFD, 0xFF, 0xFF, 0xFF]
    vendor.packets.writeTxOnly(vendor.port, 1, 102, len(goal), goal)
    sent = os.read(master, 100)
    vendor.port.closePort()
    os.close(master)
    os.close(slave)
    assert b"\xff\xff\xfd\xfd" not in sent
    assert bytes.fromhex("FF FF FD 00 01 0C 00 03 66 00 FF FF FD FD FF FF FF 09 35") == STUFFED_WRITE


def test_what_is_received_is_unstuffed():
    payload = bytes.fromhex("FF FF FD FF FD FD")
    packet = list(status_packet(1, 0, payload))
    vendors = dynamixel_sdk.Protocol2PacketHandler().removeStuffing(packet)
    length = vendors[5] + 256 * vendors[6]
    assert bytes(vendors[9 : 7 + length - 2]) != payload
    assert unstuff(stuff(payload)) == payload


def test_a_step_of_the_wall_clock_is_no_timeout(servos, vendor, monkeypatch):
    real = time.time
    steps = iter([0.0])
    monkeypatch.setattr(time, "time", lambda: real() + next(steps, 3600.0))
    servos.servos[1].silent = True
    started_s = time.monotonic()
    assert vendor.read_position(1)[1] == COMM_RX_TIMEOUT
    assert time.monotonic() - started_s < 0.034  # the SDK gave up at once: it saw an hour pass
    vendor.port.ser.exclusive = False


def test_our_deadline_does_not_see_the_wall_clock(servos, ours, monkeypatch):
    real = time.time
    steps = iter([0.0])
    monkeypatch.setattr(time, "time", lambda: real() + next(steps, 3600.0))
    assert ours.read(1, POSITION, 4) == (2048).to_bytes(4, "little")


def test_waiting_is_busy_in_the_sdk_only(servos, vendor, monkeypatch):
    reads = count_reads(monkeypatch)
    servos.servos[1].silent = True
    vendor.read_position(1)
    assert len(reads) > 200


def test_waiting_is_not_busy_here(servos, ours, monkeypatch):
    reads = count_reads(monkeypatch)
    servos.servos[1].silent = True
    with pytest.raises(TransientError):
        ours.read(1, POSITION, 4)
    assert len(reads) <= 1


def count_reads(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    reads: list[int] = []
    real = serial.Serial.read

    def read(self: serial.Serial, size: int = 1) -> bytes:
        reads.append(size)
        return real(self, size)

    monkeypatch.setattr(serial.Serial, "read", read)
    return reads


def test_the_sdk_hides_the_alert_in_a_sync_read(servos, vendor):
    servos.servos[2].registers[HARDWARE_ERROR] = 0x20
    result, group = vendor.sync_read_positions(1, 2)
    assert result == COMM_SUCCESS
    assert not [name for name in vars(group) if "error" in name]


def test_our_sync_read_shows_the_alert(servos, ours):
    servos.servos[2].registers[HARDWARE_ERROR] = 0x20
    statuses = ours.sync_read([1, 2], POSITION, 4)
    assert [statuses[i].alert for i in (1, 2)] == [False, True]


def test_in_the_sdk_one_silent_servo_hides_the_other(servos, vendor):
    servos.servos[1].silent = True
    result, group = vendor.sync_read_positions(1, 2)
    assert result == COMM_RX_TIMEOUT
    assert group.getData(2, POSITION, 4) == 0  # and looks like a position


def test_here_one_silent_servo_does_not_hide_the_other(servos, ours):
    servos.servos[1].silent = True
    statuses = ours.sync_read([1, 2], POSITION, 4)
    assert set(statuses) == {2}
    assert statuses[2].parameters == (2048).to_bytes(4, "little")


def fail_once(monkeypatch: pytest.MonkeyPatch) -> None:
    failures = [termios.error(5, "Input/output error")]
    real = serial.Serial.reset_input_buffer

    def reset_input_buffer(self: serial.Serial) -> None:
        if failures:
            raise failures.pop()
        real(self)

    monkeypatch.setattr(serial.Serial, "reset_input_buffer", reset_input_buffer)


def test_in_the_sdk_a_port_stays_busy_after_an_exception(servos, vendor, monkeypatch):
    fail_once(monkeypatch)
    with pytest.raises(termios.error):  # which is no OSError, and no SerialException
        vendor.read_position(1)
    assert vendor.read_position(1)[1] == COMM_PORT_BUSY
    assert vendor.read_position(1)[1] == COMM_PORT_BUSY


def test_here_a_port_works_again_after_an_exception(servos, ours, monkeypatch):
    fail_once(monkeypatch)
    with pytest.raises(DeviceError, match="stopped working"):
        ours.read(1, POSITION, 4)
    assert ours.read(1, POSITION, 4) == (2048).to_bytes(4, "little")


def test_signed_registers_keep_their_sign(servos, vendor):
    from rig.devices.dynamixel.control_table import control_table

    servos.servos[1].put(POSITION, 4, -5)
    assert vendor.read_position(1)[0] == 4294967291
    assert control_table("XM430-W350")["Present Position"].decode(b"\xfb\xff\xff\xff") == -5
