"""Messages for refusals of the operating system, with what to do about each."""

import errno
import os
import socket
import sqlite3
import termios
from pathlib import Path

import pytest
import serial

from localizer.bundle import BundleError, load_bundle
from localizer.dem.lattice import DemError, load_dem
from localizer.os_errors import meant_instead, why_not_read, why_not_written
from rig.commands.bundle_inspect import loaded
from rig.config.load import load_config
from rig.daemon.control import send_request
from rig.daemon.publish.mavlink_link import why_no_link
from rig.daemon.publish.tcp_broadcast import TcpBroadcast
from rig.daemon.sockets import bound_udp, why_not_listening
from rig.daemon.spool.store import _remedy
from rig.devices.bus.serial_port import SerialPort
from rig.errors import ConfigError, DeviceError, RigError


def os_error(number: int) -> OSError:
    return OSError(number, os.strerror(number))


@pytest.mark.parametrize(
    ("number", "words"),
    [
        (
            errno.ENOSPC,
            "No space left on device; name another, or make room: the disk is full, or out of inodes",
        ),
        (errno.EDQUOT, "name another, or make room: the user's disk quota is used up"),
        (errno.EROFS, "Read-only file system; name another, or mount the file system writable"),
        (errno.EACCES, "Permission denied; name another, or change who may write there"),
        (errno.EFBIG, "takes no file so large"),
        (errno.ENOENT, "make the folder first"),
        (errno.EISDIR, "it is a folder"),
        (errno.EEXIST, "remove what is there"),
        (errno.EIO, "look at the disk (dmesg)"),
        (errno.ESTALE, "mount the network drive again"),
        (errno.EBUSY, "Device or resource busy; name another"),
    ],
)
def test_each_refusal_to_write_has_its_own_remedy(number: int, words: str) -> None:
    told = why_not_written(os_error(number), "name another")
    assert told.startswith("cannot be written: ")
    assert words in told
    assert ("room" in told) == (number in (errno.ENOSPC, errno.EDQUOT))


@pytest.mark.parametrize(
    ("number", "words"),
    [
        (errno.ENOENT, "No such file or directory; correct the name"),
        (errno.EISDIR, "Is a directory; name a file, not a folder"),
        (errno.EACCES, "Permission denied; change who may read it"),
        (errno.ENOTDIR, "a part of the path is a file"),
        (errno.EIO, "look at the disk"),
    ],
)
def test_each_refusal_to_read_has_its_own_remedy(number: int, words: str) -> None:
    assert words in why_not_read(os_error(number))


def test_a_name_with_a_slip_is_told_with_the_one_that_is_there(tmp_path: Path) -> None:
    (tmp_path / "bundles" / "20261123T043151Z-3f9a").mkdir(parents=True)
    (tmp_path / "terrain.tif").touch()
    assert meant_instead(tmp_path / "terain.tif") == f"; did you mean {tmp_path}/terrain.tif?"
    assert meant_instead(tmp_path / "bundels" / "x") == f"; did you mean {tmp_path}/bundles?"
    assert meant_instead(tmp_path / "quite" / "else") == f"; there is no {tmp_path}/quite"
    assert meant_instead(tmp_path / "zzz") == ""
    with pytest.raises(DemError, match=r"terain\.tif: no such file; did you mean .*terrain\.tif\?"):
        load_dem([tmp_path / "terain.tif"])
    with pytest.raises(BundleError, match=r"does not exist; .*; did you mean .*3f9a\?"):
        load_bundle(tmp_path / "bundles" / "20261123T043151Z-3f9b")
    (tmp_path / "bundles" / "20261123T043151Z-3f9a" / "bundle.json").touch()
    (tmp_path / "bundles.zip").touch()
    with pytest.raises(BundleError, match=r"is not a directory; .*; name .*3f9a$"):
        load_bundle(tmp_path / "bundles" / "20261123T043151Z-3f9a" / "bundle.json")
    with pytest.raises(BundleError, match=r"is not a directory; .* rig bundle import"):
        load_bundle(tmp_path / "bundles.zip")
    with pytest.raises(BundleError, match=r"is no folder, and no file either; .*; did you mean .*bundles\?"):
        list(loaded((tmp_path / "bundels",)))
    (tmp_path / "vehicle.toml").touch()
    with pytest.raises(
        ConfigError, match=r"vehicl\.toml: cannot be read: .*; did you mean .*vehicle\.toml\?"
    ):
        load_config(tmp_path / "vehicl.toml")


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (os_error(errno.EADDRINUSE), "end what listens there"),
        (os_error(errno.EACCES), "a port from 1024 on"),
        (os_error(errno.EADDRNOTAVAIL), "this computer has no such address"),
        (socket.gaierror(-2, "Name or service not known"), "the name is not known"),
    ],
)
def test_an_address_that_cannot_be_listened_on(error: OSError, words: str) -> None:
    assert words in why_not_listening(error)


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (os_error(errno.ECONNREFUSED), "nothing listens there: start the autopilot's end"),
        (TimeoutError("timed out"), "see that the autopilot is on"),
        (socket.gaierror(-2, "Name or service not known"), "the name is not known"),
        (
            DeviceError("serial port /dev/ttyACM0", "is in use", "end the other program"),
            "is in use; end the other",
        ),
    ],
)
def test_an_autopilot_that_is_not_reached(error: OSError | DeviceError, words: str) -> None:
    assert words in why_no_link(error)


def test_addresses_that_are_taken_or_elsewhere() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        with pytest.raises(RigError, match="Address already in use; end what listens there"):
            bound_udp(f"127.0.0.1:{taken.getsockname()[1]}", "[run.odometry] listen")
    with pytest.raises(ConfigError, match="this computer has no such address"):
        TcpBroadcast("192.0.2.1:10110", "[run.nmea] tcp")


def test_a_daemon_that_may_not_be_asked_is_not_taken_for_one_that_is_absent(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(RigError, match="no rig run listens there"):
        send_request(tmp_path / "control.sock", "status")

    def refuse(self: socket.socket, address: object) -> None:
        raise PermissionError(errno.EACCES, "Permission denied")

    class Refusing(socket.socket):
        connect = refuse  # type: ignore[assignment]

    monkeypatch.setattr("rig.daemon.control.socket.socket", Refusing)
    with pytest.raises(RigError, match="this user may not reach it: Permission denied; join the group"):
        send_request(tmp_path / "control.sock", "status")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("database or disk is full", "make room"),
        ("database is locked", "end the other program"),
        ("attempt to write a readonly database", "who may write"),
        ("unable to open database file", "who may read and write"),
        ("database disk image is malformed", "move it away"),
        ("disk I/O error", "dmesg"),
    ],
)
def test_an_index_that_fails_is_not_always_a_full_disk(text: str, words: str) -> None:
    assert words in _remedy(sqlite3.OperationalError(text))


@pytest.mark.parametrize(
    ("error", "words", "not_blamed"),
    [
        (serial.SerialException(errno.ENOENT, "x"), "there is no such port", "baud"),
        (serial.SerialException(errno.EACCES, "x"), "may not be opened by this user", "adapter"),
        (serial.SerialException(errno.EBUSY, "x"), "is in use", "cable"),
        (serial.SerialException(errno.EISDIR, "x"), "it is a folder", "baud"),
        (serial.SerialException(errno.ENXIO, "x"), "has gone away; plug the adapter in", "baud"),
        (serial.SerialException("Could not configure port: (25, ...)"), "cannot be opened (Could", "cable"),
        (termios.error(errno.ENOTTY, "Inappropriate ioctl"), "it is no serial port; correct `port`", "cable"),
        (ValueError("Invalid baud rate: 1234567"), "it has no such baud rate; correct `baud`", "cable"),
    ],
)
def test_a_serial_port_that_cannot_be_opened_blames_what_it_is(
    monkeypatch: pytest.MonkeyPatch, error: Exception, words: str, not_blamed: str
) -> None:
    def refuse(*_args: object, **_more: object) -> serial.Serial:
        raise error

    monkeypatch.setattr(serial, "Serial", refuse)
    with pytest.raises(DeviceError) as caught:
        SerialPort("/dev/ttyUSB0", 4800)
    assert words in str(caught.value)
    assert not_blamed not in str(caught.value).replace("plug the adapter in", "")


def test_a_serial_port_without_its_folder_is_told_with_it() -> None:
    with pytest.raises(
        DeviceError, match=r"there is no such port; plug the adapter in, .*; did you mean /dev/null\?"
    ):
        SerialPort("null", 4800)
