"""Locates the waiting bundles of the spool, one after the other, and publishes the answers in the daemon state."""

import threading
from collections.abc import Callable
from concurrent.futures import Future

import structlog

from localizer.track.tracker import Tracker, TrackerError
from rig import timebase
from rig.daemon.search.answers import answer_of, described
from rig.daemon.search.process import SearchFailedError, SearchProcess
from rig.daemon.spool.store import Entry, Spool, SpoolError
from rig.daemon.state import DaemonState

_log = structlog.get_logger(__name__)

IDLE_S = 1.0
PAUSE_S = 10.0
"""Back-off after a failure that is not the bundle's."""


class _StoppedError(Exception):
    """The daemon ends or restarts with another configuration."""


class LocateLoop:
    """The loop around the search process. Call ``wake`` for a new bundle."""

    def __init__(
        self,
        spool: Spool,
        daemon_state: DaemonState,
        start: Callable[[], SearchProcess],
        worker: SearchProcess,
    ) -> None:
        """``worker`` was started by ``start``, which is called again if it is lost.

        ``terrain`` is set when the DEM is loaded (``SearchFailedError`` if it cannot be used), ``pictures`` when the
        picture kernels are in the disk cache, or cannot be.
        """
        self.terrain: Future[None] = Future()
        self.pictures: Future[None] = Future()
        self._spool = spool
        self._state = daemon_state
        self._start = start
        self.worker: SearchProcess | None = worker
        self._news = threading.Event()

    def wake(self) -> None:
        """A new bundle is in the spool."""
        self._news.set()

    def run(self, beat: Callable[[], None], stop: threading.Event) -> None:
        """Locate until ``stop``. A running search is then aborted with its worker; its bundle stays in the queue."""

        def going_on() -> None:
            if stop.is_set():
                raise _StoppedError
            beat()

        assert self.worker
        self.worker.beat = going_on
        try:
            self.worker.wait_terrain()
            self.terrain.set_result(None)
        except _StoppedError:
            return
        except SearchFailedError as error:
            self.terrain.set_exception(error)
            return
        try:
            self.worker.wait_pictures()
        except _StoppedError:
            return
        except SearchFailedError as error:
            _log.error("search cannot go on", problem=str(error))
        self.pictures.set_result(None)
        while not stop.is_set():
            try:
                going_on()
                self._step(going_on)
            except _StoppedError:
                return
            except (SpoolError, SearchFailedError) as error:
                _log.error("search cannot go on", problem=str(error), again_in_s=PAUSE_S)
                self.close()
                for _ in range(round(PAUSE_S / IDLE_S)):
                    if not timebase.wait(stop, IDLE_S):
                        beat()

    def _step(self, beat: Callable[[], None]) -> None:
        worker = self._ready_worker(beat)
        entry = self._spool.next_waiting()
        if entry is None:
            timebase.wait(self._news, IDLE_S)
            self._news.clear()
            return
        self._state.set_locating(entry.bundle)
        try:
            self._locate(worker, entry)
        finally:
            self._state.set_locating(None)

    def release_worker(self) -> SearchProcess | None:
        """Release the worker for further use with the same DEM; None if it has ended. Only after ``run``."""
        worker, self.worker = self.worker, None
        if worker is not None and worker.alive:
            return worker
        return None

    def close(self) -> None:
        """End the worker."""
        if self.worker:
            self.worker.close()

    def _ready_worker(self, beat: Callable[[], None]) -> SearchProcess:
        if self.worker is None or not self.worker.alive:
            self.close()
            self.worker = self._start()
            self._state.count("search processes started")
        self.worker.beat = beat
        self.worker.wait_ready()
        return self.worker

    def _locate(self, worker: SearchProcess, entry: Entry) -> None:
        folder = self._spool.folder_of(entry.bundle)
        assert folder
        try:
            tracker, leg = self._spool.tracker_for(entry)
        except TrackerError as error:
            _log.error("track lost", problem=str(error))
            tracker, leg = Tracker(), None
        try:
            found = worker.search(folder, tracker, leg)
        except SearchFailedError as error:
            self._failed(entry, str(error))
            return
        answer = answer_of(entry, found, self._state.snapshot().started)
        self._spool.set_answer(answer, found.tracker)
        self._state.set_answer(answer)
        _log.info("located", bundle=entry.bundle, **described(answer))

    def _failed(self, entry: Entry, reason: str) -> None:
        state = self._spool.set_failed(entry.bundle, reason)
        self._state.count("searches failed")
        self._state.emit("capture", stage="not located", bundle=entry.bundle, reason=reason, state=state)
        _log.error("search failed", bundle=entry.bundle, reason=reason, again=state == "waiting")
