"""The daemon's control socket: one JSON object per line as request, one line as answer.

{"do": "trigger"}   {"answer": "started"}, {"answer": "not ready", "why": "camera: ..."}
{"do": "status"}    the board, ``skyfix.status/1``
anything else       {"error": "..."}
"""

import json
import logging
import os
import selectors
import socket
import stat
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from localizer.documents import DocumentError, json_values
from rig import timebase
from rig.daemon.readiness import why_not_ready_in_full
from rig.daemon.state import Actions, DaemonState
from rig.daemon.status import status_json
from rig.errors import RigError

_log = logging.getLogger(__name__)

LONGEST_REQUEST = 4096
LONGEST_ANSWER = 8_000_000
CLIENT_TIMEOUT_S = 2.0
"""Time limit of a client for request and answer together."""
MAX_CLIENTS = 16
"""Limit of clients: beyond it the oldest is dropped; it has had more time than a well-behaved client needs."""
BACKLOG = 128
"""Length of the listen queue."""
POLL_S = 0.25
LONGEST_PATH = 107  # sockaddr_un


class ControlError(RigError):
    """The daemon cannot be reached."""


@dataclass
class _Client:
    socket: socket.socket
    until_s: float
    received: bytearray = field(default_factory=bytearray)
    reply: bytes | None = None
    """None until the request is complete."""


class ControlSocket:
    """Serves the socket until stopped; the socket's file exists as long. Clients do not block each other."""

    def __init__(self, path: Path, daemon_state: DaemonState, actions: Actions) -> None:
        """``ControlError`` if the socket cannot be created."""
        self._path = path
        self._state = daemon_state
        self._actions = actions
        self._clients: dict[int, _Client] = {}
        if len(os.fsencode(path)) > LONGEST_PATH:
            raise ControlError(f"{path}: too long for a socket's name; give a shorter one in [run] control")
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            _remove_stale_socket(path)
            self._socket.bind(str(path))
            path.chmod(0o660)
            self._socket.listen(BACKLOG)
            self._socket.setblocking(False)
        except OSError as error:
            self._socket.close()
            raise ControlError(
                f"{path}: no socket can be made there: {error.strerror}; see [run] control"
            ) from error

    def close(self) -> None:
        """Remove the socket."""
        self._socket.close()
        self._path.unlink(missing_ok=True)

    def run(self, beat: Callable[[], None], stop: threading.Event) -> None:
        """Serve until ``stop``: every answer is available at once."""
        with selectors.DefaultSelector() as selector:
            selector.register(self._socket, selectors.EVENT_READ)
            while not stop.is_set():
                beat()
                for key, _ in selector.select(timebase.computer_s(POLL_S)):
                    if key.fileobj is self._socket:
                        self._accept(selector, stop)
                    elif key.fd in self._clients:
                        self._serve(selector, self._clients[key.fd])
                now_s = time.monotonic()
                for client in [each for each in self._clients.values() if each.until_s <= now_s]:
                    self._drop(selector, client)
            for client in list(self._clients.values()):
                self._drop(selector, client)

    def _accept(self, selector: selectors.BaseSelector, stop: threading.Event) -> None:
        for _ in range(BACKLOG):
            try:
                accepted, _ = self._socket.accept()
            except BlockingIOError:
                return
            except OSError as error:  # closed again, or out of descriptors, which would repeat endlessly
                _log.warning("control: a client could not be taken in: %s", error.strerror)
                timebase.wait(stop, POLL_S)
                return
            if len(self._clients) >= MAX_CLIENTS:
                self._drop(selector, min(self._clients.values(), key=lambda client: client.until_s))
            accepted.setblocking(False)
            client = _Client(accepted, time.monotonic() + CLIENT_TIMEOUT_S)
            self._clients[accepted.fileno()] = client
            selector.register(accepted, selectors.EVENT_READ)
            self._serve(
                selector, client
            )  # a normal client has sent its request already, and is served at once

    def _serve(self, selector: selectors.BaseSelector, client: _Client) -> None:
        """One step of a client: receive more of its request, or send more of the answer."""
        try:
            if client.reply is None:
                part = client.socket.recv(LONGEST_REQUEST)
                client.received += part
                if part and b"\n" not in part and len(client.received) < LONGEST_REQUEST:
                    return
                client.reply = json.dumps(self._answer(bytes(client.received))).encode() + b"\n"
                selector.modify(client.socket, selectors.EVENT_WRITE)
            client.reply = client.reply[client.socket.send(client.reply) :]
        except (BlockingIOError, InterruptedError):
            return
        except OSError:  # the client has gone
            client.reply = b""
        if not client.reply:
            self._drop(selector, client)

    def _drop(self, selector: selectors.BaseSelector, client: _Client) -> None:
        del self._clients[client.socket.fileno()]
        selector.unregister(client.socket)
        client.socket.close()

    def _answer(self, line: bytes) -> dict[str, Any]:
        try:
            request = json_values(line.split(b"\n", 1)[0], LONGEST_REQUEST)
            request = request["do"]
        except (DocumentError, TypeError, KeyError):
            return {"error": 'give one line of JSON, {"do": "trigger"} or {"do": "status"}'}
        match request:
            case "trigger":
                answer = self._actions.trigger("command")
                why = {"why": why_not_ready_in_full(self._state)} if answer == "not ready" else {}
                return {"answer": answer, **why}
            case "status":
                return status_json(self._state.snapshot())
        return {"error": f"cannot do {request!r}, only trigger and status"}


def _remove_stale_socket(path: Path) -> None:
    """Remove the socket of a killed daemon: the spool's lock shows that no other daemon runs. Nothing else is removed."""
    with suppress(FileNotFoundError):
        if not stat.S_ISSOCK(path.lstat().st_mode):
            raise ControlError(f"{path}: is something else than a socket; take it away, or see [run] control")
        path.unlink()


def _connect(daemon: socket.socket, path: Path, until_s: float) -> None:
    """Connect with retries: a Unix socket with a full queue refuses at once, whatever its timeout."""
    while True:
        try:
            daemon.connect(str(path))
        except BlockingIOError:
            if time.monotonic() >= until_s:
                raise
            time.sleep(0.02)
        else:
            return


def send_request(path: Path, request: str, timeout_s: float = 10.0) -> dict[str, Any]:
    """The daemon's answer. ``ControlError`` if none listens at ``path``, or it does not answer in time."""
    until_s = time.monotonic() + timeout_s
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as daemon:
        daemon.settimeout(timeout_s)
        line = b""
        try:
            _connect(daemon, path, until_s)
            daemon.sendall(json.dumps({"do": request}).encode() + b"\n")
            while b"\n" not in line and len(line) <= LONGEST_ANSWER:
                daemon.settimeout(max(0.001, until_s - time.monotonic()))
                part = daemon.recv(1 << 16)
                if not part:
                    break
                line += part
        except (FileNotFoundError, ConnectionRefusedError):
            raise ControlError(
                f"{path}: no rig run listens there; start it, with the same configuration"
            ) from None
        except PermissionError as error:
            raise ControlError(
                f"{path}: this user may not reach it: {error.strerror}; join the group of the socket, often skyfix, or use sudo"
            ) from error
        except TimeoutError as error:
            raise ControlError(
                f"{path}: rig run does not answer within {timeout_s:g} s; see its log (journalctl -u skyfix)"
            ) from error
        except OSError as error:
            raise ControlError(f"{path}: rig run does not answer: {error.strerror or error}") from error
    try:
        answer = json_values(line, LONGEST_ANSWER)
    except DocumentError:
        raise ControlError(f"{path}: rig run ended before it answered") from None
    if not isinstance(answer, dict):
        raise ControlError(f"{path}: what listens there is no rig run; see [run] control")
    if "error" in answer:
        raise ControlError(f"{path}: {answer['error']}")
    return answer
