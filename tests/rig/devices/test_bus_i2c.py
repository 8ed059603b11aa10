"""I2C buses: the kernel's at the ioctl boundary, the bridge's over a socket, sharing, and clear errors."""

import contextlib
import ctypes
import errno
import os
import socket
import struct
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import smbus2.smbus2
from fakes.chips import FakeI2cBus, RegisterChip

from rig.devices.bus.i2c import BridgeI2c, I2cBus, SmbusI2c, open_i2c
from rig.devices.bus.i2c_chip import I2cChip, open_chip
from rig.errors import ConfigError, DeviceError, TransientError, WrongDeviceError


class Kernel:
    """Answers the ioctls of /dev/i2c-1 for one chip at 0x76, as the kernel does."""

    def __init__(self) -> None:
        self.chip = RegisterChip(registers=bytearray(range(256)))
        self.failure: int | None = None
        self.calls = 0

    def ioctl(self, _fd: int, request: int, argument: ctypes.Structure) -> int:
        if request == smbus2.smbus2.I2C_FUNCS:
            argument.value = int(smbus2.smbus2.I2cFunc.I2C)
            return 0
        assert request == smbus2.smbus2.I2C_RDWR
        self.calls += 1
        if self.failure:
            raise OSError(self.failure, os.strerror(self.failure))
        messages = argument.msgs[: argument.nmsgs]
        if any(message.addr != 0x76 for message in messages):
            raise OSError(errno.EREMOTEIO, os.strerror(errno.EREMOTEIO))
        written = b""
        for message in messages:
            if message.flags & smbus2.smbus2.I2C_M_RD:
                data = self.chip.transfer(written or b"\0", message.len)
                ctypes.memmove(message.buf, data, message.len)
            else:
                written = ctypes.string_at(message.buf, message.len)
                if len(messages) == 1 and written:
                    self.chip.transfer(written, 0)
        return 0


@pytest.fixture
def kernel(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Kernel:
    kernel = Kernel()
    monkeypatch.setattr(smbus2.smbus2, "ioctl", kernel.ioctl)
    opened, file = os.open, tmp_path / "i2c-1"
    file.touch()
    monkeypatch.setattr(smbus2.smbus2.os, "open", lambda path, flags: opened(file, flags))
    return kernel


def test_a_kernel_bus_reads_after_a_repeated_start(kernel):
    assert SmbusI2c("/dev/i2c-1").transfer(0x76, b"\x10", 4) == bytes([0x10, 0x11, 0x12, 0x13])
    assert kernel.calls == 1


def test_a_kernel_bus_reads_more_than_the_32_bytes_of_smbus(kernel):
    assert SmbusI2c("/dev/i2c-1").transfer(0x76, b"\x00", 100) == bytes(range(100))


def test_a_kernel_bus_writes(kernel):
    assert SmbusI2c("/dev/i2c-1").transfer(0x76, b"\x20\x01\x02", 0) == b""
    assert kernel.chip.writes == [(0x20, 1), (0x21, 2)]


def test_a_kernel_bus_reads_without_writing_and_probes_with_neither(kernel):
    bus = SmbusI2c("/dev/i2c-1")
    assert bus.transfer(0x76, b"", 2) == b"\x00\x01"
    assert bus.transfer(0x76, b"", 0) == b""


@pytest.mark.parametrize(
    ("address", "failure", "expected"), [(0x10, None, 121), (0x76, 110, 110), (0x76, 5, 5)]
)
def test_a_kernel_bus_fails_with_the_kernels_errno(kernel, address, failure, expected):
    kernel.failure = failure
    with pytest.raises(OSError) as raised:  # noqa: PT011 its errno is checked
        SmbusI2c("/dev/i2c-1").transfer(address, b"\x00", 1)
    assert raised.value.errno == expected


def test_a_kernel_bus_is_one_programs_at_a_time(kernel, monkeypatch):
    monkeypatch.setattr("rig.devices.bus.i2c.LOCK_WAIT_S", 0.1)
    first = SmbusI2c("/dev/i2c-1")
    with pytest.raises(
        DeviceError, match=r"I2C bus /dev/i2c-1: is in use by another program of the rig; end"
    ):
        SmbusI2c("/dev/i2c-1")
    first.close()
    again = SmbusI2c("/dev/i2c-1")
    assert again.transfer(0x76, b"\x10", 1) == b"\x10"
    again.close()


def test_a_kernel_bus_that_another_program_gives_back_soon_is_waited_for(kernel):
    first = SmbusI2c("/dev/i2c-1")
    threading.Timer(0.2, first.close).start()
    second = SmbusI2c("/dev/i2c-1")
    assert second.transfer(0x76, b"\x10", 1) == b"\x10"
    second.close()


def test_a_kernel_bus_that_is_not_there_is_one_clear_line():
    with pytest.raises(DeviceError, match=r"I2C bus /dev/i2c-99: cannot be opened .*; enable the bus"):
        SmbusI2c("/dev/i2c-99")


def test_a_file_that_is_no_bus_is_one_clear_line(tmp_path: Path):
    (tmp_path / "i2c-1").touch()
    with pytest.raises(DeviceError, match=r"i2c-1: cannot be opened .*; correct `bus`"):
        SmbusI2c(str(tmp_path / "i2c-1"))


class Bridge:
    """A bridge with one RegisterChip at 0x76 of bus 1. ``answer`` replaces what it sends, once."""

    def __init__(self) -> None:
        self.chip = RegisterChip(registers=bytearray(range(256)))
        self.answer: bytes | None = None
        self.requests: list[bytes] = []
        self.connections = 0
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port = self._server.getsockname()[1]
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        while True:
            connection, _ = self._server.accept()
            self.connections += 1
            with connection:
                while header := connection.recv(6, socket.MSG_WAITALL):
                    bus, address, to_write, to_read = struct.unpack(">BBHH", header)
                    if bus == 0:
                        return
                    written = connection.recv(to_write, socket.MSG_WAITALL) if to_write else b""
                    self.requests.append(header + written)
                    if self.answer is not None:
                        answer, self.answer = self.answer, None
                        connection.sendall(answer)
                        break
                    if (bus, address) == (1, 0x76):
                        data = self.chip.transfer(written, to_read)
                        connection.sendall(struct.pack(">HH", 0, len(data)) + data)
                    else:
                        connection.sendall(struct.pack(">HH", errno.EREMOTEIO, 0))

    def close(self) -> None:
        with socket.create_connection(("127.0.0.1", self.port)) as last:
            last.sendall(b"\0" * 6)
        self._thread.join()
        self._server.close()


@pytest.fixture
def bridge() -> Iterator[Bridge]:
    bridge = Bridge()
    yield bridge
    bridge.close()


@pytest.fixture
def bridged(bridge: Bridge) -> Iterator[I2cBus]:
    bus = open_i2c(f"tcp://127.0.0.1:{bridge.port}/1")
    yield bus
    bus.close()


def test_a_bridge_carries_many_transfers_over_one_connection(bridge, bridged):
    assert bridged.transfer(0x76, b"\x10", 3) == b"\x10\x11\x12"
    assert bridged.transfer(0x76, b"\x10\xaa", 0) == b""
    assert bridged.transfer(0x76, b"\x10", 1) == b"\xaa"
    assert bridge.requests == [
        bytes.fromhex("01 76 0001 0003 10"),
        bytes.fromhex("01 76 0002 0000 10 AA"),
        bytes.fromhex("01 76 0001 0001 10"),
    ]
    assert bridge.connections == 1


def test_a_bridge_passes_the_errno_on(bridged):
    with pytest.raises(OSError, match="Remote I/O error") as raised:
        bridged.transfer(0x10, b"\x00", 1)
    assert raised.value.errno == errno.EREMOTEIO
    assert bridged.transfer(0x76, b"\x01", 1) == b"\x01"


def test_after_half_an_answer_the_next_transfer_starts_afresh(bridge, bridged):
    bridge.answer = b"\x00\x00\x00"
    with pytest.raises(OSError, match="closed the connection"):
        bridged.transfer(0x76, b"\x00", 1)
    assert bridged.transfer(0x76, b"\x01", 1) == b"\x01"
    assert bridge.connections == 2


def test_a_silent_bridge_is_a_timeout(monkeypatch):
    monkeypatch.setattr("rig.devices.bus.i2c._BRIDGE_TIMEOUT_S", 0.05)
    with socket.create_server(("127.0.0.1", 0)) as server:
        bus = BridgeI2c("127.0.0.1", server.getsockname()[1], 1)
        with pytest.raises(OSError, match="does not answer") as raised:
            bus.transfer(0x76, b"\x00", 1)
        assert raised.value.errno == errno.ETIMEDOUT
        bus.close()


def test_a_bridge_that_is_not_there_is_one_clear_line():
    with pytest.raises(DeviceError, match=r"I2C bridge 127\.0\.0\.1:1: cannot be reached .*; start it"):
        BridgeI2c("127.0.0.1", 1, 1)


@pytest.mark.parametrize("url", ["i2c-1", "tcp://host/1", "tcp://host:port/1", "udp://host:1/1", ""])
def test_what_names_no_bus_is_a_configuration_error(url):
    with pytest.raises(ConfigError, match="expected a device file"):
        open_i2c(url)


def test_chips_share_a_bus_until_the_last_lets_go(kernel):
    first, second = open_i2c("/dev/i2c-1"), open_i2c("/dev/i2c-1")
    first.close()
    first.close()
    assert second.transfer(0x76, b"\x05", 1) == b"\x05"
    with pytest.raises(OSError, match="the bus is closed"):
        first.transfer(0x76, b"\x05", 1)
    second.close()
    third = open_i2c("/dev/i2c-1")
    assert third.transfer(0x76, b"\x05", 1) == b"\x05"
    third.close()


def test_transfers_of_several_threads_do_not_mix(bridge):
    url = f"tcp://127.0.0.1:{bridge.port}/1"
    wrong: list[bytes] = []

    def read(register: int) -> None:
        bus = open_i2c(url)
        for _ in range(50):
            data = bus.transfer(0x76, bytes([register]), 1)
            if data != bytes([register]):
                wrong.append(data)
        bus.close()

    keep_open = open_i2c(url)
    threads = [threading.Thread(target=read, args=(register,)) for register in (3, 7)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    keep_open.close()
    assert wrong == []
    assert bridge.connections == 1


@pytest.fixture
def bus() -> FakeI2cBus:
    return FakeI2cBus({0x1D: RegisterChip(registers=bytearray(range(256)))})


@pytest.mark.parametrize(
    ("fault", "problem"),
    [
        (errno.EREMOTEIO, "does not acknowledge"),
        (errno.ETIMEDOUT, "timed out"),
        (errno.EIO, "the bus failed"),
        (errno.ECONNRESET, "the bus failed"),
        ("short", "gave 3 of 4 bytes"),
    ],
)
def test_every_failure_of_a_bus_names_the_chip(bus, fault, problem):
    chip = I2cChip(bus, 0x1D, "ADXL355")
    bus.fail_next(fault)
    with pytest.raises(TransientError, match=f"^ADXL355 at 0x1D on fake bus: {problem}"):
        chip.read_register(0, 4)
    assert chip.read_register(0, 4) == b"\0\1\2\3"


def test_another_identity_is_reported_with_both_values(bus):
    chip = I2cChip(bus, 0x1D, "ADXL355")
    with pytest.raises(WrongDeviceError, match=r"register 0x02 holds 0x02 instead of 0xED \(maybe a clock\)"):
        chip.require_identity(0x02, 0xED, "maybe a clock")


def test_a_driver_that_refuses_its_chip_gives_the_bus_back(kernel):
    seen: list[I2cBus] = []

    def refuse(bus: I2cBus, address: int) -> None:
        seen.append(bus)
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        open_chip(refuse, "/dev/i2c-1", 0x76)
    with pytest.raises(OSError, match="the bus is closed"):
        seen[0].transfer(0x76, b"\0", 1)


def test_a_driver_gets_bus_and_address(kernel):
    driver: Callable[[I2cBus, int], tuple[str, int]] = lambda bus, address: (str(bus), address)  # noqa: E731
    assert open_chip(driver, "/dev/i2c-1", 0x76) == ("/dev/i2c-1", 0x76)


@pytest.mark.parametrize(("length", "number"), [(3, errno.EIO), (60_000, errno.ETIMEDOUT)])
def test_a_bridge_that_answers_another_length_fails_the_transfer(
    monkeypatch: pytest.MonkeyPatch, length: int, number: int
) -> None:
    """Too little would be a traceback in a driver; 60,000 bytes, one now and then, have one deadline for all of them."""
    monkeypatch.setattr("rig.devices.bus.i2c._BRIDGE_TIMEOUT_S", 0.3)
    ended = threading.Event()
    with socket.create_server(("127.0.0.1", 0)) as server:

        def answer() -> None:
            connection, _ = server.accept()
            with connection:
                connection.recv(100)
                connection.sendall(struct.pack(">HH", 0, length) + b"abc")
                while not ended.wait(0.05):
                    with contextlib.suppress(OSError):
                        connection.sendall(b"x")

        thread = threading.Thread(target=answer)
        thread.start()
        bus = BridgeI2c("127.0.0.1", server.getsockname()[1], 1)
        with pytest.raises(OSError) as failure:  # noqa: PT011
            bus.transfer(0x76, b"\x00", 2)
        assert failure.value.errno == number
        ended.set()
        thread.join()
        bus.close()
