"""I2C buses: the kernel's (/dev/i2c-N), and network bridges (tcp://HOST:PORT/BUS).

A bus transfers messages and knows no chips. It fails as the kernel does, with an ``OSError`` whose errno gives the
cause: 121 no acknowledge, 110 timeout, 5 lines stuck.
"""

import errno
import fcntl
import grp
import os
import socket
import struct
import threading
import time
from pathlib import Path
from typing import Protocol

import smbus2

from rig import sysfs
from rig.config.i2c_names import BRIDGE_URL, adapter_path, buses_there
from rig.devices.bus import monitor
from rig.devices.bus.deadline import Deadline
from rig.devices.bus.i2c_errors import BridgeLostError, lacks_plain_i2c
from rig.devices.closing import ClosedOnExit
from rig.errors import DeviceError

LOCK_WAIT_S, _LOCK_POLL_S = 3.0, 0.05
"""A device file is locked by one program. The daemon's probes take a second or two, so a lock is waited for."""
_BRIDGE_TIMEOUT_S = 2.0
_BRIDGE_REQUEST = struct.Struct(">BBHH")  # bus, address, write length, read length
_BRIDGE_ANSWER = struct.Struct(">HH")  # errno (0 = done), length of the data that follow


class I2cBus(Protocol):
    """What the chip drivers need of a bus: anything with these two methods may carry a chip.

    Examples
    --------
    A bus that has one chip, whose register 0x00 holds 0xAD and all others 0:

    >>> import rig
    >>> class OneChip:
    ...     def transfer(self, address: int, write: bytes, read_length: int) -> bytes:
    ...         return bytes([0xAD if write == bytes([0x00]) else 0] * read_length)
    ...     def close(self) -> None:
    ...         pass
    >>> rig.Adxl355(OneChip(), 0x1D)
    Traceback (most recent call last):
        ...
    rig.errors.WrongDeviceError: ADXL355 at 0x1D on ...: identity register 0x01 holds 0x00 instead of 0x1D; ...
    """

    def transfer(self, address: int, write: bytes, read_length: int) -> bytes:
        """Write, then read after a repeated start, in one transaction; either part may be empty.

        Parameters
        ----------
        address : int
            Of the chip, 7 bits.
        write : bytes
            What is written first.
        read_length : int
            How many bytes are read then.

        Returns
        -------
        bytes
            So many bytes.

        Raises
        ------
        OSError
            With the kernel's errno: 121 no acknowledge, 110 timed out, 5 the lines are stuck.
        """
        ...

    def close(self) -> None:
        """Close the bus. May be called twice."""
        ...


class SmbusI2c:
    """A bus of the Linux kernel. Raises ``DeviceError`` if the device file cannot be opened.

    It is locked against other programs of the rig by flock (others ignore that lock): two programs using one chip would
    overwrite each other's settings and take each other's samples.
    """

    def __init__(self, path: str) -> None:
        self._path = path
        try:
            self._bus = smbus2.SMBus(path)
        except OSError as error:
            problem, remedy = _why_not_opened(error, path)
            raise DeviceError(f"I2C bus {path}", problem, remedy) from error
        can = lacks_plain_i2c(int(self._bus.funcs))
        if can:
            self._bus.close()
            number = sysfs.i2c_number(path)
            raise DeviceError(
                f"I2C bus {path}",
                f"its adapter ({sysfs.i2c_adapters().get(number or 0) or 'unnamed'}) can do {can}: the function I2C "
                "(I2C_FUNC_I2C) is missing",
                f"connect the chips to an adapter that has it (i2cdetect -F {'N' if number is None else number})",
            )
        assert self._bus.fd is not None
        try:
            _lock(self._bus.fd, path)
        except BaseException:
            self._bus.close()
            raise

    def __str__(self) -> str:
        return self._path

    def transfer(self, address: int, write: bytes, read_length: int) -> bytes:
        # i2c_rdwr, as SMBus calls are limited to 32 bytes and need a register.
        messages = []
        reading = smbus2.i2c_msg.read(address, read_length)
        if write or not read_length:
            messages.append(smbus2.i2c_msg.write(address, write))
        if read_length:
            messages.append(reading)
        self._bus.i2c_rdwr(*messages)
        return bytes(reading)

    def close(self) -> None:
        self._bus.close()


def _why_not_opened(error: OSError, path: str) -> tuple[str, str]:
    """Problem and remedy of a bus that cannot be opened."""
    reason = f"cannot be opened ({error.strerror or error})"
    number = sysfs.i2c_number(path)
    match error.errno:
        case errno.ENOENT if number in sysfs.i2c_adapters():
            return reason, "load the kernel module of the device files: sudo modprobe i2c-dev"
        case errno.ENOENT:
            return (
                reason,
                f"enable the bus (on a Raspberry Pi: dtparam=i2c_arm=on) or correct `bus`: {buses_there()}",
            )
        case errno.EACCES | errno.EPERM:
            group = _group(path)
            return (
                reason,
                f"add the user to the group of the device file, {group}: sudo usermod -aG {group} USER, and log in again",
            )
        case errno.EBUSY:
            return reason, "end the other program that has it open"
        case errno.ENXIO | errno.ENODEV:
            return reason, f"plug the adapter in, or correct `bus`: {buses_there()}"
        case errno.ENOTTY | errno.EINVAL:
            return f"{reason}: the file is no I2C bus", f"correct `bus`: {buses_there()}"
        case errno.EISDIR:
            return f"{reason}: it is a folder", f"correct `bus`: {buses_there()}"
    return reason, "correct `bus`"


def _group(path: str) -> str:
    try:
        return grp.getgrgid(Path(path).stat().st_gid).gr_name
    except (OSError, KeyError):
        return "i2c"


def _lock(descriptor: int, path: str) -> None:
    """Lock until the descriptor is closed."""
    waited = Deadline.after(LOCK_WAIT_S)
    while True:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return
        except BlockingIOError:
            if waited.expired:
                raise DeviceError(
                    f"I2C bus {path}",
                    "is in use by another program of the rig",
                    "end it (rig watch, rig run, a calibration), or wait until it is done",
                ) from None
            time.sleep(_LOCK_POLL_S)


class BridgeI2c:
    """A bus behind a TCP bridge: request = bus u8, address u8, write length u16, read length u16, bytes to
    write; answer = errno u16, length u16, data. Big-endian; one connection carries many requests in order.

    Raises ``DeviceError`` if the bridge cannot be reached. A later failure is an ``OSError`` of the transfer, and the
    next transfer reconnects: half an answer may still be in transit.
    """

    def __init__(self, host: str, port: int, bus: int) -> None:
        self._host, self._port, self._bus = host, port, bus
        self._socket: socket.socket | None = None
        try:
            self._connection()
        except OSError as error:
            why, remedy = _why_not_reached(error)
            raise DeviceError(f"I2C bridge {host}:{port}", f"cannot be reached ({why})", remedy) from error

    def __str__(self) -> str:
        return f"tcp://{self._host}:{self._port}/{self._bus}"

    def transfer(self, address: int, write: bytes, read_length: int) -> bytes:
        request = _BRIDGE_REQUEST.pack(self._bus, address, len(write), read_length) + write
        try:
            connection = self._connection()
            connection.sendall(request)
            status, length = _BRIDGE_ANSWER.unpack(_receive(connection, _BRIDGE_ANSWER.size))
            data = _receive(connection, length)
        except OSError as error:
            self.close()
            bridge = f"{self._host}:{self._port}"
            if isinstance(error, TimeoutError):
                problem = f"the I2C bridge does not answer within {_BRIDGE_TIMEOUT_S:g} s"
                remedy = "see that its program still runs, and the network on the way"
                raise BridgeLostError(errno.ETIMEDOUT, problem, bridge, remedy) from error
            why, remedy = _why_not_reached(error)
            raise BridgeLostError(error.errno or errno.ECONNRESET, why, bridge, remedy) from error
        if status:
            raise OSError(status, os.strerror(status))
        if len(data) != read_length:
            self.close()
            raise OSError(errno.EIO, f"the I2C bridge sent {len(data)} bytes, not {read_length}")
        return data

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _connection(self) -> socket.socket:
        if self._socket is None:
            self._socket = socket.create_connection((self._host, self._port), _BRIDGE_TIMEOUT_S)
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return self._socket


def _why_not_reached(error: OSError) -> tuple[str, str]:
    """Why there is no connection to a bridge, and what to do."""
    why = error.strerror or str(error)
    if isinstance(error, socket.gaierror):
        return f"the name is not known: {why}", "correct the host in `bus`, or give its address"
    if isinstance(error, TimeoutError):
        return (
            f"no answer within {_BRIDGE_TIMEOUT_S:g} s",
            "see that its computer is on, and the network on the way",
        )
    match error.errno:
        case errno.ECONNREFUSED:
            return f"{why}: nothing listens on that port", "start it or correct `bus`"
        case errno.EHOSTUNREACH | errno.ENETUNREACH | errno.ENETDOWN:
            return why, "see the network on the way, and correct `bus`"
        case errno.ECONNRESET | errno.EPIPE | errno.ECONNABORTED:
            return why, "see that its program still runs; start it again"
    return why, "start it or correct `bus`"


def _receive(connection: socket.socket, length: int) -> bytes:
    data, deadline = bytearray(), Deadline.after(_BRIDGE_TIMEOUT_S)  # for all of it, not for each part
    while len(data) < length:
        connection.settimeout(max(0.001, deadline.remaining_s))
        part = connection.recv(length - len(data))
        if not part:
            raise OSError(errno.ECONNRESET, "the I2C bridge closed the connection")
        data += part
    return bytes(data)


class _Shared:
    """One open bus, the lock that serialises its transfers, and its number of users."""

    def __init__(self, key: str, bus: I2cBus) -> None:
        self.key = key
        self.bus = bus
        self.lock = threading.Lock()
        self.users = 0


_open_buses: dict[str, _Shared] = {}
_open_buses_lock = threading.Lock()


class SharedI2c(ClosedOnExit):
    """One chip's hold on a bus that several chips share; the bus closes with the last hold."""

    def __init__(self, url: str, shared: _Shared) -> None:
        self._url = url
        self._shared: _Shared | None = shared

    def __str__(self) -> str:
        return self._url

    def transfer(self, address: int, write: bytes, read_length: int) -> bytes:
        if self._shared is None:
            raise OSError(errno.EBADF, "the bus is closed")
        with self._shared.lock:
            try:
                data = self._shared.bus.transfer(address, write, read_length)
            except OSError as error:
                monitor.i2c_transfer(self._url, address, write, read_length, error.errno or errno.EIO)
                raise
            monitor.i2c_transfer(self._url, address, write, read_length, data)
            return data

    def close(self) -> None:
        shared, self._shared = self._shared, None
        if shared is None:
            return
        with _open_buses_lock:
            shared.users -= 1
            if shared.users == 0:
                _open_buses.pop(shared.key, None)
                with shared.lock:
                    shared.bus.close()


def open_i2c(url: str) -> SharedI2c:
    """Open an I2C bus, or share it where it is open already.

    Each chip that is closed by itself needs its own call: a driver's ``close`` gives its bus back.

    Parameters
    ----------
    url : str
        A device file (``"/dev/i2c-1"``), a bridge (``"tcp://127.0.0.1:4711/1"``), or the name of an adapter.

    Returns
    -------
    SharedI2c
        An `I2cBus`, to be closed, or used in a ``with`` block. Transfers of several threads do not mix.

    Raises
    ------
    ConfigError
        The name is none of these.
    DeviceError
        The bus cannot be opened, or another program of the rig uses it.

    Examples
    --------
    >>> import rig
    >>> with rig.open_i2c(i2c_bus) as bus:  # i2c_bus = "/dev/i2c-1"
    ...     reading = rig.Adxl355(bus, 0x1D).read()
    >>> print(f"{reading.z_g:.2f} g upwards")
    1.00 g upwards

    Without a driver: the identity of the ADXL355, registers 0x00 to 0x02.

    >>> with rig.open_i2c(i2c_bus) as bus:
    ...     bus.transfer(0x1D, write=bytes([0x00]), read_length=3).hex()
    'ad1ded'
    """
    path = url if url.startswith("/") or BRIDGE_URL.fullmatch(url) else adapter_path(url)
    key = os.path.realpath(path) if path.startswith("/") else path  # udev may give a bus several names
    with _open_buses_lock:
        shared = _open_buses.get(key)
        if shared is None:
            shared = _open_buses[key] = _Shared(key, _open(path))
        shared.users += 1
        return SharedI2c(url, shared)


def _open(path: str) -> I2cBus:
    if path.startswith("/"):
        return SmbusI2c(path)
    bridge = BRIDGE_URL.fullmatch(path)
    assert bridge is not None
    return BridgeI2c(bridge["host"].strip("[]"), int(bridge["port"]), int(bridge["bus"]))
