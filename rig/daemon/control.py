"""The daemon's control socket: one JSON object a line from whoever may write to it, one line back.

{"do": "trigger"}   {"answer": "started"}
{"do": "status"}    the board, ``skyfix.status/1``
anything else       {"error": "..."}
"""

import json
import os
import socket
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from rig.daemon.board import Actions, Board
from rig.daemon.status import status_json
from rig.errors import RigError

LONGEST_REQUEST = 4096
CLIENT_S = 1.0
"""Whoever connects has to say what he wants within this time."""
LONGEST_PATH = 107  # sockaddr_un


class ControlError(RigError):
    """The daemon cannot be spoken to."""


class ControlSocket:
    """Listens until it is told to stop; its file is there as long as it does."""

    def __init__(self, path: Path, board: Board, actions: Actions) -> None:
        """``ControlError`` where there can be no socket."""
        self._path = path
        self._board = board
        self._actions = actions
        if len(os.fsencode(path)) > LONGEST_PATH:
            raise ControlError(f"{path}: too long for a socket's name; give a shorter one in [run] control")
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.unlink(
                missing_ok=True
            )  # of a daemon that was killed: the spool's lock says that there is no other
            self._socket.bind(str(path))
            path.chmod(0o660)
            self._socket.listen(8)
        except OSError as error:
            self._socket.close()
            raise ControlError(
                f"{path}: no socket can be made there: {error.strerror}; see [run] control"
            ) from error

    def close(self) -> None:
        """Take the socket away."""
        self._socket.close()
        self._path.unlink(missing_ok=True)

    def run(self, beat: Callable[[], None], stop: threading.Event) -> None:
        """Answer one after the other until ``stop``: every answer is there at once."""
        self._socket.settimeout(0.5)
        while not stop.is_set():
            beat()
            try:
                client, _ = self._socket.accept()
            except TimeoutError:
                continue
            with client, suppress(OSError):  # a client that goes away has no use for an answer
                client.settimeout(CLIENT_S)
                client.sendall(json.dumps(self._answer(_line(client))).encode() + b"\n")

    def _answer(self, line: bytes) -> dict[str, Any]:
        try:
            request = json.loads(line)
            wish = request["do"]
        except (ValueError, TypeError, KeyError):
            return {"error": 'give one line of JSON, {"do": "trigger"} or {"do": "status"}'}
        match wish:
            case "trigger":
                return {"answer": self._actions.trigger("command")}
            case "status":
                return status_json(self._board.snapshot())
        return {"error": f"cannot do {wish!r}, only trigger and status"}


def ask(path: Path, wish: str, timeout_s: float = 10.0) -> dict[str, Any]:
    """What the daemon answers. ``ControlError`` where none listens at ``path``, or it does not answer."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as daemon:
        daemon.settimeout(timeout_s)
        try:
            daemon.connect(str(path))
            daemon.sendall(json.dumps({"do": wish}).encode() + b"\n")
            line = _line(daemon, None)
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
        answer: dict[str, Any] = json.loads(line)
    except ValueError:
        raise ControlError(f"{path}: rig run ended before it answered") from None
    if "error" in answer:
        raise ControlError(f"{path}: {answer['error']}")
    return answer


def _line(other: socket.socket, most: int | None = LONGEST_REQUEST) -> bytes:
    """What comes up to the end of a line, or of the connection."""
    text = b""
    while b"\n" not in text and (most is None or len(text) < most):
        part = other.recv(LONGEST_REQUEST)
        if not part:
            break
        text += part
    return text
