"""Exposure bracketing of an overexposed sky, if the exposure is settable."""

import math
from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np
import pytest

from localizer.skyline.find import find_skyline
from rig.capture.pictures.bracketing import (
    OVEREXPOSED_LIMIT,
    Pictures,
    bracketed,
    overexposed_share,
    pictures_of,
)
from rig.clock import Instant
from rig.config.sections import CameraSection
from rig.devices.camera.driver import V4L2_AUTOMATIC, V4L2_MANUAL, Camera, LocalExposure
from rig.devices.camera.frames import TimedFrame
from rig.errors import TransientError
from rig.fault_notes import collecting
from sim.devices.camera_stream import CameraStream

WIDTH, HEIGHT = 160, 120
RIDGE_ROW, HILL_ROW = 50, 85


def view(light: float) -> np.ndarray[Any, np.dtype[np.uint8]]:
    """A hill before a hazy ridge, whose levels burn out with the sky at twice the light."""
    rng = np.random.default_rng(3)
    levels = np.full((HEIGHT, WIDTH, 3), 245.0)
    levels[RIDGE_ROW:] = 190.0
    levels[HILL_ROW:] = 50.0
    noisy = levels * light ** (1 / 2.2) + rng.normal(0.0, 2.0, levels.shape)
    return np.clip(noisy, 0.0, 255.0).astype(np.uint8)


class Told:
    """An overexposed camera (twice the light) with a settable exposure."""

    name = "camera"
    exposure_is_settable = True

    def __init__(self, broken: bool = False) -> None:
        self.told: list[float] = []
        self._broken = broken

    def expose(self, ev: float) -> None:
        self.told.append(ev)
        if self._broken:
            raise TransientError("camera", "takes no exposure", "check it")

    def exposure_settled_at_s(self) -> float:
        return 0.0

    def frames_after(self, moment_s: float, count: int) -> list[TimedFrame]:
        return [TimedFrame(view(2.0 * 2.0 ** self.told[-1]), 0.0, Instant.now())] * count


def burnt() -> Pictures:
    return pictures_of([TimedFrame(view(2.0), 0.0, Instant.now())])


def ridge_row(pictures: Pictures) -> float:
    return float(np.nanmedian(pictures.skyline.row_px))


def test_only_a_burnt_out_sky_counts() -> None:
    assert overexposed_share(view(2.0), find_skyline(view(2.0))) > 0.9
    assert overexposed_share(view(0.9), find_skyline(view(0.9))) < OVEREXPOSED_LIMIT


def test_the_ridge_comes_back_in_a_darker_picture() -> None:
    camera: Any = Told()
    usual = burnt()
    assert abs(ridge_row(usual) - RIDGE_ROW) > 20, "the burnt picture shows the hill for the skyline"
    with collecting() as notes:
        found = bracketed(camera, usual)
    assert ridge_row(found) == pytest.approx(RIDGE_ROW, abs=1.0)
    assert camera.told[-1] == 0.0, "left to itself again"
    assert ["its sky is burnt out" in note.problem for note in notes.all()] == [True]


def test_a_camera_that_takes_no_exposure_keeps_its_picture() -> None:
    camera: Any = Told(broken=True)
    usual = burnt()
    with collecting() as notes:
        assert bracketed(camera, usual) is usual
    assert "takes no exposure" in notes.all()[0].problem
    camera.exposure_is_settable = False
    assert bracketed(camera, usual) is usual


@pytest.fixture
def stream() -> Iterator[CameraStream]:
    stream = CameraStream(lambda: view(1.0), rate_hz=30.0)
    yield stream
    stream.close()


def test_the_exposure_of_a_network_camera_is_set_by_url(stream: CameraStream) -> None:
    section = CameraSection(
        source=stream.url,
        exposure_url=stream.exposure_url,
        width_px=WIDTH,
        height_px=HEIGHT,
        fx_px=120.0,
        fy_px=120.0,
        cx_px=79.5,
        cy_px=59.5,
        exposure_settle_s=0.2,
        read_timeout_s=10.0,
    )
    with Camera(section) as camera:
        camera.wait_open()
        usual = camera.frame_after(camera.exposure_settled_at_s()).image_bgr.mean()
        camera.expose(-2.0)
        darker = camera.frame_after(camera.exposure_settled_at_s()).image_bgr.mean()
        assert darker == pytest.approx(usual * 2.0 ** (-2.0 / 2.2), rel=0.05)
    elsewhere = section.model_copy(update={"exposure_url": stream.url.replace("stream", "{ev}")})
    with Camera(elsewhere) as camera:
        camera.wait_open()
        with pytest.raises(TransientError, match="takes no exposure"):
            camera.expose(-1.0)


class Driver:
    """A V4L2 camera's controls."""

    def __init__(self) -> None:
        self.values = {cv2.CAP_PROP_EXPOSURE: 160.0, cv2.CAP_PROP_AUTO_EXPOSURE: float(V4L2_AUTOMATIC)}

    def get(self, control: int) -> float:
        return self.values.get(control, math.nan)

    def set(self, control: int, value: float) -> bool:
        self.values[control] = value
        return True


def test_the_exposure_of_a_local_camera_is_set_by_its_driver() -> None:
    driver: Any = Driver()
    exposure = LocalExposure(driver)
    exposure.set(-1.0)
    exposure.set(-2.0)
    assert driver.values == {cv2.CAP_PROP_EXPOSURE: 40.0, cv2.CAP_PROP_AUTO_EXPOSURE: V4L2_MANUAL}
    exposure.set(0.0)
    assert driver.values[cv2.CAP_PROP_AUTO_EXPOSURE] == V4L2_AUTOMATIC
