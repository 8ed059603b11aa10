"""A camera for tests: MJPEG over HTTP on loopback, as network cameras send it."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import cv2
import numpy as np


class MjpegServer(ThreadingHTTPServer):
    """Sends ``picture()`` at ``rate_hz``; ``stall`` keeps the connection and sends nothing more."""

    daemon_threads = True

    def __init__(self, picture: Callable[[], np.ndarray], rate_hz: float) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.picture = picture
        self.rate_hz = rate_hz
        self.stall = threading.Event()
        self.ended = threading.Event()

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_address[1]}/stream.mjpg"


class _Handler(BaseHTTPRequestHandler):
    server: MjpegServer

    def do_GET(self) -> None:
        self.send_response(200)
        self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
        self.end_headers()
        try:
            while not self.server.ended.is_set():
                if not self.server.stall.is_set():
                    jpeg = cv2.imencode(".jpg", self.server.picture(), [cv2.IMWRITE_JPEG_QUALITY, 95])[
                        1
                    ].tobytes()
                    head = f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n"
                    self.wfile.write(head.encode() + jpeg + b"\r\n")
                time.sleep(1.0 / self.server.rate_hz)
        except (BrokenPipeError, ConnectionResetError):
            return

    def log_message(self, *args: object) -> None:
        pass


@contextmanager
def mjpeg_server(picture: Callable[[], np.ndarray], rate_hz: float = 25.0) -> Iterator[MjpegServer]:
    """A running server, ended on leaving."""
    server = MjpegServer(picture, rate_hz)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)
    thread.start()
    try:
        yield server
    finally:
        server.ended.set()
        server.shutdown()
        server.server_close()
        thread.join(2.0)
