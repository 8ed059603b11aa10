"""The search process: after any failure there the daemon continues and the bundle is accounted for."""

import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from fakes import search_worker

from localizer.fix import Fix, Nuisance
from localizer.track.document import TrackLine
from localizer.track.tracker import Tracker
from rig.daemon.boot import boot_id
from rig.daemon.search.answers import moment_of, vehicle_heading_deg
from rig.daemon.search.locate_loop import LocateLoop
from rig.daemon.search.process import CaptureInfo, SearchFailedError, SearchProcess, SearchResult
from rig.daemon.spool.store import Spool
from rig.daemon.state import DaemonState

FAKE = (sys.executable, search_worker.__file__)


IN_TIME_S, TOO_LATE_S = 60.0, 3.0


@pytest.fixture
def worker(request: pytest.FixtureRequest) -> Iterator[SearchProcess]:
    time_s = getattr(request, "param", IN_TIME_S)
    worker = SearchProcess([Path("any.tif")], memory_mb=256, time_s=time_s, command=FAKE)
    yield worker
    worker.close()


class TestProcess:
    def test_it_is_asked_and_answers(self, worker: SearchProcess) -> None:
        worker.wait_ready()
        found = worker.search(Path("fine"), Tracker(look_evidence=3.0), None)
        assert found.track.fix.bundle == "fine"
        assert found.tracker.look_evidence == 4.0
        assert worker.memory_mb > 1.0

    def test_it_gets_the_dem_options(self) -> None:
        echo = "import json; print(json.dumps({'error': 'told ' + str(json.loads(input())['dem_error_m'])}))"
        for said in (None, 2.5):
            command = sys.executable, "-c", echo
            worker = SearchProcess([Path("any.tif")], 256, IN_TIME_S, command, dem_error_m=said)
            with pytest.raises(SearchFailedError, match=f"told {said}"):
                worker.wait_terrain()
            worker.close()

    @pytest.mark.parametrize(
        ("worker", "bundle", "reason", "lives"),
        [
            (IN_TIME_S, "crash", "crashed: SIGSEGV", False),
            (TOO_LATE_S, "hang", "took longer than", False),
            (IN_TIME_S, "hog", "took more than", False),
            (IN_TIME_S, "bad", "holds no bundle.json", True),
        ],
        indirect=["worker"],
    )
    def test_what_goes_wrong_there_is_an_error_here(
        self, worker: SearchProcess, bundle: str, reason: str, lives: bool
    ) -> None:
        worker.wait_ready()
        with pytest.raises(SearchFailedError, match=reason):
            worker.search(Path(bundle), Tracker(), None)
        assert worker.alive == lives

    def test_an_unreadable_dem_is_reported_before_the_search(self) -> None:
        worker = SearchProcess([Path("bad.tif")], 256, IN_TIME_S, FAKE)
        with pytest.raises(SearchFailedError, match=r"bad.tif: does not exist"):
            worker.wait_terrain()
        worker.close()

    def test_a_wait_can_be_aborted_and_the_worker_ends(self, worker: SearchProcess) -> None:
        worker.wait_ready()

        def away() -> None:
            raise KeyboardInterrupt

        worker.beat = away
        with pytest.raises(KeyboardInterrupt):
            worker.search(Path("hang"), Tracker(), None)
        assert not worker.alive


def put_bundle(spool: Spool, name: str) -> None:
    (spool.bundles_dir / name).mkdir()
    (spool.bundles_dir / name / "bundle.json").write_text("{}")


class TestLoop:
    @pytest.fixture
    def spool(self, tmp_path: Path) -> Iterator[Spool]:
        with Spool(tmp_path, 10) as spool:
            yield spool

    def located(self, spool: Spool, *names: str, time_s: float = IN_TIME_S) -> DaemonState:
        """Put bundles into the spool and run the loop until none waits."""
        for name in names:
            put_bundle(spool, name)
            spool.begin_capture("rest", None)
            assert spool.end_capture() == name

        def start() -> SearchProcess:
            return SearchProcess([Path("any.tif")], 256, time_s, FAKE)

        daemon_state, stop = DaemonState(), threading.Event()
        search = LocateLoop(spool, daemon_state, start, start())
        thread = threading.Thread(target=search.run, args=(lambda: None, stop))
        thread.start()
        search.wake()
        deadline_s = time.monotonic() + 60.0
        while spool.count("waiting") and time.monotonic() < deadline_s:
            time.sleep(0.02)
        stop.set()
        thread.join()
        search.close()
        return daemon_state

    def test_bundles_are_located_one_after_the_other(self, spool: Spool) -> None:
        daemon_state = self.located(spool, "a", "b")
        assert daemon_state.snapshot().counts["answers none"] == 2
        last = daemon_state.snapshot().last
        assert last is not None
        assert (last.bundle, last.trigger) == ("b", "rest")
        assert spool.tracker_for(spool.entries(1)[0])[0].look_evidence == 2.0  # one after the other

    @pytest.mark.parametrize("wish", ["crash", "hang"])
    def test_after_a_failure_it_is_tried_once_more_with_a_new_worker(self, spool: Spool, wish: str) -> None:
        daemon_state = self.located(spool, f"once-{wish}", "z", time_s=TOO_LATE_S)
        counts = daemon_state.snapshot().counts
        assert (counts["searches failed"], counts["answers none"]) == (1, 2)
        assert counts["search processes started"] == 1
        assert [entry.tries for entry in spool.entries(2)] == [1, 2]

    def test_an_unreadable_dem_ends_the_loop_and_waiters_get_the_reason(self, spool: Spool) -> None:
        worker = SearchProcess([Path("bad.tif")], 256, IN_TIME_S, FAKE)
        search = LocateLoop(spool, DaemonState(), lambda: pytest.fail("started anew"), worker)
        search.run(lambda: None, threading.Event())
        with pytest.raises(SearchFailedError, match=r"bad\.tif: does not exist"):
            search.terrain.result(0.0)

    def test_captures_do_not_wait_for_a_worker_that_ended_before_it_was_ready(self, spool: Spool) -> None:
        stop = threading.Event()

        def start() -> SearchProcess:
            stop.set()
            return SearchProcess([Path("any.tif")], 256, IN_TIME_S, FAKE)

        search = LocateLoop(
            spool, DaemonState(), start, SearchProcess([Path("fatal.tif")], 256, IN_TIME_S, FAKE)
        )
        search.run(lambda: None, stop)
        search.terrain.result(0.0)
        search.pictures.result(0.0)
        search.close()

    def test_what_fails_twice_is_kept_and_does_not_hold_up_the_next(self, spool: Spool) -> None:
        daemon_state = self.located(spool, "crash", "z")
        assert daemon_state.snapshot().counts["searches failed"] == 2
        after, failed = spool.entries(2)
        assert (after.state, failed.state) == ("located", "failed")
        assert failed.reason is not None
        assert "SIGSEGV" in failed.reason
        assert failed.here

    def test_a_bundle_arriving_during_a_search_is_counted_at_once(self, tmp_path: Path) -> None:
        daemon_state, stop = DaemonState(), threading.Event()
        with Spool(tmp_path / "spool", 10, daemon_state.set_waiting) as spool:
            put_bundle(spool, "hang")
            spool.reconcile()
            worker = SearchProcess([Path("any.tif")], 256, IN_TIME_S, FAKE)
            search = LocateLoop(spool, daemon_state, lambda: pytest.fail("started anew"), worker)
            thread = threading.Thread(target=search.run, args=(lambda: None, stop))
            thread.start()
            while daemon_state.snapshot().locating is None:
                time.sleep(0.01)
            assert daemon_state.snapshot().waiting == 1
            with daemon_state.subscribed() as events:
                put_bundle(spool, "z")
                spool.begin_capture("rest", None)
                assert spool.end_capture() == "z"
                event = events.get(0.0)
            now = daemon_state.snapshot()
            stop.set()
            thread.join()
        assert (now.locating, now.waiting) == ("hang", 2)
        assert event is not None
        assert (event.kind, event.data) == ("status", {"waiting": 2})
        assert daemon_state.snapshot().locating is None

    def test_a_stop_in_the_middle_of_a_search_leaves_the_bundle_waiting(self, spool: Spool) -> None:
        put_bundle(spool, "hang")
        spool.reconcile()
        daemon_state, stop = DaemonState(), threading.Event()
        worker = SearchProcess([Path("any.tif")], 256, 60.0, FAKE)
        search = LocateLoop(spool, daemon_state, lambda: pytest.fail("started anew"), worker)
        thread = threading.Thread(target=search.run, args=(lambda: None, stop))
        thread.start()
        while daemon_state.snapshot().locating is None:
            time.sleep(0.01)
        stop.set()
        thread.join(60.0)
        assert not thread.is_alive()
        (entry,) = spool.entries(1)
        assert (entry.state, entry.tries) == ("waiting", 0)
        assert not worker.alive


class TestMoment:
    CAPTURE_INFO = CaptureInfo("2026-11-26T06:00:00+00:00", 100.0, None, (0.0,))

    def test_of_this_run_of_the_computer_the_monotonic_time_counts(self) -> None:
        moment = moment_of(self.CAPTURE_INFO, boot_id())
        assert moment.monotonic_s == 100.0
        assert moment.utc == datetime(2026, 11, 26, 6, 0, tzinfo=UTC)

    def test_of_another_one_it_is_long_ago_whatever_the_clock_says(self) -> None:
        ahead = datetime.now(UTC) + timedelta(days=1)
        moment = moment_of(replace(self.CAPTURE_INFO, utc=ahead.isoformat()), "another boot")
        assert time.monotonic() - moment.monotonic_s >= 3600.0


def test_the_heading_is_the_measured_one_less_the_error_solved_for() -> None:
    fix = Fix.model_validate(
        {
            **search_worker.NO_FIX,
            "bundle": "a",
            "nuisance": Nuisance(azimuth_bias_deg=12.5, tilt_bias_deg=0.0, altitude_bias_m=0.0),
        }
    )
    line = TrackLine.model_validate({**search_worker.TRACK, "bundle": "a", "fix": fix})
    found = SearchResult(line, Tracker(), 1000.0, 0.3, CaptureInfo("", None, 5.0, (0.4, 0.0)))
    assert vehicle_heading_deg(found) == (pytest.approx(352.5), pytest.approx(0.5))


def test_the_worker_ends_with_its_parent(tmp_path: Path) -> None:
    """The real one, before it has read any DEM: its input ends."""
    worker = SearchProcess([], 3000, 60.0)
    assert worker._process.stdin
    worker._process.stdin.close()
    assert worker._process.wait(120.0) == 0
    worker._process.stdin = None
    worker.close()
