"""The daemon's main thread with one configuration: captures, and housekeeping between them."""

import queue
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import structlog

from localizer.errors import SkyfixError
from rig import clock, timebase
from rig.config.load import EXAMPLE, load_config
from rig.config.model import RigConfig
from rig.config.run import RunSection
from rig.daemon.captures import Captures
from rig.daemon.device_monitor import all_tried
from rig.daemon.memory import release_free_heap
from rig.daemon.named_files import check_named_files
from rig.daemon.notify import Notifier
from rig.daemon.odometry.receiver import Odometer
from rig.daemon.readiness import why_not_ready
from rig.daemon.search.answers import restore
from rig.daemon.search.locate_loop import LocateLoop
from rig.daemon.search.process import SearchProcess
from rig.daemon.spool.store import ODOMETER, Spool, SpoolError
from rig.daemon.state import DaemonState, Snapshot, TriggerSource
from rig.daemon.triggers import Triggers
from rig.errors import ConfigError

_log = structlog.get_logger(__name__)

POLL_S = 0.25
CLOCK_STEP_S = 1.0
ODOMETER_EVERY_S = 5.0
TRYING_S, COMPILING_S = 30.0, 120.0
"""Limits of the start: for probing the devices, and for compiling kernels."""

MainLoopRequest = TriggerSource | Literal["reload"] | BaseException
"""A capture to take, a configuration to reload, or an error to end with."""
RequestQueue = queue.SimpleQueue[MainLoopRequest]
"""Requests of other loops to the main thread."""


@dataclass(frozen=True)
class NextConfiguration:
    """The next configuration, and a search process with its DEM loaded if that differs."""

    config: RigConfig
    worker: SearchProcess | None


def run_of(config: RigConfig, path: Path) -> RunSection:
    """``[run]`` of a configuration. ``ConfigError`` where there is none."""
    if config.run is None:
        raise ConfigError(f"{path}: has no [run]: rig run needs at least its dem (example: {EXAMPLE})")
    return config.run


def start_worker(run: RunSection) -> SearchProcess:
    """Start a search process, which then loads its DEM."""
    return SearchProcess(run.dem, run.search.memory_mb, run.search.time_s, chosen_dem=run.chosen_dem)


def _searched(run: RunSection) -> tuple[object, ...]:
    """The parameters of a search process."""
    return run.chosen_dem, run.search


def loaded_worker(run: RunSection, beat: Callable[[], None]) -> SearchProcess:
    """A search process with its DEM loaded. ``SearchFailedError`` if that fails."""
    worker = start_worker(run)
    worker.beat = beat
    try:
        worker.wait_terrain()
    except BaseException:
        worker.close()
        raise
    return worker


class MainLoop:
    """Runs until the configuration is reloaded."""

    def __init__(
        self,
        run: RunSection,
        path: Path,
        daemon_state: DaemonState,
        notifier: Notifier,
        triggers: Triggers,
        captures: Captures,
        search: LocateLoop,
        spool: Spool,
        odometer: Odometer | None,
        requests: RequestQueue,
    ) -> None:
        self._run = run
        self._path = path
        self._state = daemon_state
        self._notifier = notifier
        self._triggers = triggers
        self._captures = captures
        self._search = search
        self._spool = spool
        self._odometer = odometer
        self._requests = requests
        self._odometer_saved = ""
        self._odometer_due_s = 0.0
        self._status = ""

    def run(self, beat: Callable[[], None], started: Callable[[], None]) -> NextConfiguration:
        """Take captures on request. Raises the error of any other loop that ended.

        ``started`` is called when the DEM is loaded, all devices have been probed, and the kernels for pictures are
        compiled elsewhere (in this process they would keep 60 MB): from then on captures can be requested. It waits at
        most ``TRYING_S`` for devices and ``COMPILING_S`` for kernels. Raises ``SearchFailedError`` before that if the
        DEM cannot be used.
        """
        self._state.set_activity("connecting")
        connecting, begun_s = True, timebase.monotonic_s()
        due_s = timebase.monotonic_s() if self._run.every_s else None
        while True:
            beat()
            if connecting and self._search.terrain.done():
                self._search.terrain.result()
                waited_s = timebase.monotonic_s() - begun_s
                tried = all_tried(self._state) or waited_s > TRYING_S
                if tried and (self._search.pictures.done() or waited_s > COMPILING_S):
                    connecting = False
                    self._state.set_activity("idle")
                    started()
            self._between_captures()
            if (
                due_s is not None
                and not connecting
                and timebase.monotonic_s() >= due_s
                and why_not_ready(self._state) is None
            ):
                assert self._run.every_s
                self._triggers.trigger("interval")
                due_s = max(due_s + self._run.every_s, timebase.monotonic_s())
            try:
                request = self._requests.get(timeout=POLL_S)
            except queue.Empty:
                continue
            if isinstance(request, BaseException):
                raise request
            if request == "reload":
                following = self._reload(beat)
                if following is not None:
                    self._triggers.stop()
                    self._take_started(beat)
                    return following
            else:
                self._capture(request, beat)

    def _capture(self, source: TriggerSource, beat: Callable[[], None]) -> None:
        try:
            self._captures.take(source, beat)
        finally:
            self._state.set_activity("idle")
            self._triggers.done()
        self._search.wake()
        release_free_heap()

    def on_shutdown(self) -> None:
        """The daemon ends before a capture that was answered ``started`` began."""
        while (request := pending_request(self._requests)) is not None:
            if request != "reload" and not isinstance(request, BaseException):
                self._captures.interrupted(request)

    def _take_started(self, beat: Callable[[], None]) -> None:
        """Take a capture that was answered ``started`` during a reload, with the present configuration."""
        again = False
        while (request := pending_request(self._requests)) is not None:
            if isinstance(request, BaseException):
                raise request
            if request == "reload":
                again = True  # the file may have changed since it was read
            else:
                self._capture(request, beat)
        if again:
            self._requests.put("reload")

    def _reload(self, beat: Callable[[], None]) -> NextConfiguration | None:
        """Reload the configuration file; None if it is invalid, and the present one stays."""
        self._notifier.reloading()
        try:
            config = load_config(self._path)
            run = run_of(config, self._path)
            same = _searched(run) == _searched(self._run)
            if same:
                return NextConfiguration(config, None)
            check_named_files(run, self._path)
            return NextConfiguration(config, loaded_worker(run, beat))
        except SkyfixError as error:
            refused(self._state, str(error))
            self._notifier.ready(self._status)
            return None

    def _between_captures(self) -> None:
        if abs(clock.step_s()) > CLOCK_STEP_S:
            _log.warning("wall clock stepped", by_s=round(clock.step_s(), 1))
            clock.begin_session()
            try:
                restore(self._state, self._spool)
            except SpoolError as error:
                _log.error("spool fails", problem=str(error))
        status = status_line(self._state.snapshot())
        if status != self._status:
            self._status = status
            self._notifier.status(status)
        if self._odometer and timebase.monotonic_s() >= self._odometer_due_s:
            self._odometer_due_s = timebase.monotonic_s() + ODOMETER_EVERY_S
            state = self._odometer.to_json()
            if state != self._odometer_saved:
                save_odometer(self._spool, self._odometer)
                self._odometer_saved = state


def save_odometer(spool: Spool, odometer: Odometer) -> None:
    """Save the odometer's state for a restart."""
    try:
        spool.remember(ODOMETER, odometer.to_json())
    except SpoolError as error:
        _log.error("spool fails", problem=str(error))


def pending_request(requests: RequestQueue) -> MainLoopRequest | None:
    """The next pending request; None if there is none."""
    try:
        return requests.get_nowait()
    except queue.Empty:
        return None


def refused(daemon_state: DaemonState, problem: str) -> None:
    """Record that a new configuration was refused, and why."""
    daemon_state.count("configurations refused")
    daemon_state.emit("status", configuration="refused", reason=problem)
    _log.error("configuration refused", problem=problem, kept="the one in force")


def status_line(snapshot: Snapshot) -> str:
    """Status line for the service manager: activity, faults, and the last fix with its time (an age would become
    outdated).
    """
    parts: list[str] = [snapshot.activity]
    if wrong := clock.problem():
        parts.append(wrong)
    failing = [device.name for device in snapshot.devices if device.state == "failing"]
    if failing:
        parts.append(f"{', '.join(failing)} failing")
    if snapshot.waiting:
        parts.append(f"{snapshot.waiting} to locate")
    if snapshot.last_fix and snapshot.last_fix.fix.position:
        place, when = snapshot.last_fix.fix.position, snapshot.last_fix.captured.utc
        parts.append(f"fix {place.lat_deg:.5f}, {place.lon_deg:.5f} of {when:%Y-%m-%d %H:%M:%SZ}")
    else:
        parts.append("no fix yet")
    return "; ".join(parts)
