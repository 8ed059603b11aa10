"""Sends the same lines to all TCP clients; slow or dead clients do not block the others."""

import errno
import logging
import selectors
import socket
from contextlib import suppress

from rig import timebase
from rig.config.run import host_and_port
from rig.daemon.sockets import why_not_listening
from rig.errors import ConfigError

MAX_CLIENTS = 32
WAITING_BYTES = 16_384
"""Queue limit per client, about half a minute of sentences. Clients further behind are dropped."""
UNACKNOWLEDGED_MS = 30_000
"""A client without acknowledgements for this long is dropped."""

_log = logging.getLogger(__name__)


class TcpBroadcast:
    """TCP server that only sends; input is read and discarded. Single-threaded and non-blocking."""

    def __init__(self, address: str, key: str) -> None:
        """``key`` names the configuration key in errors. Raises ``ConfigError`` if it cannot listen."""
        try:
            family, _, _, _, found = socket.getaddrinfo(*host_and_port(address), type=socket.SOCK_STREAM)[0]
            self._listener = socket.create_server(
                (str(found[0]), int(found[1])), family=family, backlog=MAX_CLIENTS
            )
        except OSError as error:
            raise ConfigError(f"{key}: cannot listen on {address}: {why_not_listening(error)}") from None
        self._listener.setblocking(False)
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listener, selectors.EVENT_READ)
        self._waiting: dict[socket.socket, bytearray] = {}
        self._new: set[socket.socket] = set()

    @property
    def address(self) -> tuple[str, int]:
        """Host and port; the actual port if 0 was configured."""
        host, port = self._listener.getsockname()[:2]
        return str(host), int(port)

    @property
    def clients(self) -> int:
        """Number of clients."""
        return len(self._waiting)

    def send(self, data: bytes, first: bytes = b"") -> None:
        """Send to all without blocking; the rest is queued for ``serve``. ``first`` is sent before it to new clients."""
        if self._listener not in self._selector.get_map():
            self._selector.register(self._listener, selectors.EVENT_READ)
        for client, waiting in list(self._waiting.items()):
            if len(waiting) + len(data) > WAITING_BYTES:
                self._drop(client, "it does not read")
                continue
            waiting += first + data if client in self._new else data
            self._new.discard(client)
            self._write(client)

    def serve(self, timeout_s: float) -> None:
        """Accept clients, send queues and detect closed connections, until ``timeout_s`` or the first event."""
        for key, events in self._selector.select(timebase.computer_s(timeout_s)):
            if key.fileobj is self._listener:
                self._accept()
                continue
            client = key.fileobj
            assert isinstance(client, socket.socket)
            if events & selectors.EVENT_READ:
                self._read(client)
            if events & selectors.EVENT_WRITE and client in self._waiting:
                self._write(client)

    def close(self) -> None:
        """Close all connections."""
        for client in list(self._waiting):
            self._drop(client, None)
        self._selector.close()
        self._listener.close()

    def _accept(self) -> None:
        try:
            client, address = self._listener.accept()
        except OSError as error:  # closed again, or out of descriptors, which would repeat endlessly
            _log.warning("nmea: a client could not be taken in: %s", error.strerror)
            self._selector.unregister(self._listener)  # until the next ``send``
            return
        if len(self._waiting) >= MAX_CLIENTS:
            _log.warning("nmea: %s was turned away: %d clients are connected", address[0], MAX_CLIENTS)
            client.close()
            return
        client.setblocking(False)
        with suppress(OSError):  # it may have disconnected; the first exchange will show it
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, UNACKNOWLEDGED_MS)
            # otherwise the system would buffer minutes of sentences for a client that does not read
            client.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, WAITING_BYTES)
        self._waiting[client] = bytearray()
        self._new.add(client)
        self._selector.register(client, selectors.EVENT_READ)

    def _read(self, client: socket.socket) -> None:
        try:
            if client.recv(4096) == b"":
                self._drop(client, None)
        except BlockingIOError:
            return
        except OSError as error:
            self._broken(client, error)

    def _write(self, client: socket.socket) -> None:
        waiting = self._waiting[client]
        try:
            del waiting[: client.send(waiting)]
        except BlockingIOError:
            pass
        except OSError as error:
            self._broken(client, error)
            return
        events = selectors.EVENT_READ | (selectors.EVENT_WRITE if waiting else 0)
        self._selector.modify(client, events)

    def _broken(self, client: socket.socket, error: OSError) -> None:
        left = error.errno in (errno.EPIPE, errno.ECONNRESET)  # with sentences unread: no event
        self._drop(client, None if left else error.strerror)

    def _drop(self, client: socket.socket, why: str | None) -> None:
        if why is not None:
            _log.warning("nmea: a client was let go: %s", why)
        del self._waiting[client]
        self._new.discard(client)
        self._selector.unregister(client)
        client.close()
