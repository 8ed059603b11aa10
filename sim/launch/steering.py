"""Control of a running simulated rig's vehicle from another process: a socket with one JSON object per line.

    {"do": "go", "speed_m_s": 10.0, "course_deg": 90.0}                        the vehicle drives
    {"do": "stand", "lat_deg": 37.3, "lon_deg": -122.2, "heading_deg": 90.0}   it is there, and stands
    {"do": "truth"}

Each is answered with the truth at that time, or with ``{"error": "..."}``.
"""

import json
import socket
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any, Protocol

from sim.background import in_background
from sim.errors import SimulationError

SOCKET_NAME = "steering.sock"
"""In the folder of the configuration that ``sim run`` writes."""
ASKED_WITHIN_S = 2.0
LONGEST_REQUEST = 4096
DRAWING_S = 120.0
"""Time for rendering the view from the new place."""


class Steerable(Protocol):
    """The part of a simulated rig that is controlled here."""

    def go(self, speed_m_s: float, course_deg: float) -> None: ...
    def stand_at(
        self, lat_deg: float, lon_deg: float, heading_deg: float, pitch_deg: float, roll_deg: float
    ) -> dict[str, Any]: ...
    def truth(self) -> dict[str, Any]: ...


@contextmanager
def steered(rig: Steerable, path: Path) -> Iterator[None]:
    """Serve the socket ``path`` while the context lasts."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as listener:
        listener.bind(str(path))
        listener.listen()
        listener.settimeout(0.2)
        with in_background(partial(_serve, rig, listener), "steering"):
            yield


def _serve(rig: Steerable, listener: socket.socket, stop: threading.Event) -> None:
    while not stop.is_set():
        try:
            client, _ = listener.accept()
        except TimeoutError:
            continue
        with client, suppress(OSError):  # the client has gone
            client.sendall(json.dumps(_done(rig, _line(client))).encode() + b"\n")


def _line(client: socket.socket) -> bytes:
    """A client's request line; it must be complete within ``ASKED_WITHIN_S``."""
    line, until_s = b"", time.monotonic() + ASKED_WITHIN_S
    while b"\n" not in line and len(line) < LONGEST_REQUEST:
        client.settimeout(max(0.001, until_s - time.monotonic()))
        part = client.recv(LONGEST_REQUEST)
        if not part:
            break
        line += part
    client.settimeout(ASKED_WITHIN_S)
    return line


def _done(rig: Steerable, line: bytes) -> dict[str, Any]:
    from sim.documents import values_of  # of the commands only; the simulated rig does not need it

    try:
        request = values_of(line)
        match request.pop("do", None):
            case "go":
                rig.go(**request)
            case "stand":
                return rig.stand_at(**{"pitch_deg": 0.0, "roll_deg": 0.0, **request})
            case "truth":
                pass
            case other:
                return {"error": f"cannot do {other!r}; go, stand or truth"}
    except (ValueError, TypeError, AttributeError, SimulationError) as error:
        return {"error": str(error)}
    return rig.truth()


def steer(path: Path, request: Mapping[str, Any]) -> dict[str, Any]:
    """Send a request to the rig at ``path``.

    Raises:
        SimulationError: there is none, or it cannot do that.
    """
    from sim.documents import values_of

    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as rig:
            rig.settimeout(DRAWING_S)
            rig.connect(str(path))
            rig.sendall(json.dumps(request).encode() + b"\n")
            with rig.makefile("rb") as lines:
                answer: dict[str, Any] = values_of(lines.readline() or b"{}")
    except OSError as error:
        raise SimulationError(f"{path}: no simulated rig answers there: {error.strerror or error}") from error
    if not answer or "error" in answer:
        raise SimulationError(f"{path}: {answer.get('error', 'the simulated rig ended')}")
    return answer
