"""The camera over a real MJPEG stream: fresh frames, and clear errors."""

import socket
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from fakes.mjpeg_camera import mjpeg_server

from rig.clock import Instant
from rig.config.sections import CameraSection
from rig.devices.camera.driver import Camera
from rig.devices.camera.frames import TimedFrame, average
from rig.errors import DeviceError

LIFE = time.monotonic()


def section(source: str, **changes: object) -> CameraSection:
    values = {
        "source": source,
        "width_px": 64,
        "height_px": 48,
        "fx_px": 50.0,
        "fy_px": 50.0,
        "cx_px": 31.5,
        "cy_px": 23.5,
        "open_timeout_s": 2.0,
        "read_timeout_s": 0.6,
    }
    return CameraSection.model_validate(values | changes)


def clock_picture() -> np.ndarray:
    """A picture of a clock: the time of its making in hundredths of a second, as grey level of its two halves."""
    hundredths = int((time.monotonic() - LIFE) * 100)
    image = np.zeros((48, 64, 3), np.uint8)
    image[:, :32] = (hundredths // 16) % 16 * 16 + 8
    image[:, 32:] = hundredths % 16 * 16 + 8
    return image


def shown_s(frame: TimedFrame) -> float:
    """When the picture was made, on the monotonic clock (modulo 2.56 s, taken nearest to its arrival)."""
    high, low = (int(frame.image_bgr[24, col].mean()) // 16 for col in (16, 48))
    phase = (high * 16 + low) / 100
    age = ((frame.arrived.monotonic_s - LIFE) - phase) % 2.56
    return frame.arrived.monotonic_s - age


def test_frames_are_not_older_than_asked() -> None:
    with mjpeg_server(clock_picture) as server, Camera(section(server.url)) as camera:
        camera.wait_open()
        for _ in range(5):
            moment = time.monotonic()
            frame = camera.frame_after(moment)
            assert frame.not_before_s >= moment
            assert shown_s(frame) > moment - 0.05
            time.sleep(0.07)
        assert 0.0 < camera.frame_rate_hz < 30.0, "25 where the computer keeps up"


def test_a_reader_that_was_held_up_does_not_hand_out_what_piled_up() -> None:
    held = threading.Event()

    class HeldUp(Camera):
        def _publish(self, frame: TimedFrame) -> None:
            if held.is_set():
                time.sleep(1.0)
                held.clear()
            super()._publish(frame)

    with mjpeg_server(clock_picture) as server, HeldUp(section(server.url, read_timeout_s=3.0)) as camera:
        camera.wait_open()
        held.set()
        time.sleep(0.9)
        moment = time.monotonic()
        assert shown_s(camera.frame_after(moment)) > moment - 0.05


def test_a_moment_to_come_is_waited_for() -> None:
    with mjpeg_server(clock_picture) as server, Camera(section(server.url)) as camera:
        camera.wait_open()
        moment = time.monotonic() + 0.3
        frames = camera.frames_after(moment, 3)
        assert len(frames) == 3
        assert all(frame.not_before_s >= moment for frame in frames)
        assert frames[0].arrived.monotonic_s < frames[1].arrived.monotonic_s


def test_closed_port() -> None:
    with Camera(section("http://127.0.0.1:9/stream.mjpg")) as camera, pytest.raises(DeviceError) as caught:
        camera.wait_open()
    assert str(caught.value) == (
        "camera http://127.0.0.1:9/stream.mjpg: cannot be opened: the connection is refused: nothing listens on port 9 of "
        "127.0.0.1; switch the camera's stream on, or correct the port in [camera] source"
    )


def test_a_password_is_not_shown() -> None:
    with Camera(section("http://crew:secret@127.0.0.1:9/stream")) as camera:
        assert camera.identify().startswith("http://127.0.0.1:9/stream, ")
        with pytest.raises(DeviceError, match=r"^camera http://127\.0\.0\.1:9/stream: cannot be opened"):
            camera.wait_open()


def test_absent_video_device() -> None:
    with (
        Camera(section("/dev/video99")) as camera,
        pytest.raises(DeviceError, match="/dev/video99: cannot be opened"),
    ):
        camera.wait_open()


def test_a_stream_that_stalls() -> None:
    with mjpeg_server(clock_picture) as server, Camera(section(server.url)) as camera:
        camera.wait_open()
        server.stall.set()
        time.sleep(0.1)
        begun = time.monotonic()
        with pytest.raises(DeviceError, match=r"(stopped sending|has sent no frame)"):
            camera.frame_after(time.monotonic())
        assert time.monotonic() - begun < 1.5


def test_another_size_than_configured() -> None:
    sizes = "sends 64 x 48 px, but the intrinsics are for 80 x 48; set the camera"
    with (
        mjpeg_server(clock_picture) as server,
        Camera(section(server.url, width_px=80)) as camera,
        pytest.raises(DeviceError, match=sizes),
    ):
        camera.wait_open()


def test_the_thread_ends_with_the_camera() -> None:
    with mjpeg_server(clock_picture) as server:
        with Camera(section(server.url)) as camera:
            camera.wait_open()
        assert not any(thread.name.startswith("camera") for thread in threading.enumerate())


def test_averaging_rounds_to_nearest() -> None:
    def frame(level: int) -> TimedFrame:
        return TimedFrame(np.full((2, 2, 3), level, np.uint8), 0.0, Instant.now())

    assert average([frame(100), frame(101), frame(101)])[0, 0, 0] == 101
    assert average([frame(100), frame(100), frame(101)])[0, 0, 0] == 100
    assert average([frame(255)] * 4).dtype == np.uint8


A_PROGRAM_THAT_ENDS = """
import sys, time
from rig.devices.camera import driver
from rig.config.sections import CameraSection
driver.THREAD_END_S = 0.1
hanging = driver.Camera(CameraSection.model_validate_json(sys.argv[1]))
time.sleep(0.3)
hanging.close()
sys.exit(2)
"""


def test_a_program_with_a_camera_that_hangs_ends_as_it_wants_to() -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        hanging = section(f"http://127.0.0.1:{silent.getsockname()[1]}/stream.mjpg", open_timeout_s=3.0)
        done = subprocess.run(
            [sys.executable, "-c", A_PROGRAM_THAT_ENDS, hanging.model_dump_json()],
            capture_output=True,
            text=True,
            check=False,
        )
    assert (done.returncode, done.stderr) == (2, "")
