"""Sockets for the configured addresses."""

import errno
import socket

from rig.errors import RigError


def why_not_listening(error: OSError) -> str:
    """Why listening on an address failed, and what to do."""
    remedy = {
        errno.EADDRINUSE: "end what listens there (another rig run?), or give another port",
        errno.EACCES: "give a port from 1024 on: those below are for root",
        errno.EADDRNOTAVAIL: "this computer has no such address: give one of its own, or 0.0.0.0",
        errno.EAFNOSUPPORT: "this computer has no IPv6: give an IPv4 address",
    }.get(error.errno or 0, "give another address")
    if isinstance(error, socket.gaierror):
        remedy = "the name is not known: give an address"
    return f"{error.strerror or error}; {remedy}"


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
        raise RigError(f"{key}: {address}: {why_not_listening(error)}") from error
    try:
        receiver.bind(where)
    except OSError as error:
        receiver.close()
        raise RigError(f"{key}: cannot listen on {address}: {why_not_listening(error)}") from error
    return receiver
