"""The fake camera as the real ``cv2.VideoCapture`` and a raw socket see it."""

import http.client
import itertools
import threading
import time
from collections.abc import Iterator

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from sim.devices.camera_stream import CameraStream


class Scene:
    """Frames that carry their number as a grey level."""

    def __init__(self) -> None:
        self.drawn = itertools.count()
        self.last = 0

    def __call__(self) -> NDArray[np.uint8]:
        self.last = next(self.drawn)
        return np.full((48, 64, 3), self.last % 250, dtype=np.uint8)


@pytest.fixture
def scene() -> Scene:
    return Scene()


@pytest.fixture
def camera(scene: Scene) -> Iterator[CameraStream]:
    camera = CameraStream(scene, rate_hz=50.0)
    yield camera
    camera.close()


def test_opencv_reads_frames_in_order(camera: CameraStream) -> None:
    capture = cv2.VideoCapture(camera.url, cv2.CAP_FFMPEG)
    try:
        frames = [capture.read() for _ in range(5)]
    finally:
        capture.release()
    assert all(ok for ok, _ in frames)
    levels = [int(np.median(frame)) for _, frame in frames]
    assert levels == list(range(levels[0], levels[0] + 5))
    assert frames[0][1].shape == (48, 64, 3)


def test_nothing_is_rendered_without_a_client(camera: CameraStream, scene: Scene) -> None:
    time.sleep(0.1)
    assert next(scene.drawn) == 0


def test_another_path_is_not_found(camera: CameraStream) -> None:
    connection = http.client.HTTPConnection(camera.url.split("/")[2], timeout=2)
    connection.request("GET", "/other")
    assert connection.getresponse().status == 404
    connection.close()


def test_closing_ends_an_unread_stream(scene: Scene) -> None:
    before = threading.active_count()
    camera = CameraStream(scene, rate_hz=1000.0)
    connection = http.client.HTTPConnection(camera.url.split("/")[2], timeout=2)
    connection.request("GET", "/stream.mjpg")
    time.sleep(0.3)
    start_s = time.monotonic()
    camera.close()
    camera.close()
    assert time.monotonic() - start_s < 2.0
    assert threading.active_count() == before
    connection.close()
