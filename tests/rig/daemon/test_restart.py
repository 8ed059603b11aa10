"""What the daemon knows of before a restart: shown with its age, and never as the present."""

from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from fakes.located import answer_of, bundle_id, json_of, write_bundle
from fakes.search_worker import NO_FIX, TRACK
from fastapi.testclient import TestClient

from localizer.fix import Fix
from localizer.track.document import TrackLine
from localizer.track.tracker import Tracker
from rig import clock
from rig.clock import Instant
from rig.config.run import HttpServer
from rig.daemon.boot import boot_id, suspended_s
from rig.daemon.http.app import make_app
from rig.daemon.http.event_streams import EventStreams
from rig.daemon.http.map import ReliefMap
from rig.daemon.publish.published import current_fix, expiry_reason, newest_answer
from rig.daemon.search.answers import answer_of as found_answer
from rig.daemon.search.answers import restore
from rig.daemon.search.process import CaptureInfo, SearchResult
from rig.daemon.spool.index import Entry
from rig.daemon.spool.store import Spool
from rig.daemon.state import DaemonState

VALID_S = 1000.0


@pytest.fixture
def spool(tmp_path: Path) -> Iterator[Spool]:
    with Spool(tmp_path / "spool", 100) as spool:
        yield spool


def stored(
    spool: Spool, number: int, status: Any = "fix", age_s: float = 10.0, boot: str | None = None
) -> str:
    """A bundle with its answer in the spool, as a run before has left them. ``boot``: this one unless given."""
    answer = answer_of(bundle_id(number), status, age_s, east_m=100.0 * number)
    write_bundle(spool.bundles_dir, answer.bundle)
    spool.begin_capture("interval", None)
    spool.end_capture()
    spool.set_answer(answer, Tracker())
    if boot is not None:
        with spool._transaction() as db:
            db.execute("UPDATE bundles SET boot = ? WHERE bundle = ?", (boot, answer.bundle))
    return answer.bundle


def restarted(spool: Spool) -> DaemonState:
    daemon_state = DaemonState()
    restore(daemon_state, spool)
    return daemon_state


def client_of(daemon_state: DaemonState, spool: Spool) -> TestClient:
    section = HttpServer(listen="127.0.0.1:0", valid_s=VALID_S)
    app = make_app(section, daemon_state, None, spool, EventStreams(daemon_state), ReliefMap([]), None)  # type: ignore[arg-type]
    return TestClient(app, base_url="http://localhost")


@pytest.mark.parametrize("boot", [None, "another boot"])
def test_the_last_fix_is_known_again_with_its_age_and_is_not_current(spool: Spool, boot: str | None) -> None:
    bundle = stored(spool, 1, age_s=120.0, boot=boot)
    daemon_state = restarted(spool)
    snapshot, now = daemon_state.snapshot(), Instant.now()
    assert snapshot.last is not None
    assert snapshot.last.bundle == bundle
    assert now.monotonic_s - snapshot.last.captured.monotonic_s == pytest.approx(120.0, abs=5.0)
    assert current_fix(snapshot, now, VALID_S) is None
    assert "before the restart" in str(expiry_reason(snapshot.last, snapshot, now, VALID_S))


def test_over_http_it_is_there_at_once_and_says_what_it_is(spool: Spool) -> None:
    stored(spool, 1, age_s=300.0, boot="another boot")
    stored(spool, 2, "none", age_s=60.0, boot="another boot")
    with client_of(restarted(spool), spool) as client:
        fix = json_of(client.get("/fix"))
        assert (fix["fix"]["status"], fix["before_start"], fix["current"]) == ("none", True, False)
        assert fix["age_s"] == pytest.approx(60.0, abs=5.0)
        assert fix["last_fix"]["bundle"] == bundle_id(1)  # the last known position
        assert fix["last_fix"]["age_s"] == pytest.approx(300.0, abs=5.0)
        assert fix["last_fix"]["current"] is False
        state = json_of(client.get("/status"))
        assert state["last_fix"]["bundle"] == bundle_id(1)
        assert state["last_fix"]["age_s"] == pytest.approx(300.0, abs=5.0)
        assert [point["bundle"] for point in json_of(client.get("/track"))] == [bundle_id(1)]
        metrics = client.get("/metrics").text
        (age,) = [line for line in metrics.splitlines() if line.startswith("skyfix_fix_age_seconds ")]
        assert float(age.split()[1]) == pytest.approx(300.0, abs=5.0)
        assert "skyfix_answer_delay_seconds_count 0" in metrics  # it was no answer of this run
        assert state["counts"] == {}


def test_an_empty_spool_has_nothing_to_tell(spool: Spool) -> None:
    assert restarted(spool).snapshot().last is None


def test_what_has_been_answered_since_is_not_overwritten(spool: Spool) -> None:
    stored(spool, 1, age_s=300.0)
    daemon_state = DaemonState()
    daemon_state.set_answer(answer_of("of this run", age_s=1.0))
    restore(daemon_state, spool)
    last = newest_answer(daemon_state.snapshot())
    assert last is not None
    assert last.bundle == "of this run"


def test_an_answer_of_this_run_takes_its_place(spool: Spool) -> None:
    stored(spool, 1, age_s=30.0)
    daemon_state = restarted(spool)
    daemon_state.set_answer(answer_of("of this run", age_s=1.0))
    fix = current_fix(daemon_state.snapshot(), Instant.now(), VALID_S)
    assert fix is not None
    assert fix.bundle == "of this run"


def found(captured: Instant) -> SearchResult:
    fix = Fix.model_validate({**NO_FIX, "bundle": "a"})
    line = TrackLine.model_validate({**TRACK, "bundle": "a", "fix": fix})
    capture_info = CaptureInfo(captured.utc.isoformat(), captured.monotonic_s, None, (0.0,))
    return SearchResult(line, Tracker(), None, None, capture_info)


def entry(boot: str | None) -> Entry:
    return Entry(1, "a", datetime.now(UTC), "interval", boot, "waiting", 0, None, 1000, True, None)


def before(seconds: float) -> Instant:
    now = Instant.now()
    return Instant(now.monotonic_s - seconds, now.utc - timedelta(seconds=seconds))


@pytest.mark.parametrize(
    ("boot", "captured_ago_s", "is_before"),
    [(boot_id(), 5.0, False), (boot_id(), 50.0, True), ("another boot", 5.0, True), (None, 5.0, True)],
)
def test_a_bundle_that_waited_for_its_search_over_a_restart_is_of_before(
    boot: str | None, captured_ago_s: float, is_before: bool
) -> None:
    answer = found_answer(entry(boot), found(before(captured_ago_s)), started=before(20.0))
    assert answer.before_start is is_before
    age_s = Instant.now().monotonic_s - answer.captured.monotonic_s
    assert age_s == pytest.approx(captured_ago_s, abs=3.0)


def test_a_clock_that_says_the_capture_is_yet_to_come_does_not_make_it_young() -> None:
    ahead = replace(before(0.0), utc=datetime.now(UTC) + timedelta(days=1))
    answer = found_answer(entry("another boot"), found(ahead), started=before(20.0))
    assert Instant.now().monotonic_s - answer.captured.monotonic_s >= 3600.0


def test_a_rebuilt_index_takes_the_time_from_the_bundle(tmp_path: Path) -> None:
    folder = tmp_path / "spool"
    with Spool(folder, 100) as spool:
        write_bundle(spool.bundles_dir, bundle_id(1))
    (folder / "index.sqlite").write_bytes(b"damaged" * 1000)
    for leftover in folder.glob("index.sqlite-*"):
        leftover.unlink()
    with Spool(folder, 100) as spool:
        (entry,) = spool.entries(5)
        assert entry.captured == datetime(2026, 11, 23, 4, 31, 40, tzinfo=UTC)  # the frames' time
        assert entry.state == "waiting"


def test_a_bundle_that_cannot_be_read_has_at_least_the_time_of_its_file(spool: Spool) -> None:
    folder = write_bundle(spool.bundles_dir, bundle_id(1))
    (folder / "bundle.json").write_text("{")
    spool.reconcile()
    (entry,) = spool.entries(5)
    assert datetime.now(UTC) - entry.captured < timedelta(minutes=1)


def test_a_fix_of_before_the_computer_slept_is_not_current(
    spool: Spool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The monotonic clock stands still in suspend: by it the fix is seconds old for ever."""
    daemon_state = DaemonState()
    daemon_state.set_answer(answer_of("a", age_s=5.0))
    assert current_fix(daemon_state.snapshot(), Instant.now(), VALID_S) is not None
    slept_s = suspended_s() + 7200.0
    monkeypatch.setattr("rig.daemon.state.suspended_s", lambda: slept_s)
    assert current_fix(daemon_state.snapshot(), Instant.now(), VALID_S) is None
    daemon_state.set_answer(answer_of("b", age_s=0.0))
    assert current_fix(daemon_state.snapshot(), Instant.now(), VALID_S) is not None
    assert daemon_state.snapshot().counts["times asleep"] == 1


def test_ages_are_put_right_once_the_clock_is(spool: Spool, monkeypatch: pytest.MonkeyPatch) -> None:
    """A computer without a battery-backed clock starts in 1970."""
    stored(spool, 1, age_s=300.0, boot="another boot")
    monkeypatch.setattr(clock, "_session", clock._session)  # for monkeypatch to put back
    monkeypatch.setattr(clock, "wall_clock", lambda: datetime(1970, 1, 1, 0, 1, tzinfo=UTC))
    clock.begin_session()
    daemon_state = restarted(spool)
    monkeypatch.setattr(clock, "wall_clock", lambda: datetime.now(UTC))
    clock.begin_session()
    restore(daemon_state, spool)
    last = daemon_state.snapshot().last
    assert last is not None
    assert Instant.now().monotonic_s - last.captured.monotonic_s == pytest.approx(300.0, abs=5.0)


def test_an_answer_of_another_version_is_skipped(spool: Spool) -> None:
    stored(spool, 1, age_s=300.0)
    with spool._transaction() as db:
        db.execute("""UPDATE bundles SET answer = '{"fix": {"status": "fix"}}'""")
    assert spool.latest() == (None, None)
    assert restarted(spool).snapshot().last is None


@pytest.mark.parametrize("crs", ["nonsense", "EPSG:999999", "PROJCS[" * 3000, '{"type":' * 3000])
def test_an_answer_in_an_unknown_crs_is_shown_without_the_map(spool: Spool, crs: str) -> None:
    """Another version of PROJ may have known it, or somebody has edited the index."""
    bundle = stored(spool, 1)
    with spool._transaction() as db:
        db.execute("UPDATE bundles SET answer = json_set(answer, '$.fix.position.crs', ?)", (crs,))
    client = client_of(restarted(spool), spool)
    for path, found in (
        ("/fix", client.get("/fix").json()),
        ("/status", client.get("/status").json()["last"]),
    ):
        assert found["bundle"] == bundle, path
        assert found["map_from_ground"] is None
        assert found["convergence_deg"] is None
        assert not found["current"]


@pytest.mark.parametrize("damaged", ["", "{", "[" * 9999, "null", '{"fix": {"status": "fi'])
def test_a_damaged_answer_does_not_hide_the_fix_before_it(spool: Spool, damaged: str) -> None:
    good, bad = stored(spool, 1), stored(spool, 2)
    with spool._transaction() as db:
        db.execute("UPDATE bundles SET answer = ? WHERE bundle = ?", (damaged, bad))
    _, last_fix = spool.latest()
    assert last_fix is not None
    assert last_fix[0].bundle == good
    shown = restarted(spool).snapshot()
    assert shown.last_fix is not None
    assert shown.last_fix.bundle == good
    assert shown.last_fix.before_start


def test_a_time_without_a_zone_does_not_keep_the_daemon_from_starting(spool: Spool) -> None:
    bundle = stored(spool, 1, boot="another boot")
    with spool._transaction() as db:
        db.execute("UPDATE bundles SET answer = json_set(answer, '$.captured.utc', '2026-11-23T04:31:51')")
    last = restarted(spool).snapshot().last
    assert last is not None
    assert last.bundle == bundle
