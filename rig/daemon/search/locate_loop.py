"""Locates what waits in the spool, one bundle after the other, and puts the answers on the board."""

import math
import threading
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from datetime import UTC, datetime

import structlog

from localizer.fix import Fix
from localizer.track.tracker import Tracker, TrackerError
from rig.clock import Instant, utc_now
from rig.daemon.boot import boot_id
from rig.daemon.search.process import CaptureInfo, SearchFailedError, SearchProcess, SearchResult
from rig.daemon.spool.store import Entry, Spool, SpoolError
from rig.daemon.state import Answer, DaemonState

_log = structlog.get_logger(__name__)

IDLE_S = 1.0
PAUSE_S = 10.0
"""After a failure that is not the bundle's."""
LONG_AGO_S = 3600.0
"""How old a bundle of an earlier run of the computer is taken to be where the wall clock says that it is yet to come."""


class _StoppedError(Exception):
    """The daemon ends, or begins anew with another configuration."""


class LocateLoop:
    """The loop around the worker. ``wake`` it when there is a new bundle."""

    def __init__(
        self,
        spool: Spool,
        daemon_state: DaemonState,
        start: Callable[[], SearchProcess],
        worker: SearchProcess,
    ) -> None:
        """``worker`` has been started by ``start``, which is called again where it is lost.

        ``terrain`` is done when it has read the DEM, with ``SearchFailedError`` where that cannot be used; ``pictures`` when
        the kernels that look at pictures are on the disk, or cannot be had.
        """
        self.terrain: Future[None] = Future()
        self.pictures: Future[None] = Future()
        self._spool = spool
        self._state = daemon_state
        self._start = start
        self.worker: SearchProcess | None = worker
        self._news = threading.Event()

    def wake(self) -> None:
        """There is something new in the spool."""
        self._news.set()

    def run(self, beat: Callable[[], None], stop: threading.Event) -> None:
        """Locate until ``stop``. A search that goes on then is given up with its worker; the bundle waits."""

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
                    if not stop.wait(IDLE_S):
                        beat()

    def _step(self, beat: Callable[[], None]) -> None:
        worker = self._ready_worker(beat)
        entry = self._spool.next_waiting()
        if entry is None:
            self._news.wait(IDLE_S)
            self._news.clear()
            return
        self._state.set_locating(entry.bundle)
        try:
            self._locate(worker, entry)
        finally:
            self._state.set_locating(None)

    def release_worker(self) -> SearchProcess | None:
        """The worker, for whoever goes on with the same DEM; None where it has ended. Only after ``run``."""
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


def answer_of(entry: Entry, found: SearchResult, started: Instant | None = None) -> Answer:
    """What the daemon, which has run since ``started``, publishes of a bundle's search."""
    heading = vehicle_heading_deg(found)
    captured = moment_of(found.capture_info, entry.boot)
    return Answer(
        bundle=entry.bundle,
        captured=captured,
        answered=Instant.now(),
        trigger=entry.trigger,
        fix=found.track.fix,
        mode=found.track.mode,
        hypotheses=found.track.hypotheses,
        elsewhere=found.track.elsewhere,
        altitude_m=found.altitude_m,
        vehicle_heading_deg=heading[0] if heading else None,
        vehicle_heading_sigma_deg=heading[1] if heading else None,
        before_start=entry.boot != boot_id()
        or (started is not None and captured.monotonic_s < started.monotonic_s),
        wgs84_accuracy_m=found.wgs84_accuracy_m,
    )


def restored(answer: Answer, boot: str | None) -> Answer:
    """An answer of the spool after a restart. ``boot``: the computer's run in which its bundle was captured."""
    if boot == boot_id():
        return replace(answer, before_start=True)
    now = Instant.now()
    captured = Instant(now.monotonic_s - _age_s(answer.captured.utc), answer.captured.utc)
    answered = Instant(now.monotonic_s - _age_s(answer.answered.utc), answer.answered.utc)
    return replace(answer, captured=captured, answered=answered, before_start=True)


def restore(daemon_state: DaemonState, spool: Spool) -> None:
    """Put on the board what the spool knows from before a restart, unless there is something of this run already.

    Again after the wall clock has stepped: ages of another run of the computer go by it.
    """
    known = daemon_state.snapshot().last
    if known is not None and not known.before_start:
        return
    last, last_fix = (answer and restored(*answer) for answer in spool.latest())
    newest = last or last_fix  # the newest bundle's may be one that cannot be read
    if newest is not None:
        daemon_state.restore(newest, last_fix)


def vehicle_heading_deg(found: SearchResult) -> tuple[float, float] | None:
    """True heading of the vehicle's forward axis and its sigma: as measured, less the error that the search solved for."""
    nuisance, capture_info = found.track.fix.nuisance, found.capture_info
    if nuisance is None or found.azimuth_bias_sigma_deg is None or capture_info.heading_deg is None:
        return None
    sigma_deg = math.hypot(found.azimuth_bias_sigma_deg, *capture_info.mounting_sigmas_deg)
    return (capture_info.heading_deg - nuisance.azimuth_bias_deg) % 360.0, min(sigma_deg, 180.0)


def moment_of(capture_info: CaptureInfo, boot: str | None) -> Instant:
    """When a bundle's last frame was taken. Of another run of the computer only the wall clock's time is known."""
    utc, now = datetime.fromisoformat(capture_info.utc), Instant.now()
    if boot == boot_id() and capture_info.monotonic_s is not None:
        return Instant(capture_info.monotonic_s, utc)
    return Instant(now.monotonic_s - _age_s(utc), utc)


def _age_s(utc: datetime) -> float:
    """By the wall clock: all that there is for another run of the computer, and nothing that makes a fix current."""
    age_s = (utc_now() - (utc if utc.tzinfo else utc.replace(tzinfo=UTC))).total_seconds()
    return age_s if age_s > 0.0 else LONG_AGO_S


def described(answer: Answer) -> dict[str, object]:
    """An answer as values for one line of the log."""
    fix: Fix = answer.fix
    values: dict[str, object] = {"status": fix.status, "mode": answer.mode}
    if fix.position:
        values |= {
            "lat_deg": round(fix.position.lat_deg, 6),
            "lon_deg": round(fix.position.lon_deg, 6),
            "probability": round(fix.probability, 4),
        }
    values["seconds"] = round(sum(fix.timing_s.values()), 2)
    return values
