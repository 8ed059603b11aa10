"""Asks every device between captures whether it is there, and says so on the board; one that is missing is asked again."""

import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

import structlog

from rig.config.model import RigConfig
from rig.daemon.readiness import NEEDED, obstacle
from rig.daemon.servo_restarts import ServoRestarts, restart_servos
from rig.daemon.state import DaemonState
from rig.errors import RigError
from rig.watch.sources import Opener, sources_of

__all__ = ["DeviceLocks", "DeviceMonitor", "all_tried", "next_wait_s", "note_device", "obstacle"]

_log = structlog.get_logger(__name__)

ALL = ("head", "inclinometer", "compass", "altimeter", "camera")
POLL_S = 0.25


class DeviceLocks:
    """Who may use which device: one at a time. A capture takes all of them, and others let go when one is wanted."""

    def __init__(self) -> None:
        self._locks = {name: threading.Lock() for name in ALL}
        self._wanted = threading.Event()

    @contextmanager
    def one(self, name: str) -> Iterator[None]:
        """Use one device; not to be held for longer than it takes to read it once ``wanted``."""
        while self._wanted.is_set():
            time.sleep(POLL_S)
        with self._locks[name]:
            yield

    @property
    def wanted(self) -> bool:
        """Whether a capture waits for the devices, or has them."""
        return self._wanted.is_set()

    @contextmanager
    def all(self) -> Iterator[None]:
        """Use all of them, as soon as the others have let go."""
        self._wanted.set()
        try:
            with ExitStack() as stack:
                for name in ALL:
                    stack.enter_context(self._locks[name])
                yield
        finally:
            self._wanted.clear()


@dataclass
class _Device:
    opener: Opener
    due_s: float = 0.0
    wait_s: float = 0.0


class DeviceMonitor:
    """Probes each device when it is due: working ones every ``check_every_s``, others after waits that double."""

    def __init__(
        self,
        config: RigConfig,
        daemon_state: DaemonState,
        device_locks: DeviceLocks,
        besides: tuple[str, ...] = (),
        openers: Mapping[str, Opener] | None = None,
        restarts: ServoRestarts | None = None,
    ) -> None:
        """``besides`` are devices that somebody else watches."""
        assert config.run
        self._run = config.run
        self._state = daemon_state
        self._device_locks = device_locks
        openers = sources_of(config) if openers is None else openers
        self._restarts = restarts or ServoRestarts(lambda: restart_servos(config.pan_tilt))
        self._devices = {name: _Device(opener) for name, opener in openers.items() if name not in besides}
        for name in ALL:
            if name in openers:
                daemon_state.set_device(name, "connecting", "")
            else:
                daemon_state.set_device(name, "absent", "not in the configuration")

    def run(self, beat: Callable[[], None], stop: threading.Event) -> None:
        """Probe until ``stop``."""
        while not stop.is_set():
            beat()
            now_s = time.monotonic()
            for name, device in self._devices.items():
                if device.due_s <= now_s and not self._device_locks.wanted and not stop.is_set():
                    self._probe(name, device)
                    beat()
            stop.wait(POLL_S)

    def soon(self) -> None:
        """Probe everything at the next opportunity: something has failed."""
        for device in self._devices.values():
            device.due_s = 0.0

    def worked(self) -> None:
        """A capture has just used what it needs: nothing is due."""
        self._restarts.worked()
        due_s = time.monotonic() + self._run.check_every_s
        for name, device in self._devices.items():
            if name in NEEDED:
                device.due_s = due_s

    def _probe(self, name: str, device: _Device) -> None:
        try:
            with self._device_locks.one(name):
                with device.opener() as source:
                    reading = source.read()
                warnings = "; ".join(reading.warnings)
                if name == "head" and warnings:  # of a hardware error: it will not move
                    self._hindered(device, warnings)
                    return
        except RigError as error:
            self._failed(name, device, str(error))
            return
        if name == "head":
            self._restarts.fine()
        device.wait_s = 0.0
        device.due_s = time.monotonic() + self._run.check_every_s
        note_device(
            self._state, name, None, f"{source.identity}; {warnings}" if warnings else source.identity
        )

    def _hindered(self, device: _Device, errors: str) -> None:
        restarted = self._restarts.hindered()
        if restarted:
            self._state.count("servo restarts", len(restarted))
            device.wait_s = 0.0
        elif self._restarts.exhausted:
            errors += "; restarted in vain: remove the cause, then power-cycle the servos"
        self._failed("head", device, errors)

    def _failed(self, name: str, device: _Device, problem: str) -> None:
        device.wait_s = next_wait_s(device.wait_s, self._run.retry_least_s, self._run.retry_most_s)
        device.due_s = time.monotonic() + device.wait_s
        note_device(self._state, name, problem, "")


def next_wait_s(wait_s: float, least_s: float, most_s: float) -> float:
    """Doubled, within limits."""
    return min(max(2.0 * wait_s, least_s), most_s)


def note_device(daemon_state: DaemonState, name: str, problem: str | None, identity: str) -> None:
    """Put a device's state on the board, and into the log where it has changed."""
    before = {device.name: device for device in daemon_state.snapshot().devices}.get(name)
    if problem is not None:
        daemon_state.set_device(name, "failing", problem)
        if before is None or (before.state, before.detail) != ("failing", problem):
            _log.warning("device fails", device=name, problem=problem)
    else:
        daemon_state.set_device(name, "ok", identity)
        if before is None or before.state != "ok":
            _log.info("device works", device=name, identity=identity)


def all_tried(daemon_state: DaemonState) -> bool:
    """Whether every device has been asked once, and is known to work or not to."""
    return all(d.state != "connecting" for d in daemon_state.snapshot().devices if d.name in ALL)
