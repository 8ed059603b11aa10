"""Addresses of the configuration as sockets."""

import socket

from rig.errors import RigError


def split(address: str) -> tuple[str, int]:
    """Host and port of ``HOST:PORT`` or ``[IPV6]:PORT``."""
    host, port = address.rsplit(":", 1)
    return host.strip("[]"), int(port)


def bound_udp(address: str, key: str) -> socket.socket:
    """A socket that receives what is sent to ``address``. ``RigError`` names the configuration's ``key``."""
    host, port = split(address)
    try:
        family, kind, protocol, _, where = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
        receiver = socket.socket(family, kind, protocol)
    except OSError as error:
        raise RigError(f"{key}: {address}: {error.strerror}") from error
    try:
        receiver.bind(where)
    except OSError as error:
        receiver.close()
        raise RigError(
            f"{key}: cannot listen on {address}: {error.strerror}; is another rig run there?"
        ) from error
    return receiver
