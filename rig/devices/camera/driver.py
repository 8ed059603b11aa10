"""Camera driver: OpenCV's VideoCapture, read continuously by a thread.

Drivers, sockets and OpenCV buffer seconds of frames for a slow reader, so that an occasional reader gets frames from
before the head moved. Here a thread reads every frame at once, and callers get only frames that arrived after a given
time.
"""

import atexit
import http.client
import math
import os
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from types import TracebackType
from typing import Any, Self
from weakref import WeakKeyDictionary

# FFmpeg prints its own messages on failure; ours is the one for the operator. Read at first use.
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")

import cv2
import numpy as np
from numpy.typing import NDArray

from rig import event_bus, timebase
from rig.clock import Instant
from rig.config.camera_url import shown, without_secrets
from rig.config.sections import CameraSection
from rig.devices.camera.exposure import V4L2_AUTOMATIC as V4L2_AUTOMATIC
from rig.devices.camera.exposure import V4L2_MANUAL as V4L2_MANUAL
from rig.devices.camera.exposure import FixedControl, FixedControls
from rig.devices.camera.exposure import LocalExposure as LocalExposure
from rig.devices.camera.frames import Image, TimedFrame, is_newer
from rig.devices.camera.http import UnusableUrlError, get
from rig.devices.camera.source import Snapshots, gives_snapshots, is_http, why_not_opened
from rig.devices.camera.v4l2_settings import V4l2Settings
from rig.errors import DeviceError, TransientError
from rig.fault_notes import note_fault

BLOCKED_GRAB_S = 0.004
"""A grab that took longer had to wait: its frame arrived after the call."""
THREAD_END_S = 2.0
REOPEN_PAUSE_S = 0.2

_blocked_threads: WeakKeyDictionary[threading.Thread, float] = WeakKeyDictionary()
"""Threads that outlived their camera, and until when (monotonic) OpenCV's own timeouts may block them."""


@atexit.register
def _join_blocked_threads() -> None:
    """Wait for blocked threads at exit: Python kills them, and OpenCV then aborts the whole program."""
    for thread, until_s in list(_blocked_threads.items()):
        thread.join(max(0.0, until_s - time.monotonic()))


class Camera:
    """The camera's newest frames, which a thread reads; leaving a ``with`` block ends it.

    Opening goes on in the thread: ``wait_open`` waits for it and checks the size. A stream that ends later is opened
    again, and again.

    Parameters
    ----------
    section : CameraSection
        ``[camera]`` of a configuration: source, size, intrinsics.

    Raises
    ------
    TransientError
        Of each method that waits: the camera is silent.
    DeviceError
        Of each method that waits: the camera cannot be opened, or delivers another size than configured.

    Examples
    --------
    >>> import rig, time
    >>> config = rig.load_config(config_file)  # config_file = "vehicle.toml"
    >>> with rig.Camera(config.camera) as camera:
    ...     camera.wait_open()
    ...     frame = camera.frame_after(time.monotonic())  # nothing that was exposed before
    >>> frame.image_bgr.shape
    (120, 160, 3)
    """

    def __init__(self, section: CameraSection) -> None:
        self._section = section
        self._source = shown(section.source)  # without a password
        self.name = f"camera {self._source}"
        self._changed = threading.Condition()
        self._stop = threading.Event()
        self._failure: DeviceError | None = None
        self._newest: TimedFrame | None = None
        self._count = 0
        self._first_at_s = math.nan
        self._wanted_ev = 0.0
        self._is_local = section.is_local
        self._gives_snapshots = False
        self._thread = threading.Thread(target=self._read, name=self.name, daemon=True)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def wait_open(self) -> None:
        """Wait for the first frame."""
        wait_s = self._section.open_timeout_s + self._section.read_timeout_s
        self._wait(lambda frame: True, wait_s, f"gave no frame within {wait_s:g} s of being opened")

    def identify(self) -> str:
        """Source and size."""
        return f"{self._source}, {self._section.width_px} x {self._section.height_px} px"

    @property
    def frame_rate_hz(self) -> float:
        """Mean frame rate since the first frame; NaN before the second."""
        with self._changed:
            newest, count = self._newest, self._count
        if newest is None or count < 2:
            return math.nan
        return (count - 1) / (newest.arrived.monotonic_s - self._first_at_s)

    @property
    def exposure_is_settable(self) -> bool:
        """Whether the exposure can be set."""
        return self._is_local or self._section.exposure_url is not None

    def expose(self, ev: float) -> None:
        """Expose by so many stops more than the camera does of itself.

        Parameters
        ----------
        ev : float
            Stops; 0 leaves it to the camera again.

        Raises
        ------
        TransientError
            A network camera does not take it.
        """
        self._wanted_ev = ev  # set on a local camera by the reading thread
        url = self._section.exposure_url
        if url is not None and not self._is_local:
            self._set_network_exposure(url, ev)

    def _set_network_exposure(self, url: str, ev: float) -> None:
        """Set the exposure of a network camera. Raises ``TransientError`` if it rejects it."""
        try:
            with get(
                url.replace("{ev}", f"{ev:g}"), self._section.read_timeout_s, "[camera] exposure_url"
            ) as reply:
                reply.read1(4096)  # the rest of the reply is not needed
        except UnusableUrlError as error:
            raise self._error(f"takes no exposure: {error.problem}", error.remedy) from None
        except (OSError, http.client.HTTPException) as error:
            raise self._error(
                f"takes no exposure ({without_secrets(str(error), url)})",
                "check its network and [camera] exposure_url",
            ) from error

    def exposure_settled_at_s(self) -> float:
        """Monotonic time from which pictures show an exposure set now."""
        return timebase.monotonic_s() + self._section.exposure_settle_s

    def frames_after(self, monotonic_s: float, count: int) -> list[TimedFrame]:
        """Frames that arrive no earlier than a moment.

        Parameters
        ----------
        monotonic_s : float
            On ``time.monotonic``'s clock; it may be to come.
        count : int
            How many.

        Returns
        -------
        list of TimedFrame
            In order.

        Raises
        ------
        TransientError
            One does not come within ``[camera] read_timeout_s`` of the last.
        DeviceError
            The camera cannot be opened, or delivers another size than configured.
        """
        frames: list[TimedFrame] = []
        problem = f"has sent no frame for {self._section.read_timeout_s:g} s that is new enough"
        while len(frames) < count:
            last_s = frames[-1].arrived.monotonic_s if frames else -math.inf
            wait_s = max(0.0, monotonic_s - timebase.monotonic_s()) + self._section.read_timeout_s
            frames.append(self._wait(partial(is_newer, monotonic_s, last_s), wait_s, problem))
        return frames

    def frame_after(self, monotonic_s: float) -> TimedFrame:
        """The first frame that arrives no earlier than a moment.

        Parameters
        ----------
        monotonic_s : float
            On ``time.monotonic``'s clock; it may be to come.

        Returns
        -------
        TimedFrame
            With the image, (height, width, 3), blue, green, red.

        Raises
        ------
        TransientError
            None comes within ``[camera] read_timeout_s``.
        DeviceError
            The camera cannot be opened, or delivers another size than configured.
        """
        return self.frames_after(monotonic_s, 1)[0]

    def close(self) -> None:
        """End the thread, restore the exposure and close the camera. A blocked thread is awaited for at most
        ``THREAD_END_S``.
        """
        if self._wanted_ev != 0.0:
            self._restore_auto_exposure()
        self._stop.set()
        self._thread.join(THREAD_END_S)
        if self._thread.is_alive():
            max_wait_s = self._section.open_timeout_s + self._section.read_timeout_s + THREAD_END_S
            _blocked_threads[self._thread] = time.monotonic() + max_wait_s

    def _restore_auto_exposure(self) -> None:
        """Restore automatic exposure of a network camera, whatever was set before; a failure is noted."""
        url = self._section.exposure_url
        if url is None or self._is_local:
            return
        try:
            self._set_network_exposure(url, 0.0)
        except TransientError as error:
            note_fault(error.device, error.problem, "its exposure may have stayed as it was")

    def _wait(self, wanted: Callable[[TimedFrame], bool], wait_s: float, problem: str) -> TimedFrame:
        """The newest frame once ``wanted`` accepts it."""

        def ready() -> bool:
            return self._has_given_up() or (self._newest is not None and wanted(self._newest))

        with self._changed:
            in_time = timebase.wait_for(self._changed, ready, wait_s)
            if self._failure is not None and (self._has_given_up() or not in_time):
                raise self._failure
            if not in_time or self._newest is None:
                raise self._error(problem, "check its cable or network, and that no other program uses it")
            return self._newest

    def _has_given_up(self) -> bool:
        """Whether the thread has given up: the camera never worked, or is not the configured one."""
        if self._failure is None:
            return False
        return self._newest is None or not isinstance(self._failure, TransientError)

    def _error(self, problem: str, remedy: str) -> TransientError:
        return TransientError(self.name, problem, remedy)

    def _read(self) -> None:
        while not self._stop.is_set():
            try:
                self._stream()
            except (DeviceError, cv2.error) as error:
                failure = (
                    error
                    if isinstance(error, DeviceError)
                    else self._error(
                        f"failed: {without_secrets(str(error), self._section.source)}", "restart it"
                    )
                )
                if self._is_snapshot_source():
                    continue
                with self._changed:
                    if self._failure is None or not isinstance(failure, TransientError):
                        self._failure = failure  # keep the original cause, not the failure to reopen
                    over = self._has_given_up()
                    self._changed.notify_all()
                if over:
                    return
                note_fault(failure.device, failure.problem, "opened again")
                timebase.wait(self._stop, REOPEN_PAUSE_S)

    def _stream(self) -> None:
        """Publish frames until stopped. Raises ``DeviceError`` if the stream ends.

        Driver settings are restored in every case.
        """
        with ExitStack() as restores:
            exposure: LocalExposure | None = None
            if self._is_local:  # before opening, so that no picture has another program's zoom
                restores.callback(V4l2Settings(self._section.source, self.name).restore)
            capture = self._open()
            restores.callback(capture.release)
            if self._is_local and not isinstance(capture, Snapshots):
                exposure = LocalExposure(capture, self._section.exposure, self.name)
                restores.callback(exposure.restore)
                exposure.begin()
                restores.callback(FixedControls(capture, self._fixed_controls(), self.name).restore)
            if self._wanted_ev == 0.0:  # a killed program may have left it dark
                self._restore_auto_exposure()
            not_before_s = -math.inf
            while not self._stop.is_set():
                if exposure is not None:
                    exposure.set(self._wanted_ev)
                begun_s, begun_grab_s = timebase.monotonic_s(), time.perf_counter()
                try:
                    grabbed = capture.grab()
                except UnusableUrlError as error:
                    raise self._error(f"gives no picture: {error.problem}", error.remedy) from None
                if not grabbed:
                    raise self._error(
                        f"stopped sending (nothing for {self._section.read_timeout_s:g} s, or it closed the stream)",
                        "check its power and cable or network",
                    )
                arrived = Instant.now()
                if time.perf_counter() - begun_grab_s > BLOCKED_GRAB_S:
                    not_before_s = begun_s
                ok, image = capture.retrieve()
                if not ok:
                    raise self._error("sent a frame that cannot be decoded", "check cable and format")
                self._publish(TimedFrame(self._checked(np.asarray(image)), not_before_s, arrived))

    def _publish(self, frame: TimedFrame) -> None:
        with self._changed:
            if self._newest is None:
                self._first_at_s = frame.arrived.monotonic_s
            self._newest = frame
            self._failure = None
            self._count += 1
            self._changed.notify_all()
        event_bus.publish(frame)

    def _is_snapshot_source(self) -> bool:
        """Whether the address delivers single pictures instead of a stream; each is then requested."""
        source = self._section.source
        if self._gives_snapshots or self._count > 1 or not is_http(source):
            return False
        self._gives_snapshots = gives_snapshots(str(source))
        return self._gives_snapshots

    def _open(self) -> cv2.VideoCapture | Snapshots:
        section = self._section
        if self._gives_snapshots:
            return Snapshots(str(section.source), section.read_timeout_s)
        cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
        if self._is_local:
            capture = cv2.VideoCapture(section.source, cv2.CAP_V4L2)
            if (
                section.fourcc is not None and capture.isOpened()
            ):  # before the size: some sizes exist in one format only
                self._request_pixel_format(capture, section.fourcc)
            # Only requested: the actual frame size is checked.
            capture.set(cv2.CAP_PROP_FRAME_WIDTH, section.width_px)
            capture.set(cv2.CAP_PROP_FRAME_HEIGHT, section.height_px)
        else:
            timeouts_ms = [
                cv2.CAP_PROP_OPEN_TIMEOUT_MSEC,
                round(section.open_timeout_s * 1000),
                cv2.CAP_PROP_READ_TIMEOUT_MSEC,
                round(section.read_timeout_s * 1000),
            ]
            capture = cv2.VideoCapture(section.source, cv2.CAP_FFMPEG, timeouts_ms)
        if not capture.isOpened():
            capture.release()
            raise self._error(*why_not_opened(section.source))
        return capture

    def _request_pixel_format(self, capture: cv2.VideoCapture, fourcc: str) -> None:
        code = cv2.VideoWriter.fourcc(*fourcc)
        capture.set(cv2.CAP_PROP_FOURCC, code)
        has = int(capture.get(cv2.CAP_PROP_FOURCC))
        if has != code:
            capture.release()
            named = has.to_bytes(4, "little", signed=has < 0).decode("ascii", "replace").strip("\0")
            raise DeviceError(
                self.name,
                f"does not give [camera] fourcc {fourcc!r} (it gives {named!r})",
                "see what it gives with v4l2-ctl --list-formats-ext, or leave the key away",
            )

    def _fixed_controls(self) -> tuple[FixedControl, ...]:
        section = self._section
        controls = (
            ("gain", cv2.CAP_PROP_GAIN, section.gain, None),
            ("white_balance_k", cv2.CAP_PROP_WB_TEMPERATURE, section.white_balance_k, cv2.CAP_PROP_AUTO_WB),
            ("focus", cv2.CAP_PROP_FOCUS, section.focus, cv2.CAP_PROP_AUTOFOCUS),
        )
        return tuple(
            FixedControl(key, property_id, value, automatic_id)
            for key, property_id, value, automatic_id in controls
            if value is not None
        )

    def _checked(self, image: NDArray[Any]) -> Image:
        height, width = image.shape[:2]
        wanted = self._section.width_px, self._section.height_px
        if (width, height) != wanted or image.ndim != 3:
            raise DeviceError(
                self.name,
                f"sends {width} x {height} px, but the intrinsics are for {wanted[0]} x {wanted[1]}",
                "set the camera to that size, or [camera] to a calibration of this one",
            )
        return np.asarray(image, np.uint8)
