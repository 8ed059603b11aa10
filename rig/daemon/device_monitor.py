"""Probes every device between captures and updates the daemon state; failed ones are probed again with back-off."""

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import structlog

from rig import timebase
from rig.config.model import RigConfig
from rig.daemon.device_locks import ALL, DeviceLocks
from rig.daemon.readiness import NEEDED
from rig.daemon.servo_restarts import ServoRestarts, restart_servos
from rig.daemon.state import DaemonState
from rig.errors import RigError
from rig.watch.sources import Opener, sources_of

__all__ = ["DeviceMonitor", "all_tried", "next_wait_s", "note_device"]

_log = structlog.get_logger(__name__)

POLL_S = 0.25


@dataclass
class _Device:
    opener: Opener
    due_s: float = 0.0
    wait_s: float = 0.0


class DeviceMonitor:
    """Probes working devices every ``check_every_s``, failed ones with a doubling back-off."""

    def __init__(
        self,
        config: RigConfig,
        daemon_state: DaemonState,
        device_locks: DeviceLocks,
        excluded: tuple[str, ...] = (),
        openers: Mapping[str, Opener] | None = None,
        restarts: ServoRestarts | None = None,
    ) -> None:
        """``excluded`` are devices that another loop monitors."""
        assert config.run
        self._run = config.run
        self._state = daemon_state
        self._device_locks = device_locks
        openers = sources_of(config) if openers is None else openers
        self._restarts = restarts or ServoRestarts(lambda: restart_servos(config.pan_tilt))
        self._devices = {name: _Device(opener) for name, opener in openers.items() if name not in excluded}
        for name in ALL:
            if name in openers:
                daemon_state.set_device(name, "connecting", "")
            else:
                daemon_state.set_device(name, "absent", "not in the configuration")

    def run(self, beat: Callable[[], None], stop: threading.Event) -> None:
        """Probe until ``stop``."""
        while not stop.is_set():
            beat()
            now_s = timebase.monotonic_s()
            for name, device in self._devices.items():
                if device.due_s <= now_s and not self._device_locks.wanted and not stop.is_set():
                    self._probe(name, device)
                    beat()
            timebase.wait(stop, POLL_S)

    def probe_now(self) -> None:
        """Probe all devices at the next opportunity, after a failure."""
        for device in self._devices.values():
            device.due_s = 0.0

    def capture_succeeded(self) -> None:
        """A capture has just used the devices successfully: no probe is due."""
        self._restarts.capture_succeeded()
        due_s = timebase.monotonic_s() + self._run.check_every_s
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
                    self._on_hardware_error(device, warnings)
                    return
        except RigError as error:
            self._failed(name, device, str(error))
            return
        if name == "head":
            self._restarts.healthy()
        device.wait_s = 0.0
        device.due_s = timebase.monotonic_s() + self._run.check_every_s
        note_device(
            self._state, name, None, f"{source.identity}; {warnings}" if warnings else source.identity
        )

    def _on_hardware_error(self, device: _Device, errors: str) -> None:
        restarted = self._restarts.hardware_error_seen()
        if restarted:
            self._state.count("servo restarts", len(restarted))
            device.wait_s = 0.0
        elif self._restarts.exhausted:
            errors += "; restarted in vain: remove the cause, then power-cycle the servos"
        self._failed("head", device, errors)

    def _failed(self, name: str, device: _Device, problem: str) -> None:
        device.wait_s = next_wait_s(device.wait_s, self._run.retry_least_s, self._run.retry_most_s)
        device.due_s = timebase.monotonic_s() + device.wait_s
        note_device(self._state, name, problem, "")


def next_wait_s(wait_s: float, least_s: float, most_s: float) -> float:
    """The next back-off: doubled, within limits."""
    return min(max(2.0 * wait_s, least_s), most_s)


def note_device(daemon_state: DaemonState, name: str, problem: str | None, identity: str) -> None:
    """Update a device in the daemon state; log a change."""
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
    """Whether every device has been probed once."""
    return all(d.state != "connecting" for d in daemon_state.snapshot().devices if d.name in ALL)
