"""Diagnosis of [camera] source if it cannot be opened, and cameras that deliver single pictures."""

import errno
import os
import socket
import stat
import urllib.parse
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from rig import timebase
from rig.devices.camera.http import UnusableUrlError, credentials, get, missing_credentials, why_not_connected

KEY = "[camera] source"
ASK_TIMEOUT_S = 1.5
MIN_BETWEEN_S = 0.05
"""Pause between requested pictures: a fast camera must have time for other clients."""
MAX_PICTURE_BYTES = 50_000_000

ProblemAndRemedy = tuple[str, str]


class Snapshots:
    """A camera that delivers one picture per request, with the methods of ``cv2.VideoCapture``.

    ``grab`` raises ``UnusableUrlError`` if there is none.
    """

    def __init__(self, url: str, timeout_s: float) -> None:
        self._url, self._timeout_s = url, timeout_s
        self._picture = b""
        self._asked_s = -1.0

    def grab(self) -> bool:
        """Request a picture and wait for it: it was taken after the request."""
        timebase.sleep(max(0.0, self._asked_s + MIN_BETWEEN_S - timebase.monotonic_s()))
        self._asked_s = timebase.monotonic_s()
        with get(self._url, self._timeout_s, KEY) as answer:
            try:
                self._picture = answer.read(MAX_PICTURE_BYTES)
            except OSError as error:
                raise UnusableUrlError(*why_not_connected(error, self._url, self._timeout_s, KEY)) from None
        return bool(self._picture)

    def retrieve(self) -> tuple[bool, NDArray[Any]]:
        """The grabbed picture, decoded."""
        image = cv2.imdecode(np.frombuffer(self._picture, np.uint8), cv2.IMREAD_COLOR)
        return (False, np.empty(0, np.uint8)) if image is None else (True, image)

    def set(self, _property: int, _value: float) -> bool:
        """Nothing can be set."""
        return False

    def get(self, _property: int) -> float:
        """Nothing is known."""
        return 0.0

    def release(self) -> None:
        """Nothing is held."""


def is_http(source: object) -> bool:
    """Whether a source is an HTTP address."""
    return isinstance(source, str) and source.lower().startswith(("http://", "https://"))


def gives_snapshots(url: str) -> bool:
    """Whether an HTTP address delivers a single picture instead of a stream. False if that cannot be determined."""
    try:
        with get(url, ASK_TIMEOUT_S, KEY) as answer:
            return _content_type(answer).startswith("image/")
    except UnusableUrlError:
        return False


def why_not_opened(source: int | str) -> ProblemAndRemedy:
    """Problem and remedy of a source that OpenCV cannot open, found by other means."""
    if isinstance(source, int) or source.startswith("/dev/"):
        return _of_a_device(f"/dev/video{source}" if isinstance(source, int) else source)
    if is_http(source):
        return _of_http(source)
    if source.lower().startswith(("rtsp://", "rtsps://")):
        return _of_rtsp(source)
    if "://" in source:
        return _UNKNOWN
    return _of_a_file(source)


_UNKNOWN = ("cannot be opened", f"check that it is connected and running, and {KEY}")


def _content_type(answer: Any) -> str:
    return str(answer.headers.get_content_type()).lower() if answer.headers.get("Content-Type") else ""


def _of_http(url: str) -> ProblemAndRemedy:
    try:
        with get(url, ASK_TIMEOUT_S, KEY) as answer:
            kind = _content_type(answer)
            begin = answer.read(64) if kind.startswith("text/") or not kind else b""
    except UnusableUrlError as error:
        return f"cannot be opened: {error.problem}", error.remedy
    except OSError as error:
        problem, remedy = why_not_connected(error, url, ASK_TIMEOUT_S, KEY)
        return f"cannot be opened: {problem}", remedy
    if (
        kind.startswith(("text/", "application/json", "application/xhtml", "application/xml"))
        or begin[:1] == b"<"
    ):
        return (
            f"cannot be opened: the address gives a page ({kind or 'without a type'}), not pictures",
            f"name the address of the stream itself, or of a picture, in {KEY}; the camera's manual has it",
        )
    return (
        f"cannot be opened: what the address gives ({kind or 'without a content type'}) is no stream that OpenCV reads",
        f"set the camera to MJPEG or H.264, or name another stream in {KEY}",
    )


def _of_rtsp(url: str) -> ProblemAndRemedy:
    try:
        plain, user, _ = credentials(url)
        parts = urllib.parse.urlsplit(plain)
        with socket.create_connection((parts.hostname or "", parts.port or 554), ASK_TIMEOUT_S) as connection:
            connection.settimeout(ASK_TIMEOUT_S)
            request = f"DESCRIBE {plain} RTSP/1.0\r\nCSeq: 1\r\nAccept: application/sdp\r\nUser-Agent: skyfix\r\n\r\n"
            connection.sendall(request.encode("ascii", "replace"))
            line = connection.recv(256).split(b"\r\n")[0].decode("ascii", "replace")
    except OSError as error:
        problem, remedy = why_not_connected(error, url, ASK_TIMEOUT_S, KEY)
        return f"cannot be opened: {problem}", remedy
    except ValueError:
        return (
            "cannot be opened: its URL is broken",
            f"correct {KEY}; write / : @ and ? in a password as %2F %3A %40 %3F",
        )
    said = line.split(" ")[1] if line.startswith("RTSP/") and " " in line else ""
    if said == "401":
        problem, remedy = missing_credentials(user is not None, "RTSP 401", KEY)
        return f"cannot be opened: {problem}", remedy
    if said == "403":
        return "cannot be opened: forbids it to this user (RTSP 403)", "give the user the right to watch"
    if said in ("404", "454"):
        return (
            f"cannot be opened: is there, and has no such stream (RTSP {said})",
            f"correct the path in {KEY}",
        )
    if not said:
        return (
            "cannot be opened: does not speak RTSP on that port",
            f"correct the port or the scheme in {KEY}",
        )
    return _UNKNOWN


def _of_a_device(path: str) -> ProblemAndRemedy:
    try:
        is_device = stat.S_ISCHR(os.stat(path).st_mode)  # noqa: PTH116 - its errno is wanted
        if not is_device:
            return "cannot be opened: it is no video device", f"correct {KEY}; {_devices_there()}"
        os.close(os.open(path, os.O_RDWR | os.O_NONBLOCK))
    except OSError as error:
        match error.errno:
            case errno.ENOENT | errno.ENOTDIR:
                return (
                    "cannot be opened: there is no such device",
                    f"plug the camera in, or correct {KEY}; {_devices_there()}",
                )
            case errno.EACCES | errno.EPERM:
                return (
                    "cannot be opened: this user may not use it",
                    "add the user to the group video, and log in again",
                )
            case errno.EBUSY:
                return "cannot be opened: it is in use", "end the other program that has it open"
            case errno.ENODEV | errno.ENXIO:
                return "cannot be opened: the camera has gone away", "plug it in again"
        return f"cannot be opened ({error.strerror})", f"check that it is connected, and {KEY}"
    return (
        "cannot be opened: it is in use, or gives no pictures (some cameras have a second device for data)",
        f"end the other program that has it open, or correct {KEY}; {_devices_there()}",
    )


def _devices_there() -> str:
    there = [str(path) for path in sorted(Path("/dev").glob("video*"))]
    return f"there is {', '.join(there[:6])}" if there else "there is no /dev/video*"


def _of_a_file(source: str) -> ProblemAndRemedy:
    path = Path(source)
    if path.is_dir():
        return "cannot be opened: it is a folder", f"name a device, a URL or a video file in {KEY}"
    if path.exists():
        return "cannot be opened: it is no video that OpenCV reads", f"name another file in {KEY}"
    if source.startswith("video") or source.isdigit():
        return (
            "cannot be opened: there is no such file",
            f"a device is named /dev/{source.removeprefix('/dev/')} in {KEY}",
        )
    return (
        "cannot be opened: there is no such file",
        f"correct {KEY}; a URL begins with http:// or rtsp://",
    )
