"""Messages for I2C failures, with what to do; and the names of buses."""

import errno
import os
import socket
from collections.abc import Callable
from pathlib import Path

import pytest
import smbus2.smbus2
from fakes.chips import FakeI2cBus, RegisterChip

from rig import sysfs
from rig.config.i2c_names import adapter_path, checked_bus, same_bus
from rig.devices.bus.i2c import SmbusI2c, open_i2c
from rig.devices.bus.i2c_chip import I2cChip, open_chip
from rig.devices.bus.i2c_errors import held_by_driver
from rig.errors import ConfigError, DeviceError, TransientError
from sim.devices.i2c_bridge import I2cBridge


@pytest.fixture
def sys_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A /sys with two adapters, and a kernel driver that holds the chip at 0x76 of the second."""
    monkeypatch.setattr(sysfs, "SYS", tmp_path)
    devices = tmp_path / "bus/i2c/devices"
    for number, name in ((0, "SMBus I801 adapter at efa0"), (1, "bcm2835 (i2c@7e804000)")):
        (devices / f"i2c-{number}").mkdir(parents=True)
        (devices / f"i2c-{number}" / "name").write_text(name + "\n")
    (tmp_path / "bus/i2c/drivers/bmp280").mkdir(parents=True)
    (devices / "1-0076").mkdir()
    (devices / "1-0076" / "driver").symlink_to(tmp_path / "bus/i2c/drivers/bmp280")
    return tmp_path


class KernelBus(FakeI2cBus):
    """A bus that is called as the kernel's first one is."""

    def __str__(self) -> str:
        return "/dev/i2c-1"


NO_WIRES = ("wiring", "cable", "power")


@pytest.mark.parametrize(
    ("number", "words", "not_blamed"),
    [
        (errno.EREMOTEIO, "does not acknowledge", ()),
        (errno.ENXIO, "does not acknowledge", ()),
        (errno.EIO, "the bus failed", ()),
        (errno.ETIMEDOUT, "timed out", ()),
        (errno.EAGAIN, "lost the bus to another master", ("pull-up",)),
        (errno.EBADMSG, "wrong checksum", ()),
        (errno.EBUSY, "busy", ("wiring",)),
        (errno.EOPNOTSUPP, "I2C_FUNC_I2C", NO_WIRES),
        (errno.EACCES, "group", NO_WIRES),
        (errno.EPERM, "group", NO_WIRES),
        (errno.ENODEV, "adapter has gone away", ("wiring",)),
        (errno.ENOENT, "adapter has gone away", ("wiring",)),
        (errno.ESHUTDOWN, "suspended", ("wiring",)),
        (errno.EINVAL, "7-bit address", NO_WIRES),
        (errno.EPROTO, "broke the I2C protocol", ("wiring",)),
        (errno.ENOTTY, "no I2C bus", NO_WIRES),
        (errno.ENOMEM, "out of memory", NO_WIRES),
    ],
)
def test_each_errno_of_a_transfer_has_its_message(
    number: int, words: str, not_blamed: tuple[str, ...]
) -> None:
    bus = FakeI2cBus({0x1D: RegisterChip(registers=bytearray(256))})
    bus.fail_next(number)
    with pytest.raises(DeviceError) as raised:
        I2cChip(bus, 0x1D, "ADXL355").read_register(0)
    told = str(raised.value)
    assert told.startswith("ADXL355 at 0x1D on fake bus: ")
    assert words in told
    assert not [blamed for blamed in not_blamed if blamed in told], told


@pytest.mark.parametrize("number", [errno.EOPNOTSUPP, errno.EACCES, errno.EINVAL])
def test_what_another_try_cannot_mend_is_not_tried_again(number: int) -> None:
    bus = FakeI2cBus({0x1D: RegisterChip(registers=bytearray(256))})
    bus.fail_next(number)
    with pytest.raises(DeviceError) as raised:
        I2cChip(bus, 0x1D, "ADXL355").read_register(0)
    assert not isinstance(raised.value, TransientError)


def test_a_busy_chip_names_the_kernel_driver_and_how_to_unbind_it(sys_folder: Path) -> None:
    bus = KernelBus({0x76: RegisterChip(registers=bytearray(256))})
    bus.fail_next(errno.EBUSY)
    with pytest.raises(
        DeviceError,
        match=r"BMP390 at 0x76 on /dev/i2c-1: is in use by the kernel driver bmp280 \(.*EBUSY\); unbind it "
        r"\(echo 1-0076 \| sudo tee /sys/bus/i2c/drivers/bmp280/unbind\)",
    ):
        I2cChip(bus, 0x76, "BMP390").read_register(0)


def test_a_driver_is_found_whatever_the_bus_is_called(sys_folder: Path, tmp_path: Path) -> None:
    link = tmp_path / "i2c-head"
    link.symlink_to("/dev/i2c-1")
    for bus in ("/dev/i2c-1", "bcm2835 (i2c@7e804000)", "bcm2835", str(link)):
        held = held_by_driver(bus, 0x76)
        assert held
        assert held[0] == "is in use by the kernel driver bmp280"
        assert held_by_driver(bus, 0x77) is None
    assert held_by_driver("tcp://127.0.0.1:4711/1", 0x76) is None


def test_a_chip_that_a_kernel_driver_holds_is_not_touched(
    sys_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The kernel lets plain transfers through to a chip that it reads itself."""
    bus = KernelBus({0x76: RegisterChip(registers=bytearray(256))})
    monkeypatch.setattr("rig.devices.bus.i2c_chip.open_i2c", lambda _url: bus)
    touched: list[int] = []
    with pytest.raises(
        DeviceError, match="chip at 0x76 on /dev/i2c-1: is in use by the kernel driver bmp280; unbind"
    ):
        open_chip(lambda _bus, address: touched.append(address), "/dev/i2c-1", 0x76)
    assert not touched
    open_chip(lambda _bus, address: touched.append(address), "/dev/i2c-1", 0x77)
    assert touched == [0x77]


@pytest.fixture
def kernel_with(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[[int], str]:
    """A device file of an adapter with certain functions."""

    def make(functions: int) -> str:
        def ioctl(_fd: int, request: int, argument: object) -> int:
            assert request == smbus2.smbus2.I2C_FUNCS
            argument.value = functions  # type: ignore[attr-defined]
            return 0

        monkeypatch.setattr(smbus2.smbus2, "ioctl", ioctl)
        file = tmp_path / "i2c-0"
        file.touch()
        return str(file)

    return make


def test_an_smbus_only_adapter_is_reported_at_once(
    sys_folder: Path, kernel_with: Callable[[int], str]
) -> None:
    functions = int(smbus2.smbus2.I2cFunc.SMBUS_READ_BYTE_DATA | smbus2.smbus2.I2cFunc.SMBUS_READ_WORD_DATA)
    path = kernel_with(functions)
    with pytest.raises(
        DeviceError,
        match=r"its adapter \(SMBus I801 adapter at efa0\) can do only SMBus \(byte, word\): the function I2C "
        r"\(I2C_FUNC_I2C\) is missing; connect the chips to an adapter that has it \(i2cdetect -F 0\)",
    ):
        SmbusI2c(path)
    with pytest.raises(DeviceError, match="can do no transfers"):
        SmbusI2c(kernel_with(0))


@pytest.mark.parametrize(
    ("number", "words"),
    [
        (errno.ENOENT, "enable the bus .*: there is i2c-0 .SMBus I801 adapter at efa0., i2c-1"),
        (errno.EACCES, "add the user to the group of the device file, i2c: sudo usermod -aG i2c"),
        (errno.EBUSY, "end the other program"),
        (errno.ENXIO, "plug the adapter in"),
        (errno.ENOTTY, "is no I2C bus; correct `bus`"),
        (errno.EISDIR, "it is a folder"),
    ],
)
def test_a_bus_that_cannot_be_opened_says_what_to_do(
    sys_folder: Path, monkeypatch: pytest.MonkeyPatch, number: int, words: str
) -> None:
    def refuse(*_args: object) -> int:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(smbus2.smbus2.os, "open", refuse)
    with pytest.raises(DeviceError, match=rf"I2C bus /dev/i2c-7: cannot be opened .*{words}"):
        SmbusI2c("/dev/i2c-7")


def test_an_adapter_without_a_device_file_wants_the_module(sys_folder: Path) -> None:
    (sys_folder / "bus/i2c/devices/i2c-97").mkdir()
    with pytest.raises(DeviceError, match="sudo modprobe i2c-dev"):
        SmbusI2c("/dev/i2c-97")


@pytest.mark.parametrize(
    ("given", "bus"),
    [
        (1, "/dev/i2c-1"),
        ("1", "/dev/i2c-1"),
        ("i2c-1", "/dev/i2c-1"),
        ("i2c-01", "/dev/i2c-1"),
        ("/dev/i2c-1", "/dev/i2c-1"),
        ("/dev/i2c-sensors", "/dev/i2c-sensors"),
        ("/dev/i2c/by-name/head", "/dev/i2c/by-name/head"),
        ("tcp://127.0.0.1:4711/1", "tcp://127.0.0.1:4711/1"),
        ("tcp://[::1]:4711/1", "tcp://[::1]:4711/1"),
        ("bcm2835 (i2c@7e804000)", "bcm2835 (i2c@7e804000)"),
        ("i801", "i801"),
    ],
)
def test_a_bus_may_be_named_in_several_ways(given: object, bus: str) -> None:
    assert checked_bus(given) == bus


@pytest.mark.parametrize(
    "given",
    ["", "COM3", "ttyUSB0", "/dev", "/i2c-1", "udp://h:1/1", "tcp://host/1", 1.5, True, -1, None, "/srv/x y"],
)
def test_what_can_be_no_bus_is_refused(given: object) -> None:
    with pytest.raises(ValueError, match="is no I2C bus; give /dev/i2c-N or tcp://HOST:PORT/BUS"):
        checked_bus(given)


def test_an_adapter_is_found_by_its_name_or_a_part_of_it(sys_folder: Path) -> None:
    assert adapter_path("bcm2835 (i2c@7e804000)") == "/dev/i2c-1"
    assert adapter_path("i801") == "/dev/i2c-0"
    assert same_bus("i801") == same_bus("/dev/i2c-0") == "/dev/i2c-0"
    two = sys_folder / "devices/pci0000:00/i2c_designware.1/i2c-5"
    two.mkdir(parents=True)
    (two / "name").write_text("Synopsys DesignWare I2C adapter\n")
    (sys_folder / "bus/i2c/devices/i2c-5").symlink_to(two)
    assert adapter_path("i2c_designware.1") == "/dev/i2c-5"
    with pytest.raises(
        ConfigError, match=r"did you mean 'bcm2835 .i2c@7e804000.'. there is i2c-0 .SMBus I801"
    ):
        adapter_path("bcm2836 i2c@7e804000")
    with pytest.raises(
        ConfigError, match=r"3 I2C adapters are called so: i2c-0 .* i2c-1 .*; give more of the name"
    ):
        adapter_path("e")
    with pytest.raises(DeviceError, match="I2C bus /dev/i2c-0: "):
        open_i2c("i801")  # found, and not there on this computer


def test_a_link_of_udev_is_the_bus_that_it_leads_to(sys_folder: Path, tmp_path: Path) -> None:
    (tmp_path / "i2c-1").touch()
    (tmp_path / "head").symlink_to(tmp_path / "i2c-1")
    assert sysfs.i2c_number(str(tmp_path / "head")) == 1
    assert same_bus(str(tmp_path / "head")) == "/dev/i2c-1"


@pytest.mark.parametrize(
    ("number", "words"),
    [(errno.EBUSY, "is busy"), (errno.EOPNOTSUPP, "I2C_FUNC_I2C"), (errno.EAGAIN, "another master")],
)
def test_an_errno_of_a_bus_behind_a_bridge_has_the_same_message(number: int, words: str) -> None:
    bridge = I2cBridge({1: []}, fault=lambda _bus, _address: number)
    try:
        with pytest.raises(DeviceError, match=words):
            open_chip(lambda bus, address: I2cChip(bus, address, "X").read_register(0), bridge.url(1), 0x1D)
    finally:
        bridge.close()


def test_a_bridge_that_goes_away_is_not_blamed_on_the_wiring() -> None:
    bridge = I2cBridge({1: []})
    bus = open_i2c(bridge.url(1))
    bridge.close()
    chip = I2cChip(bus, 0x1D, "ADXL355")
    told = []
    for _ in range(2):
        with pytest.raises(TransientError, match=r"ADXL355 .* I2C bridge 127\.0\.0\.1:\d+: ") as raised:
            chip.read_register(0)
        told.append(str(raised.value))
    assert all("program still runs" in line or "nothing listens" in line for line in told)
    assert not any("wiring" in line for line in told)


def test_an_unknown_bridge_name_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_args: object) -> socket.socket:
        raise socket.gaierror(-2, "Name or service not known")

    monkeypatch.setattr(socket, "create_connection", refuse)
    with pytest.raises(
        DeviceError,
        match=r"I2C bridge heaad:4711: cannot be reached .the name is not known.*correct the host",
    ):
        open_i2c("tcp://heaad:4711/1")
