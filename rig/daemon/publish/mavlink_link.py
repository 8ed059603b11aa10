"""Links to an autopilot. pymavlink's own hide their errors.

``udpout:HOST:PORT`` sends to an address, ``udpin:HOST:PORT`` answers the last sender, ``tcp:HOST:PORT`` connects, and a
name that begins with a slash is a serial port.
"""

import errno
import socket
from collections.abc import Iterator
from contextlib import closing, contextmanager
from typing import Protocol

from rig.config.run import host_and_port
from rig.devices.bus.deadline import Deadline
from rig.devices.bus.serial_port import SerialPort
from rig.errors import ConfigError, DeviceError

CONNECT_TIMEOUT_S = 5.0
MAX_BYTES = 65_536


class Link(Protocol):
    """A link to an autopilot. Both methods raise ``OSError`` or ``DeviceError`` if it is broken; neither blocks."""

    def write(self, data: bytes) -> None:
        """Send."""
        ...

    def read(self) -> bytes:
        """Received bytes, b"" if none."""
        ...


@contextmanager
def opened(connection: str, baud: int) -> Iterator[Link]:
    """A link while the context lasts. Raises ``OSError`` or ``DeviceError`` if it cannot be opened."""
    if connection.startswith("/"):
        with closing(SerialPort(connection, baud)) as port:
            yield _SerialLink(port)
        return
    kind, _, address = connection.partition(":")
    host, port_number = host_and_port(address)
    way = socket.SOCK_STREAM if kind == "tcp" else socket.SOCK_DGRAM
    family, _, _, _, found = socket.getaddrinfo(host, port_number, type=way)[0]
    with socket.socket(family, way) as sock:
        if kind == "udpin":
            sock.bind(found)
        else:
            sock.settimeout(CONNECT_TIMEOUT_S)
            sock.connect(found)
        sock.setblocking(False)
        yield _Answering(sock) if kind == "udpin" else _Connected(sock, is_stream=kind == "tcp")


def why_no_link(error: OSError | DeviceError) -> str:
    """Why the link failed, and what to do."""
    if isinstance(error, DeviceError):
        return str(error)
    remedy = {
        errno.ECONNREFUSED: "nothing listens there: start the autopilot's end, or correct [run.mavlink] connection",
        errno.EADDRINUSE: "end what listens there, or give another port in [run.mavlink] connection",
        errno.ENETUNREACH: "see the network on the way",
        errno.EHOSTUNREACH: "see the network on the way",
    }.get(error.errno or 0, "correct [run.mavlink] connection, or see the network on the way")
    if isinstance(error, TimeoutError):
        remedy = "see that the autopilot is on, and the network on the way"
    elif isinstance(error, socket.gaierror):
        remedy = "the name is not known: correct [run.mavlink] connection"
    return f"{error.strerror or error}; {remedy}"


KINDS = ("udpout", "udpin", "tcp")


def check(connection: str) -> None:
    """Raises ``ConfigError`` for an unknown kind of connection."""
    kind, _, address = connection.partition(":")
    host, _, port = address.rpartition(":")
    if connection.startswith("/") or (kind in KINDS and host and port.isdecimal() and int(port) < 65536):
        return
    known = ", ".join(f"{name}:HOST:PORT" for name in KINDS)
    raise ConfigError(
        f"[run.mavlink] connection: {connection!r} is none of {known} or /dev/...; give one of these"
    )


class _SerialLink:
    def __init__(self, port: SerialPort) -> None:
        self._port = port

    def write(self, data: bytes) -> None:
        self._port.write(data)

    def read(self) -> bytes:
        return self._port.read(Deadline(0.0))


class _Connected:
    """A connected socket: an undeliverable datagram is an error of the next one."""

    def __init__(self, sock: socket.socket, is_stream: bool) -> None:
        self._socket = sock
        self._is_stream = is_stream

    def write(self, data: bytes) -> None:
        sent = self._socket.send(data)
        if sent < len(data):  # the rest would have to be sent first, and later is too late
            raise BrokenPipeError("the other end does not read")

    def read(self) -> bytes:
        try:
            data = self._socket.recv(MAX_BYTES)
        except BlockingIOError:
            return b""
        if not data and self._is_stream:
            raise ConnectionResetError("the other end has closed the connection")
        return data


class _Answering:
    """A bound socket that sends to the last sender."""

    def __init__(self, sock: socket.socket) -> None:
        self._socket = sock
        self._to: tuple[str, int] | None = None

    def write(self, data: bytes) -> None:
        if self._to is not None:
            self._socket.sendto(data, self._to)

    def read(self) -> bytes:
        try:
            data, self._to = self._socket.recvfrom(MAX_BYTES)
        except BlockingIOError:
            return b""
        return data
