"""Sends datagrams to configured addresses. Sending does not block; resolving a name may."""

import socket

from rig.config.run import host_and_port
from rig.daemon.state import DaemonState


class UdpTarget:
    """One address; its state is a device in the daemon state."""

    def __init__(self, address: str, daemon_state: DaemonState) -> None:
        self._address = address
        self._state = daemon_state
        self._socket: socket.socket | None = None
        self._to: tuple[str, int] | None = None

    def find(self, numeric: bool = False) -> bool:
        """Resolve the host; this may block for long unless it is ``numeric``."""
        host, port = host_and_port(self._address)
        flags = socket.AI_NUMERICHOST if numeric else 0
        try:
            family, _, _, _, to = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM, flags=flags)[0]
        except OSError as error:
            if not numeric:
                self._state.set_device(self._name, "failing", f"{host} cannot be looked up: {error.strerror}")
            return False
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        self._to = (str(to[0]), int(to[1]))
        return True

    def send(self, data: bytes) -> None:
        """Send, or record the error; later datagrams are sent all the same."""
        if self._socket is None or self._to is None:
            return
        try:
            self._socket.sendto(data, self._to)
        except OSError as error:
            self._state.set_device(self._name, "failing", f"cannot send: {error.strerror}")
        else:
            self._state.set_device(self._name, "ok", "datagrams are sent")

    def close(self) -> None:
        """Close the socket."""
        if self._socket is not None:
            self._socket.close()

    @property
    def _name(self) -> str:
        return f"nmea to {self._address}"
