"""What the daemon's main thread does with one configuration: captures, and what comes up between them."""

import queue
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import structlog

from localizer.errors import SkyfixError
from rig import clock
from rig.config.load import EXAMPLE, load_config
from rig.config.model import RigConfig
from rig.config.run import RunSection
from rig.daemon.captures import Captures
from rig.daemon.device_watch import all_tried, obstacle
from rig.daemon.memory import give_back
from rig.daemon.named_files import check_named_files
from rig.daemon.notify import Notifier
from rig.daemon.odometry.receiver import Odometer
from rig.daemon.search.loop import Search, restore
from rig.daemon.search.process import SearchProcess
from rig.daemon.spool.spool import ODOMETER, Spool, SpoolError
from rig.daemon.state import Board, Snapshot, TriggerSource
from rig.daemon.triggers import Triggers
from rig.errors import ConfigError

_log = structlog.get_logger(__name__)

POLL_S = 0.25
CLOCK_STEP_S = 1.0
ODOMETER_EVERY_S = 5.0
TRYING_S, COMPILING_S = 30.0, 120.0
"""So long the start waits at most for a device to be tried, and for kernels that have to be compiled."""

Wanted = TriggerSource | Literal["reload"] | BaseException
"""A capture to take, a configuration to read, an error to end with."""
Inbox = queue.SimpleQueue[Wanted]
"""What the other loops have for the main thread."""


@dataclass(frozen=True)
class Following:
    """The next configuration, and a search process that has read its DEM where that is another one."""

    config: RigConfig
    worker: SearchProcess | None


def run_of(config: RigConfig, path: Path) -> RunSection:
    """``[run]`` of a configuration. ``ConfigError`` where there is none."""
    if config.run is None:
        raise ConfigError(f"{path}: has no [run]: rig run needs at least its dem (example: {EXAMPLE})")
    return config.run


def start_worker(run: RunSection) -> SearchProcess:
    """A search process, which has still to read its DEM."""
    return SearchProcess(run.dem, run.search.memory_mb, run.search.time_s, chosen_dem=run.chosen_dem)


def _searched(run: RunSection) -> tuple[object, ...]:
    """What a search process is started with."""
    return run.chosen_dem, run.search


def worker_with_terrain(run: RunSection, beat: Callable[[], None]) -> SearchProcess:
    """A search process that has read its DEM. ``SearchFailedError`` where it cannot."""
    worker = start_worker(run)
    worker.beat = beat
    try:
        worker.wait_terrain()
    except BaseException:
        worker.close()
        raise
    return worker


class MainLoop:
    """Runs until another configuration is asked for."""

    def __init__(
        self,
        run: RunSection,
        path: Path,
        board: Board,
        notifier: Notifier,
        triggers: Triggers,
        captures: Captures,
        search: Search,
        spool: Spool,
        odometer: Odometer | None,
        inbox: Inbox,
    ) -> None:
        self._run = run
        self._path = path
        self._board = board
        self._notifier = notifier
        self._triggers = triggers
        self._captures = captures
        self._search = search
        self._spool = spool
        self._odometer = odometer
        self._inbox = inbox
        self._odometer_saved = ""
        self._odometer_due_s = 0.0
        self._status = ""

    def run(self, beat: Callable[[], None], started: Callable[[], None]) -> Following:
        """Take captures as they are asked for. Raises what another loop ended with.

        ``started`` is called when the DEM has been read, all devices have been tried, and the kernels for pictures need not be
        compiled in this process, which would keep 60 MB for that; so whoever waits for the daemon may ask for a capture then.
        Devices keep it waiting for ``TRYING_S``, kernels for ``COMPILING_S`` at most. Raises ``SearchFailedError`` before that
        where the DEM cannot be used.
        """
        self._board.set_activity("connecting")
        connecting, begun_s = True, time.monotonic()
        due_s = time.monotonic() if self._run.every_s else None
        while True:
            beat()
            if connecting and self._search.terrain.done():
                self._search.terrain.result()
                waited_s = time.monotonic() - begun_s
                tried = all_tried(self._board) or waited_s > TRYING_S
                if tried and (self._search.pictures.done() or waited_s > COMPILING_S):
                    connecting = False
                    self._board.set_activity("idle")
                    started()
            self._between_captures()
            if (
                due_s is not None
                and not connecting
                and time.monotonic() >= due_s
                and obstacle(self._board) is None
            ):
                assert self._run.every_s
                self._triggers.trigger("interval")
                due_s = max(due_s + self._run.every_s, time.monotonic())
            try:
                wish = self._inbox.get(timeout=POLL_S)
            except queue.Empty:
                continue
            if isinstance(wish, BaseException):
                raise wish
            if wish == "reload":
                following = self._reload(beat)
                if following is not None:
                    self._triggers.stop()
                    self._take_started(beat)
                    return following
            else:
                self._capture(wish, beat)

    def _capture(self, source: TriggerSource, beat: Callable[[], None]) -> None:
        try:
            self._captures.take(source, beat)
        finally:
            self._board.set_activity("idle")
            self._triggers.done()
        self._search.wake()
        give_back()

    def give_up(self) -> None:
        """The daemon ends before a capture that was answered ``started`` has begun."""
        while (wish := waiting_wish(self._inbox)) is not None:
            if wish != "reload" and not isinstance(wish, BaseException):
                self._captures.interrupted(wish)

    def _take_started(self, beat: Callable[[], None]) -> None:
        """A capture that was answered ``started`` while the next configuration was read is still taken, with this one."""
        again = False
        while (wish := waiting_wish(self._inbox)) is not None:
            if isinstance(wish, BaseException):
                raise wish
            if wish == "reload":
                again = True  # the file may have changed since it was read
            else:
                self._capture(wish, beat)
        if again:
            self._inbox.put("reload")

    def _reload(self, beat: Callable[[], None]) -> Following | None:
        """The configuration of the file as it is now; None where it is bad, and the one in force stays."""
        self._notifier.reloading()
        try:
            config = load_config(self._path)
            run = run_of(config, self._path)
            same = _searched(run) == _searched(self._run)
            if same:
                return Following(config, None)
            check_named_files(run, self._path)
            return Following(config, worker_with_terrain(run, beat))
        except SkyfixError as error:
            refused(self._board, str(error))
            self._notifier.ready(self._status)
            return None

    def _between_captures(self) -> None:
        if abs(clock.step_s()) > CLOCK_STEP_S:
            _log.warning("wall clock stepped", by_s=round(clock.step_s(), 1))
            clock.begin_session()
            try:
                restore(self._board, self._spool)
            except SpoolError as error:
                _log.error("spool fails", problem=str(error))
        status = status_line(self._board.snapshot())
        if status != self._status:
            self._status = status
            self._notifier.status(status)
        if self._odometer and time.monotonic() >= self._odometer_due_s:
            self._odometer_due_s = time.monotonic() + ODOMETER_EVERY_S
            state = self._odometer.to_json()
            if state != self._odometer_saved:
                keep_odometer(self._spool, self._odometer)
                self._odometer_saved = state


def keep_odometer(spool: Spool, odometer: Odometer) -> None:
    """Remember the way for a restart."""
    try:
        spool.remember(ODOMETER, odometer.to_json())
    except SpoolError as error:
        _log.error("spool fails", problem=str(error))


def waiting_wish(inbox: Inbox) -> Wanted | None:
    """What is in the inbox already; None where there is nothing."""
    try:
        return inbox.get_nowait()
    except queue.Empty:
        return None


def refused(board: Board, problem: str) -> None:
    """Say that a new configuration is not taken, and why."""
    board.count("configurations refused")
    board.tell("status", configuration="refused", reason=problem)
    _log.error("configuration refused", problem=problem, kept="the one in force")


def status_line(snapshot: Snapshot) -> str:
    """How the daemon is, for people: what it does, what ails it, and the last fix with its time, which does not grow old."""
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
