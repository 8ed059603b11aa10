"""A camera as an MJPEG stream over HTTP on loopback; each frame is taken when it is sent."""

import contextlib
import re
import socket
import threading
import time
from collections.abc import Callable
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import cv2
import numpy as np
from numpy.typing import NDArray

PATH = "/stream.mjpg"
EXPOSURE = re.compile(r"/exposure\?ev=(-?\d+(?:\.\d+)?)")
GAMMA = 2.2
BOUNDARY = "frame"


class CameraStream:
    """Serves ``frame()`` (height, width, 3; BGR) at ``rate_hz`` to all clients; idle without clients.

    ``alter`` may modify a picture before it is sent, or suppress it (None). GET /exposure?ev=-1 halves the light.
    """

    def __init__(
        self, frame: Callable[[], NDArray[np.uint8]], *, rate_hz: float = 10.0, jpeg_quality: int = 95
    ) -> None:
        self._frame = frame
        self.alter: Callable[[NDArray[np.uint8]], NDArray[np.uint8] | None] = lambda picture: picture
        self._ev = 0.0
        self._period_s = 1.0 / rate_hz
        self._jpeg_quality = jpeg_quality
        self._closing = threading.Event()
        self._absent = threading.Event()
        self._connections: set[socket.socket] = set()
        self._server = ThreadingHTTPServer(("127.0.0.1", 0), self._handler())
        self._server.daemon_threads = False  # so that close() waits for the streams to end
        self._thread = threading.Thread(
            target=self._server.serve_forever, kwargs={"poll_interval": 0.1}, name="camera"
        )
        self._thread.start()

    @property
    def url(self) -> str:
        """The URL for [camera] source."""
        return f"http://127.0.0.1:{self._server.server_port}{PATH}"

    @property
    def exposure_url(self) -> str:
        """The URL for [camera] exposure_url."""
        return f"http://127.0.0.1:{self._server.server_port}/exposure?ev={{ev}}"

    def close(self) -> None:
        """End all streams and the server. May be called twice."""
        if self._closing.is_set():
            return
        self._closing.set()
        self._server.shutdown()
        self._end_streams()
        self._server.server_close()
        self._thread.join()

    def disconnect(self, absent: bool) -> None:
        """End all streams and refuse new ones, or accept them again."""
        if absent:
            self._absent.set()
            self._end_streams()
        else:
            self._absent.clear()

    def _end_streams(self) -> None:
        for connection in list(self._connections):
            with contextlib.suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)

    def _handler(self) -> type[BaseHTTPRequestHandler]:
        stream = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                exposure = EXPOSURE.fullmatch(self.path)
                if exposure and not stream._absent.is_set():
                    stream._ev = float(exposure.group(1))
                    self.send_response(HTTPStatus.OK)
                    self.send_header("Content-Length", "0")
                    self.end_headers()
                    return
                if self.path != PATH or stream._absent.is_set():
                    self.send_error(HTTPStatus.NOT_FOUND)
                    return
                self.send_response(HTTPStatus.OK)
                self.send_header("Content-Type", f"multipart/x-mixed-replace; boundary={BOUNDARY}")
                self.end_headers()
                stream._connections.add(self.connection)
                with contextlib.suppress(ConnectionError):
                    stream._send_frames(self.wfile.write)
                stream._connections.discard(self.connection)

            def log_message(self, format: str, *args: object) -> None:  # noqa: A002 - the base class's name
                """Log nothing: the terminal belongs to the command under test."""

        return Handler

    def _send_frames(self, write: Callable[[bytes], object]) -> None:
        due_s = time.monotonic()
        while not self._closing.is_set():
            picture = self.alter(_exposed(self._frame(), self._ev))
            if picture is not None:
                ok, jpeg = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, self._jpeg_quality])
                assert ok
                head = f"--{BOUNDARY}\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n"
                write(head.encode("ascii") + jpeg.tobytes() + b"\r\n")
            due_s = max(due_s + self._period_s, time.monotonic())
            self._closing.wait(due_s - time.monotonic())


def _exposed(picture: NDArray[np.uint8], ev: float) -> NDArray[np.uint8]:
    """The picture with 2**ev times the light, gamma-encoded like a camera's."""
    if ev == 0.0:
        return picture
    levels = np.rint(picture.astype(np.float32) * 2.0 ** (ev / GAMMA))
    return np.asarray(np.clip(levels, 0.0, 255.0), np.uint8)
