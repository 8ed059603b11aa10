"""A local camera in the state that another program left: detected, set and restored."""

import errno
import os
import struct
import threading
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from pydantic import ValidationError

from rig.config.sections import CameraSection
from rig.devices.camera.driver import Camera, LocalExposure
from rig.devices.camera.v4l2_settings import V4l2Settings
from rig.errors import DeviceError
from rig.fault_notes import collecting
from sim.devices.camera_stream import CameraStream

AUTO, EXPOSURE, GAIN = cv2.CAP_PROP_AUTO_EXPOSURE, cv2.CAP_PROP_EXPOSURE, cv2.CAP_PROP_GAIN
FOURCC, WIDTH, HEIGHT = cv2.CAP_PROP_FOURCC, cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT
MJPG, YUYV = (float(cv2.VideoWriter.fourcc(*name)) for name in ("MJPG", "YUYV"))


class Driver:
    """Controls of a V4L2 camera, which persist. ``automatic`` and 1 are its modes."""

    def __init__(self, automatic: float = 3.0, **left: float) -> None:
        self.modes = {automatic, 1.0}
        self.formats = {MJPG, YUYV}
        self.stuck: set[int] = set()
        self.values: dict[int, float] = {
            AUTO: automatic,
            EXPOSURE: 160.0,
            GAIN: 4.0,
            cv2.CAP_PROP_AUTO_WB: 1.0,
            cv2.CAP_PROP_WB_TEMPERATURE: 4000.0,
            cv2.CAP_PROP_AUTOFOCUS: 1.0,
            cv2.CAP_PROP_FOCUS: 30.0,
            FOURCC: YUYV,
            WIDTH: 160.0,
            HEIGHT: 120.0,
        }
        for name, value in left.items():
            self.values[{"mode": AUTO, "exposure": EXPOSURE, "width": WIDTH, "height": HEIGHT}[name]] = value
        self.shown: list[tuple[float, float]] = []

    def get(self, control: int) -> float:
        return self.values.get(control, -1.0)

    def set(self, control: int, value: float) -> bool:
        if control not in self.values or control in self.stuck:
            return control in self.stuck  # a driver may say yes and do nothing
        if control == AUTO and value not in self.modes:
            return False
        if control == EXPOSURE and self.values[AUTO] != 1.0:
            return False
        if control == cv2.CAP_PROP_FOCUS and self.values[cv2.CAP_PROP_AUTOFOCUS]:
            return False
        if control == FOURCC and value not in self.formats:
            return True
        if control in (WIDTH, HEIGHT):
            return True  # it snaps to the one size that it has
        self.values[control] = value
        return True


class Capture:
    """What ``cv2.VideoCapture`` is to the camera."""

    def __init__(self, driver: Driver) -> None:
        self._driver = driver
        self.get, self.set = driver.get, driver.set

    def isOpened(self) -> bool:  # noqa: N802
        return True

    def grab(self) -> bool:
        time.sleep(0.01)
        self._driver.shown.append((self.get(AUTO), self.get(EXPOSURE)))
        return True

    def retrieve(self) -> tuple[bool, np.ndarray]:
        size = int(self.get(HEIGHT)), int(self.get(WIDTH)), 3
        return True, np.full(size, 128, np.uint8)

    def release(self) -> None:
        """The driver keeps its values."""


def section(**keys: object) -> CameraSection:
    usual: dict[str, object] = {
        "source": "/dev/video-of-nobody",
        "width_px": 160,
        "height_px": 120,
        "fx_px": 124.0,
        "fy_px": 124.0,
        "cx_px": 79.5,
        "cy_px": 59.5,
        "open_timeout_s": 1.0,
        "read_timeout_s": 1.0,
    }
    return CameraSection.model_validate(usual | keys)


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """Opens a camera on a driver."""
    before = threading.active_count()

    def open_camera(driver: Driver, **keys: object) -> Camera:
        monkeypatch.setattr(cv2, "VideoCapture", lambda *arguments: Capture(driver))
        return Camera(section(**keys))

    yield open_camera
    assert threading.active_count() == before


@pytest.mark.parametrize("automatic", [3.0, 0.0])
def test_manual_exposure_of_another_program_is_made_automatic_and_given_back(
    opened: Any, automatic: float
) -> None:
    driver = Driver(automatic, mode=1.0, exposure=3.0)
    with opened(driver) as camera:
        camera.wait_open()
        assert driver.values[AUTO] == automatic
    assert (driver.values[AUTO], driver.values[EXPOSURE]) == (1.0, 3.0)


@pytest.mark.parametrize("automatic", [3.0, 0.0])
@pytest.mark.parametrize("way_out", ["asked", "closed", "error"])
def test_after_a_darker_picture_the_camera_has_its_own_automatic_again(
    opened: Any, automatic: float, way_out: str
) -> None:
    driver = Driver(automatic)
    with opened(driver) as camera:
        camera.wait_open()
        camera.expose(-2.0)
        camera.frame_after(time.monotonic() + 0.05)
        assert driver.shown[-1] == (1.0, 40.0)
        if way_out == "asked":
            camera.expose(0.0)
            camera.frame_after(time.monotonic() + 0.05)
            assert driver.values[AUTO] == automatic
        if way_out == "error":
            driver.values[WIDTH] = 320.0
            with pytest.raises(DeviceError, match="320 x 120"):
                camera.frame_after(time.monotonic() + 0.5)
    assert driver.values[AUTO] == automatic


def test_a_camera_that_stays_at_the_manual_exposure_it_was_left_with_is_refused(opened: Any) -> None:
    driver = Driver(mode=1.0, exposure=3.0)
    driver.stuck.add(AUTO)
    with (
        opened(driver) as camera,
        pytest.raises(DeviceError, match="manual exposure of 3 that another program"),
    ):
        camera.wait_open()


@pytest.mark.parametrize("way_out", ["asked", "closed"])
def test_a_network_camera_that_was_left_dark_is_left_to_itself_before_and_after(way_out: str) -> None:
    stream = CameraStream(lambda: np.full((120, 160, 3), 128, np.uint8), rate_hz=25.0)
    try:
        with urllib.request.urlopen(stream.exposure_url.replace("{ev}", "-3")) as reply:
            assert reply.status == 200
        with Camera(section(source=stream.url, exposure_url=stream.exposure_url)) as camera:
            camera.wait_open()
            assert camera.frame_after(time.monotonic()).image_bgr.mean() == pytest.approx(128, abs=3)
            camera.expose(-2.0)
            assert camera.frame_after(time.monotonic() + 0.1).image_bgr.mean() < 90
            if way_out == "asked":
                camera.expose(0.0)
        with Camera(section(source=stream.url)) as camera:  # one that tells it nothing
            camera.wait_open()
            assert camera.frame_after(time.monotonic()).image_bgr.mean() == pytest.approx(128, abs=3)
    finally:
        stream.close()


def test_an_exposure_that_the_driver_says_it_takes_and_does_not_is_noted() -> None:
    driver: Any = Driver()
    driver.stuck.add(EXPOSURE)
    with collecting() as notes:
        LocalExposure(driver, name="camera 0").set(-1.0)
    assert [note.problem for note in notes.all()] == ["takes no exposure of -1 EV"]


def test_fixed_exposure_gain_white_balance_and_focus_are_set_and_given_back(opened: Any) -> None:
    driver = Driver()
    before = dict(driver.values)
    fixed = {"exposure": 100.0, "gain": 10.0, "white_balance_k": 5200.0, "focus": 5.0, "fourcc": "MJPG"}
    with opened(driver, **fixed) as camera:
        camera.wait_open()
        assert (driver.values[AUTO], driver.values[EXPOSURE], driver.values[GAIN]) == (1.0, 100.0, 10.0)
        assert driver.values[cv2.CAP_PROP_WB_TEMPERATURE] == 5200.0
        assert (driver.values[cv2.CAP_PROP_AUTOFOCUS], driver.values[cv2.CAP_PROP_FOCUS]) == (0.0, 5.0)
        assert driver.values[FOURCC] == MJPG
        camera.expose(-1.0)
        camera.frame_after(time.monotonic() + 0.05)
        assert driver.shown[-1] == (1.0, 50.0)
        camera.expose(0.0)
        camera.frame_after(time.monotonic() + 0.05)
        assert driver.shown[-1] == (1.0, 100.0)
    assert driver.values[AUTO] == 3.0
    kept = (GAIN, cv2.CAP_PROP_AUTO_WB, cv2.CAP_PROP_AUTOFOCUS)
    assert [driver.values[key] for key in kept] == [before[key] for key in kept]


@pytest.mark.parametrize(
    ("key", "value", "stuck"),
    [
        ("exposure", 100.0, EXPOSURE),
        ("exposure", 100.0, AUTO),
        ("gain", 10.0, GAIN),
        ("white_balance_k", 5200.0, cv2.CAP_PROP_WB_TEMPERATURE),
        ("focus", 5.0, cv2.CAP_PROP_FOCUS),
    ],
)
def test_a_camera_that_does_not_take_what_is_fixed_is_refused(
    opened: Any, key: str, value: float, stuck: int
) -> None:
    driver = Driver()
    driver.stuck.add(stuck)
    with (
        opened(driver, **{key: value}) as camera,
        pytest.raises(DeviceError, match=rf"does not take \[camera\] {key} {value:g} \(it has"),
    ):
        camera.wait_open()


def test_a_format_that_the_camera_does_not_give_is_refused(opened: Any) -> None:
    driver = Driver()
    said = pytest.raises(DeviceError, match=r"does not give \[camera\] fourcc 'H264' \(it gives 'YUYV'\)")
    with opened(driver, fourcc="H264") as camera, said:
        camera.wait_open()


def test_a_size_that_the_driver_snaps_to_another_is_refused(opened: Any) -> None:
    driver = Driver(width=176.0, height=144.0)
    with (
        opened(driver) as camera,
        pytest.raises(DeviceError, match=r"sends 176 x 144 px, but the intrinsics"),
    ):
        camera.wait_open()


def test_keys_for_a_driver_do_not_go_with_a_stream() -> None:
    with pytest.raises(ValidationError, match="gain is set in the driver"):
        section(source="http://camera/stream.mjpg", gain=3.0)


ZOOM, FLIP, BRIGHTNESS = 0x009A090D, 0x00980914, 0x00980900
QUERY, CONTROL = struct.Struct("=II32siiiiI8x"), struct.Struct("=Ii")


class Kernel:
    """The three ioctls, of a camera with these controls: id -> [value, default, flags]."""

    def __init__(self, controls: dict[int, list[int]], stuck: int = 0) -> None:
        self.controls = controls
        self.stuck = stuck

    def __call__(self, device: int, request: int, argument: bytearray) -> int:
        assert os.fstat(device)
        control_id = struct.unpack_from("=I", argument)[0]
        if control_id not in self.controls:
            raise OSError(errno.EINVAL, "no such control")
        value, default, flags = self.controls[control_id]
        if request == 0xC0445624:
            argument[:] = QUERY.pack(control_id, 1, b"name", 0, 500, 1, default, flags)
        elif request == 0xC008561B:
            argument[:] = CONTROL.pack(control_id, value)
        elif request == 0xC008561C and control_id != self.stuck:
            self.controls[control_id][0] = CONTROL.unpack(argument)[1]
        return 0


def test_zoom_and_mirror_are_at_their_defaults_meanwhile_and_given_back(tmp_path: Path) -> None:
    (tmp_path / "video").touch()
    kernel = Kernel({ZOOM: [180, 100, 0], FLIP: [1, 0, 0], BRIGHTNESS: [0, 128, 0]})
    settings = V4l2Settings(str(tmp_path / "video"), "camera", kernel)
    assert {key: values[0] for key, values in kernel.controls.items()} == {
        ZOOM: 100,
        FLIP: 0,
        BRIGHTNESS: 128,
    }
    settings.restore()
    assert {key: values[0] for key, values in kernel.controls.items()} == {ZOOM: 180, FLIP: 1, BRIGHTNESS: 0}


def test_a_zoom_that_cannot_be_reset_is_refused(tmp_path: Path) -> None:
    (tmp_path / "video").touch()
    kernel = Kernel({ZOOM: [180, 100, 0], FLIP: [1, 0, 0]}, stuck=ZOOM)
    with pytest.raises(DeviceError, match=r"keeps its zoom as another program left it: the intrinsics"):
        V4l2Settings(str(tmp_path / "video"), "camera", kernel)
    assert kernel.controls[FLIP][0] == 1


def test_what_is_no_camera_has_no_settings(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for path in (tmp_path / "file", tmp_path / "nothing"):
        V4l2Settings(str(path), "camera").restore()
