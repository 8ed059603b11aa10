"""Capture trigger for a vehicle that has become stationary, from the accelerometer's noise."""

import math
import threading
from collections.abc import Callable, Sequence
from contextlib import closing
from functools import partial

import numpy as np
import structlog

from rig import timebase
from rig.config.model import RigConfig
from rig.config.run import RestTrigger
from rig.daemon.device_locks import DeviceLocks
from rig.daemon.device_monitor import next_wait_s, note_device
from rig.daemon.state import DaemonState
from rig.devices.bus.retry import retry
from rig.devices.connect import Inclinometer, open_inclinometer
from rig.devices.readings import AccelerationReading
from rig.errors import DeviceError

_log = structlog.get_logger(__name__)

SETTLING_S = 2.0
"""The head may sink when the torque goes off; that is no motion of the vehicle."""
MAX_CAPTURES = 3
"""Failed captures at one stop before the next stop is awaited."""
SAMPLES_A_SECOND = 8
"""Enough for a standard deviation at a low load."""


class StationaryDetector:
    """Detects once that a vehicle that moved has been stationary for long enough (debounced).

    Initially it counts as having moved: there is no capture from here yet.
    """

    def __init__(self, section: RestTrigger) -> None:
        self._section = section
        self._moved = True
        self._failures = 0
        self._still_since_s: float | None = None

    def take(self, noise_mg: float, now_s: float) -> bool:
        """Add the noise over the last second, at a monotonic time. True: it has just become stationary."""
        if noise_mg > self._section.still_mg:
            if not self._moved:
                _log.info("vehicle moves", noise_mg=round(noise_mg, 1))
            self._moved, self._still_since_s, self._failures = True, None, 0
            return False
        if self._still_since_s is None:
            self._still_since_s = now_s
        return self._moved and now_s - self._still_since_s >= self._section.still_s

    def captured(self) -> None:
        """A capture was taken here."""
        self._moved = False

    def failed(self) -> None:
        """The capture failed: retry a limited number of times, as it may be night."""
        self._failures += 1
        self._moved = self._failures < MAX_CAPTURES

    def interrupted(self) -> None:
        """Readings were interrupted: the stationary time starts again."""
        self._still_since_s = None


class StationaryMonitor:
    """Reads the inclinometer between captures, requests a capture when the vehicle is stationary, and reports the
    chip's state.
    """

    def __init__(
        self, config: RigConfig, daemon_state: DaemonState, device_locks: DeviceLocks, ask: Callable[[], bool]
    ) -> None:
        """``ask`` requests a capture and returns whether it was accepted."""
        assert config.run
        assert config.run.rest
        self._section = config.inclinometer
        self._run = config.run
        self._state = daemon_state
        self._device_locks = device_locks
        self._ask = ask
        self._rest = config.run.rest
        self._detector = StationaryDetector(self._rest)
        self._done_before: int | None = None
        """How many captures had been done when one was asked for; None once it is known what came of it."""

    def run(self, beat: Callable[[], None], stop: threading.Event) -> None:
        """Monitor until ``stop``."""
        wait_s = 0.0
        while not stop.is_set():
            beat()
            if self._device_locks.wanted:
                timebase.wait(stop, 0.2)
                continue
            self._detector.interrupted()
            timebase.wait(stop, SETTLING_S)
            try:
                with (
                    self._device_locks.one("inclinometer"),
                    closing(open_inclinometer(self._section)) as chip,
                ):
                    note_device(self._state, "inclinometer", None, chip.identify())
                    wait_s = 0.0
                    self._watch(chip, beat, stop)
            except DeviceError as error:
                note_device(self._state, "inclinometer", str(error), "")
                wait_s = next_wait_s(wait_s, self._run.retry_least_s, self._run.retry_most_s)
                until_s = timebase.monotonic_s() + wait_s
                while timebase.monotonic_s() < until_s and not timebase.wait(stop, 0.5):
                    beat()

    def _captures_done(self) -> int:
        return self._state.snapshot().counts.get("captures done", 0)

    def _watch(self, chip: Inclinometer, beat: Callable[[], None], stop: threading.Event) -> None:
        if self._done_before is not None and self._captures_done() == self._done_before:
            self._detector.failed()
        self._done_before = None
        while not stop.is_set() and not self._device_locks.wanted:
            beat()
            readings: list[AccelerationReading] = []
            for _ in range(SAMPLES_A_SECOND):
                readings += retry(partial(chip.read_many, 0.0))
                if timebase.wait(stop, 1.0 / SAMPLES_A_SECOND) or self._device_locks.wanted:
                    return
            noise = noise_mg(readings)
            if noise > self._rest.still_mg:
                self._state.set_moving()
            if self._detector.take(noise, timebase.monotonic_s()):
                done = self._captures_done()
                if self._ask():
                    self._done_before = done
                    self._detector.captured()


def noise_mg(readings: Sequence[AccelerationReading]) -> float:
    """Standard deviation of the acceleration, all axes together, thousandths of g."""
    vectors = np.array([[r.x_g, r.y_g, math.nan if r.z_g is None else r.z_g] for r in readings])
    return 1000.0 * float(np.sqrt(np.nansum(np.var(vectors, axis=0))))
