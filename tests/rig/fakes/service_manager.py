"""The service manager's end of the notification socket."""

import re
import socket
import time

SOON_S = 60.0
"""A wait that only a failing test lasts out."""


class Manager:
    """The service manager's end of the socket."""

    def __init__(self, address: str) -> None:
        self.address = address
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.socket.bind("\0" + address[1:] if address.startswith("@") else address)

    def heard(self, timeout_s: float = SOON_S) -> str:
        """The next datagram."""
        self.socket.settimeout(timeout_s)
        return self.socket.recv(65536).decode()

    def hears(self, datagram: str) -> str:
        """Read on until one that this regular expression matches."""
        heard = []
        deadline = time.monotonic() + SOON_S
        while time.monotonic() < deadline:
            heard.append(self.heard())
            if re.fullmatch(datagram, heard[-1]):
                return heard[-1]
        raise AssertionError(f"{datagram!r} is not among {heard}")

    def read_all(self) -> list[str]:
        """What has arrived so far."""
        found = []
        self.socket.settimeout(0.0)
        while True:
            try:
                found.append(self.socket.recv(65536).decode())
            except BlockingIOError:
                return found
