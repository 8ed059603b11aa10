"""Messages for a camera that cannot be opened, never with its password; and cameras with single pictures."""

import base64
import os
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.config.camera_url import shown, without_secrets
from rig.config.load import load_config
from rig.config.sections import CameraSection
from rig.devices.camera.driver import Camera
from rig.devices.camera.http import credentials
from rig.devices.camera.source import KEY, gives_snapshots, why_not_opened
from rig.errors import ConfigError, DeviceError

JPEG = cv2.imencode(".jpg", np.full((48, 64, 3), 90, np.uint8))[1].tobytes()
Answer = tuple[int, dict[str, str], bytes]


def section(source: str, **changes: object) -> CameraSection:
    values = {
        "source": source,
        "width_px": 64,
        "height_px": 48,
        "fx_px": 50.0,
        "fy_px": 50.0,
        "cx_px": 31.5,
        "cy_px": 23.5,
    }
    return CameraSection.model_validate({**values, "open_timeout_s": 2.0, "read_timeout_s": 2.0, **changes})


@contextmanager
def served(answer: Callable[[BaseHTTPRequestHandler], Answer]) -> Iterator[str]:
    """HOST:PORT of a camera that answers so."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            status, headers, body = answer(self)
            self.send_response(status)
            for name, value in {"Content-Length": str(len(body)), **headers}.items():
                self.send_header(name, value)
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *args: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)
    thread.start()
    try:
        yield f"127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()
        server.server_close()
        thread.join(2.0)


def always(
    status: int, kind: str = "text/plain", body: bytes = b"x", **headers: str
) -> Callable[..., Answer]:
    return lambda _handler: (status, {"Content-Type": kind, **headers}, body)


@pytest.mark.parametrize(
    ("answer", "problem", "remedy"),
    [
        (
            always(401, **{"WWW-Authenticate": 'Basic realm="c"'}),
            "wants a user and a password",
            "USER:PASSWORD@HOST",
        ),
        (always(401), "wants a user and a password", "USER:PASSWORD@HOST"),
        (always(403), "forbids it to this user (HTTP 403)", "right to watch"),
        (always(404), "has nothing at that address (HTTP 404)", f"correct the path in {KEY}"),
        (always(410), "has nothing at that address (HTTP 410)", "the path"),
        (always(418), "refuses the request (HTTP 418", "the address"),
        (always(500), "has an error of its own (HTTP 500)", "restart it"),
        (always(503), "is busy (HTTP 503)", "end other programs"),
        (
            lambda handler: (302, {"Location": handler.path}, b""),
            "redirects without end",
            "the address that it leads to",
        ),
        (always(200, "text/html", b"<html>"), "gives a page (text/html)", "address of the stream itself"),
        (always(200, "application/json", b"{}"), "gives a page (application/json)", "the stream itself"),
        (always(200, "application/zip", b"PK"), "is no stream that OpenCV reads", "MJPEG or H.264"),
    ],
)
def test_each_answer_of_a_network_camera_has_its_message(
    answer: Callable[..., Answer], problem: str, remedy: str
) -> None:
    with served(answer) as host:
        told = why_not_opened(f"http://{host}/stream")
    assert problem in told[0]
    assert told[0].startswith("cannot be opened")
    assert remedy in told[1]


def test_a_wrong_password_is_distinguished_from_a_missing_one() -> None:
    with served(always(401, **{"WWW-Authenticate": 'Basic realm="c"'})) as host:
        problem, _ = why_not_opened(f"http://crew:wrongpw@{host}/stream")
    assert "does not accept the user and the password (HTTP 401)" in problem
    assert "wrongpw" not in problem


def test_a_camera_says_why_through_the_reader() -> None:
    with (
        served(always(404)) as host,
        Camera(section(f"http://crew:secretpw@{host}/x")) as camera,
        pytest.raises(
            DeviceError, match=rf"^camera http://{host}/x: cannot be opened: is there, and has nothing"
        ) as caught,
    ):
        camera.wait_open()
    assert "secretpw" not in str(caught.value)


def test_no_connection_has_its_message(monkeypatch: pytest.MonkeyPatch) -> None:
    assert "nothing listens on port 9 of 127.0.0.1" in why_not_opened("http://127.0.0.1:9/")[0]
    monkeypatch.setattr("rig.devices.camera.source.ASK_TIMEOUT_S", 0.1)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        port = silent.getsockname()[1]
        assert "does not answer within 0.1 s" in why_not_opened(f"http://127.0.0.1:{port}/")[0]
        assert "does not answer within 0.1 s" in why_not_opened(f"rtsp://127.0.0.1:{port}/")[0]
    assert "nothing listens on port 9" in why_not_opened("rtsp://127.0.0.1:9/")[0]

    def unknown(*_args: object, **_more: object) -> object:
        raise socket.gaierror(-2, "Name or service not known")

    monkeypatch.setattr(socket, "getaddrinfo", unknown)
    for scheme in ("http", "rtsp"):
        problem, remedy = why_not_opened(f"{scheme}://camra.lan/x")
        assert "the name 'camra.lan' is not known" in problem
        assert "correct the host" in remedy


@pytest.mark.parametrize(
    ("line", "words"),
    [
        (b"RTSP/1.0 401 Unauthorized", "wants a user and a password (RTSP 401)"),
        (b"RTSP/1.0 403 Forbidden", "forbids it"),
        (b"RTSP/1.0 404 Stream Not Found", "has no such stream (RTSP 404)"),
        (b"HTTP/1.1 400 Bad Request", "does not speak RTSP"),
    ],
)
def test_an_rtsp_camera_has_its_message(line: bytes, words: str) -> None:
    def answer() -> None:
        connection, _ = server.accept()
        with connection:
            connection.recv(1000)
            connection.sendall(line + b"\r\n\r\n")

    with socket.create_server(("127.0.0.1", 0)) as server:
        thread = threading.Thread(target=answer)
        thread.start()
        assert words in why_not_opened(f"rtsp://127.0.0.1:{server.getsockname()[1]}/live")[0]
        thread.join()


def test_a_local_source_has_its_message(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert "there is no such device" in why_not_opened("/dev/video99")[0]
    assert "there is no such device" in why_not_opened(99)[0]
    assert "it is no video device" in why_not_opened("/dev/shm")[0]
    assert "it is a folder" in why_not_opened(str(tmp_path))[0]
    (tmp_path / "a.txt").write_text("x")
    assert "no video that OpenCV reads" in why_not_opened(str(tmp_path / "a.txt"))[0]
    assert "/dev/video0" in why_not_opened("video0")[1]
    assert "a URL begins with http://" in why_not_opened("192.168.1.20/stream")[1]

    def forbidden(*_args: object) -> int:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "open", forbidden)
    assert "group video" in why_not_opened("/dev/null")[1]


def test_an_address_of_single_pictures_is_asked_for_each() -> None:
    asked: list[float] = []

    def answer(handler: BaseHTTPRequestHandler) -> Answer:
        if handler.headers.get("Authorization") != f"Basic {base64.b64encode(b'crew:pw/1').decode()}":
            return 401, {"WWW-Authenticate": 'Basic realm="camera"'}, b""
        asked.append(time.monotonic())
        level = 60 + 10 * (len(asked) % 10)
        picture = cv2.imencode(".jpg", np.full((48, 64, 3), level, np.uint8))[1].tobytes()
        return 200, {"Content-Type": "image/jpeg"}, picture

    with served(answer) as host:
        url = f"http://crew:pw%2F1@{host}/snap.jpg"
        assert gives_snapshots(url)
        with Camera(section(url)) as camera:
            camera.wait_open()
            moment = time.monotonic()
            frames = camera.frames_after(moment, 4)
    assert all(frame.not_before_s >= moment for frame in frames)  # asked for after the moment
    assert len({int(frame.image_bgr[0, 0, 0]) for frame in frames}) == 4


def test_single_pictures_that_end_say_why() -> None:
    left = [4]

    def answer(_handler: BaseHTTPRequestHandler) -> Answer:
        left[0] -= 1
        return (200, {"Content-Type": "image/jpeg"}, JPEG) if left[0] > 0 else (503, {}, b"")

    with served(answer) as host, Camera(section(f"http://{host}/snap.jpg", read_timeout_s=0.5)) as camera:
        camera.wait_open()
        with pytest.raises(DeviceError, match=r"gives no picture: is busy \(HTTP 503\); end other programs"):
            camera.frame_after(time.monotonic() + 1.0)


@pytest.mark.parametrize(
    ("source", "as_shown"),
    [
        (0, "0"),
        ("/dev/video0", "/dev/video0"),
        ("http://h/stream", "http://h/stream"),
        ("http://crew:pw@h:8080/s?x=1", "http://h:8080/s?x=1"),
        ("http://crew:p@ss@h/s", "http://h/s"),
        ("http://crew@h/s", "http://h/s"),
        ("http://crew:pa/ss@h/s", "http://h/s"),
        ("http://h:80/a@2x.jpg", "http://h:80/a@2x.jpg"),
        ("http://h/a@2x.jpg", "http://h/a@2x.jpg"),
        ("http://[::1]:80/a@b", "http://[::1]:80/a@b"),
        ("http://h/s?user=a&password=b&size=1", "http://h/s?user=***&password=***&size=1"),
        (
            "rtsp://h:554/user=admin&password=x&channel=1.sdp",
            "rtsp://h:554/user=***&password=***&channel=1.sdp",
        ),
        ("http://h/s?Token=abc#t", "http://h/s?Token=***#t"),
        ("http://h/cgi?usr=u&pwd=p", "http://h/cgi?usr=***&pwd=***"),
    ],
)
def test_a_source_is_shown_without_its_secrets(source: object, as_shown: str) -> None:
    assert shown(source) == as_shown


@given(
    user=st.text("abcxyz", min_size=3, max_size=8),
    password=st.text("ABC019!$%-_.:@", min_size=3, max_size=12),
    tail=st.sampled_from(["", "/s", "/s?a=1", "?a=1", "#x"]),
)
def test_no_password_is_ever_shown(user: str, password: str, tail: str) -> None:
    url = f"http://{user}:{password}@camera.lan:81{tail}"
    assert shown(url) == f"http://camera.lan:81{tail}"
    told = without_secrets(f"cannot open {url}: nonnumeric port: '{password}@camera.lan:81'", url)
    assert password not in told


def test_user_and_password_are_decoded() -> None:
    assert credentials("http://a%40b:p%2Fw@h:81/s?x") == ("http://h:81/s?x", "a@b", "p/w")
    assert credentials("http://h/s") == ("http://h/s", None, None)


def test_an_exposure_is_set_with_the_password_and_fails_without_it() -> None:
    def answer(handler: BaseHTTPRequestHandler) -> Answer:
        if "exposure" not in handler.path:
            return 200, {"Content-Type": "image/jpeg"}, JPEG
        if not handler.headers.get("Authorization"):
            return 401, {"WWW-Authenticate": 'Basic realm="camera"'}, b""
        return (200 if "ev=-1" in handler.path else 404), {}, b""

    with served(answer) as host:
        told = f"http://crew:secretpw@{host}/exposure?ev={{ev}}"
        with Camera(section(f"http://{host}/snap.jpg", exposure_url=told)) as camera:
            camera.expose(-1.0)
            with pytest.raises(
                DeviceError, match=r"takes no exposure: is there, and has nothing .* exposure_url"
            ) as caught:
                camera.expose(1.0)
    assert "secretpw" not in str(caught.value)
    broken = "http://crew:sec/ret@camera/exposure?ev={ev}"
    with (
        Camera(section("http://127.0.0.1:9/", exposure_url=broken)) as camera,
        pytest.raises(DeviceError, match="takes no exposure: its URL is broken") as caught,
    ):
        camera.expose(1.0)
    assert "ret@" not in str(caught.value)


def test_a_wrong_url_in_a_configuration_is_cited_without_its_password(tmp_path: Path) -> None:
    text = (Path(__file__).parents[3] / "configs" / "vehicle.toml").read_text()
    text = text.replace("# exposure_url = ", 'exposure_url = "http://crew:secretpw@h/set"\n# ')
    (tmp_path / "rig.toml").write_text(text)
    with pytest.raises(ConfigError, match="exposure_url") as caught:
        load_config(tmp_path / "rig.toml")
    assert "secretpw" not in str(caught.value)
