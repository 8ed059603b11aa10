"""One capture of the daemon: free space in the spool, all devices, then a bundle or the reason for its failure."""

import logging
from collections.abc import Callable

import structlog

from rig import timebase
from rig.capture.sequence import capture
from rig.config.model import RigConfig
from rig.daemon.device_locks import DeviceLocks
from rig.daemon.device_monitor import DeviceMonitor
from rig.daemon.odometry.receiver import Odometer
from rig.daemon.signals import Signals, StopRequestedError
from rig.daemon.spool.store import Spool, SpoolError, SpoolFullError
from rig.daemon.state import DaemonState, TriggerSource
from rig.devices.connect import open_pan_tilt
from rig.errors import RigError

_log = structlog.get_logger(__name__)


class _Steps:
    """Writes a capture's steps to the log; each one is a heartbeat."""

    def __init__(self, beat: Callable[[], None]) -> None:
        self._beat = beat

    def doing(self, what: str) -> None:
        self._beat()

    def done(self, what: str) -> None:
        self._beat()
        _log.info("capture goes on", step=what)


class Captures:
    """Takes bundles into the spool, in the main thread, where signals arrive."""

    def __init__(
        self,
        config: RigConfig,
        daemon_state: DaemonState,
        spool: Spool,
        signals: Signals,
        device_locks: DeviceLocks,
        watch: DeviceMonitor,
        odometer: Odometer | None,
    ) -> None:
        self._config = config
        self._state = daemon_state
        self._spool = spool
        self._signals = signals
        self._device_locks = device_locks
        self._watch = watch
        self._odometer = odometer

    def take(self, source: TriggerSource, beat: Callable[[], None]) -> str | None:
        """Take a capture and return the new bundle's id; after a failure None, with the reason in daemon state and log."""
        begun_s = timebase.monotonic_s()
        try:
            with self._signals.deferring_stop():
                self._make_room()
                self._note(source, begun_s)
        except SpoolError as error:
            self._ended("refused", source, str(error))
            return None
        self._state.set_activity("capturing")
        self._state.emit("capture", stage="begun", trigger=source)
        reason: str | None = None
        try:
            with self._device_locks.all():
                capture(
                    self._config,
                    self._config.capture.parsed_directions(),
                    self._spool.bundles_dir,
                    _Steps(beat),
                    park=True,
                    skip_failed_sensors=True,
                )
        except RigError as error:
            reason = str(error)
        except StopRequestedError:
            self._ensure_safe_state(source)
            raise
        with self._signals.deferring_stop():
            bundle = self._register_bundle()
            if bundle is None:
                if self._odometer:
                    self._odometer.undo_capture()
                self._ended("failed", source, reason or "no bundle was left")
                self._watch.probe_now()
            else:
                if self._odometer:
                    self._odometer.keep()
                self._watch.capture_succeeded()
                self._state.count("captures done")
                self._state.emit("capture", stage="done", trigger=source, bundle=bundle)
                _log.info(
                    "captured",
                    bundle=bundle,
                    trigger=source,
                    seconds=round(timebase.monotonic_s() - begun_s, 1),
                )
        return bundle

    def _note(self, source: TriggerSource, begun_s: float) -> None:
        if self._odometer is None:
            self._spool.begin_capture(source, None)
            return
        leg = self._odometer.begin(begun_s)
        try:
            self._spool.begin_capture(source, leg, self._odometer.to_json())
        except SpoolError:
            self._odometer.undo_capture()
            raise

    def _make_room(self) -> None:
        try:
            removed = self._spool.make_room()
        except SpoolFullError:
            self._state.count("spool full")
            raise
        for bundle in removed:
            self._state.count("bundles deleted")
            _log.info("deleted for the quota", bundle=bundle)

    def _register_bundle(self) -> str | None:
        try:
            return self._spool.end_capture()
        except SpoolError as error:  # it is in the folder; the next ``reconcile`` registers it
            _log.error("spool fails", problem=str(error))
            if self._odometer:  # unknown whether the leg starts at this capture or the previous one
                self._odometer.mark_unknown()
            return None

    def _ended(self, stage: str, source: TriggerSource, reason: str, level: int = logging.ERROR) -> None:
        self._state.count(f"captures {stage}")
        self._state.emit("capture", stage=stage, trigger=source, reason=reason)
        _log.log(level, f"capture {stage}", trigger=source, reason=reason)

    def interrupted(self, source: TriggerSource) -> None:
        """Record that the capture was interrupted by the end of the daemon, which is no error."""
        self._ended("interrupted", source, "the daemon ends", logging.WARNING)

    def _ensure_safe_state(self, source: TriggerSource) -> None:
        """After a stop at any moment: ensure that the torque is off, and that a complete bundle is registered."""
        try:
            with open_pan_tilt(self._config.pan_tilt):
                pass
        except RigError as error:
            _log.error("head may be held", problem=str(error))
        bundle = self._register_bundle()
        if bundle is None:
            self.interrupted(source)
        else:
            if self._odometer:
                self._odometer.keep()
            self._state.count("captures done")
            _log.info("captured", bundle=bundle, trigger=source)
