"""The spool: what has been measured is never lost without a word, whatever happens when."""

import sqlite3
import time
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from localizer.fix import Fix, Stage1Counts
from localizer.track.odometry import Movement
from localizer.track.tracker import Tracker
from rig.clock import Instant
from rig.config.run import OdometryInput
from rig.daemon.odometry.receiver import Odometer, Velocity
from rig.daemon.spool.store import ODOMETER, Spool, SpoolError, SpoolFullError
from rig.daemon.state import Answer

QUOTA_MB = 10
A_LEG = Movement(np.array([200.0, 10.0]), np.diag([16.0, 9.0]))


def put_bundle(spool: Spool, name: str, size: int = 3_000_000) -> str:
    """A folder like that of a captured bundle."""
    folder = spool.bundles_dir / name
    (folder / "frames").mkdir(parents=True)
    (folder / "frames" / "N.png").write_bytes(b"x" * size)
    (folder / "bundle.json").write_text("{}")
    return name


def captured(spool: Spool, name: str, leg: Movement | None = None, size: int = 3_000_000) -> str:
    spool.begin_capture("command", leg)
    put_bundle(spool, name, size)
    assert spool.end_capture() == name
    return name


def answer_for(bundle: str) -> Answer:
    counts = Stage1Counts(cells=1, after_altitude=0, after={}, points_explored=0)
    fix = Fix(
        bundle=bundle,
        status="none",
        position=None,
        covariance_m2=None,
        probability=0.0,
        candidates=(),
        stage1=counts,
        residual={},
        nuisance=None,
        timing_s={},
    )
    now = Instant(12.5, datetime(2026, 11, 26, 6, 0, tzinfo=UTC))
    return Answer(bundle, now, now, "command", fix, "whole DEM", (), 1.0, None, None, None)


@pytest.fixture
def spool(tmp_path: Path) -> Iterator[Spool]:
    with Spool(tmp_path / "spool", QUOTA_MB) as spool:
        yield spool


class TestWaiting:
    def test_the_oldest_bundle_is_next(self, spool: Spool) -> None:
        captured(spool, "20261126T060000Z-0001")
        captured(spool, "20261126T050000Z-0002")  # the clock was set back
        entry = spool.next_waiting()
        assert entry is not None
        assert (entry.bundle, entry.trigger, entry.state) == ("20261126T060000Z-0001", "command", "waiting")
        assert spool.folder_of(entry.bundle) == spool.bundles_dir / entry.bundle
        assert spool.count("waiting") == 2

    def test_the_number_waiting_is_reported_initially_and_after_every_change(self, tmp_path: Path) -> None:
        told: list[int] = []
        with Spool(tmp_path / "another", QUOTA_MB) as spool:
            captured(spool, "a")
        with Spool(tmp_path / "another", QUOTA_MB, told.append) as spool:
            assert told == [1]
            captured(spool, "b")
            assert told[-1] == 2
            spool.set_answer(answer_for("a"), Tracker())
            assert told[-1] == 1
            spool.set_failed("b", "crashed")
            assert told[-1] == 1
            spool.set_failed("b", "crashed")
            assert told[-1] == 0

    def test_an_answer_ends_the_waiting(self, spool: Spool) -> None:
        answer = answer_for(captured(spool, "a"))
        spool.set_answer(answer, Tracker())
        assert spool.next_waiting() is None
        assert spool.answer_of("a") == answer
        (entry,) = spool.entries(10)
        assert (entry.state, entry.answer) == ("located", answer)

    def test_a_failed_search_is_tried_once_more(self, spool: Spool) -> None:
        captured(spool, "a")
        assert spool.set_failed("a", "took more than 3000 MB") == "waiting"
        assert spool.set_failed("a", "took more than 3000 MB again") == "failed"
        assert spool.next_waiting() is None
        (entry,) = spool.entries(10)
        assert (entry.tries, entry.reason) == (2, "took more than 3000 MB again")

    def test_a_capture_that_left_nothing_leaves_nothing(self, spool: Spool) -> None:
        spool.begin_capture("http", None)
        assert spool.end_capture() is None
        put_bundle(spool, "by hand")
        spool.reconcile()
        assert spool.entries(1)[0].trigger == "found"

    @pytest.mark.parametrize("name", ["..", "", "../spool", "unknown", ".a.partial"])
    def test_only_bundles_have_a_folder(self, spool: Spool, name: str) -> None:
        assert spool.folder_of(name) is None
        assert spool.answer_of(name) is None


class TestWay:
    def test_legs_add_up_from_the_last_answer(self, spool: Spool) -> None:
        captured(spool, "a")
        spool.set_answer(answer_for("a"), Tracker(look_evidence=7.0))
        captured(spool, "b", A_LEG)
        spool.set_failed("b", "crashed")
        spool.set_failed("b", "crashed")
        captured(spool, "c", A_LEG)
        entry = spool.next_waiting()
        assert entry is not None
        tracker, leg = spool.tracker_for(entry)
        assert tracker.look_evidence == 7.0
        assert leg is not None
        assert leg.step_m.tolist() == [400.0, 20.0]
        assert leg.covariance_m2.tolist() == [[32.0, 0.0], [0.0, 18.0]]

    def test_without_a_state_and_the_bundle_that_it_belongs_to_a_new_track_is_begun(
        self, spool: Spool
    ) -> None:
        captured(spool, "a", A_LEG, size=1)
        (entry,) = spool.entries(1)
        assert spool.tracker_for(entry) == (Tracker(), None)
        spool.remember("tracker", Tracker(look_evidence=7.0).to_json())
        assert spool.tracker_for(entry) == (Tracker(), None)

    def test_one_unknown_leg_makes_the_way_unknown(self, spool: Spool) -> None:
        captured(spool, "a")
        spool.set_answer(answer_for("a"), Tracker())
        captured(spool, "b", None)
        captured(spool, "c", A_LEG)
        assert spool.tracker_for(spool.entries(1)[0])[1] is None


class TestQuota:
    def test_the_oldest_located_bundle_goes_first_and_its_answer_stays(self, spool: Spool) -> None:
        for name in "abc":
            captured(spool, name)
        for name in "cb":
            spool.set_answer(answer_for(name), Tracker())
        assert spool.make_room() == ["b"]
        assert spool.folder_of("b") is None
        assert spool.answer_of("b") is not None
        assert sorted(path.name for path in spool.bundles_dir.iterdir()) == ["a", "c"]

    def test_what_has_not_been_located_is_never_deleted(self, spool: Spool) -> None:
        for name in "abc":
            captured(spool, name)
        spool.set_failed("a", "crashed")
        spool.set_failed("a", "crashed")
        with pytest.raises(SpoolFullError, match="3 bundles that have not been located take 9 of 10 MB"):
            spool.make_room()
        assert len(list(spool.bundles_dir.iterdir())) == 3

    def test_a_bundle_larger_than_usual_makes_room_for_another_one_like_it(self, spool: Spool) -> None:
        """Of 10 MB 6 are taken: another bundle of the usual 3 MB would fit, one of 6 MB as the last does not."""
        captured(spool, "a", size=6_000_000)
        with pytest.raises(SpoolFullError, match=r"1 bundles that have not been located take 6 of 10 MB"):
            spool.make_room()
        assert "take 6 of 10 MB" in str(spool.space_problem())
        spool.set_answer(answer_for("a"), Tracker())
        assert spool.space_problem() is None  # it will be deleted when room is made
        assert spool.make_room() == ["a"]


class FreeDisk:
    """What is free on a disk, and more with each bundle that leaves it."""

    def __init__(self, spool: Spool, free_bytes: int, monkeypatch: pytest.MonkeyPatch) -> None:
        self.spool, self.free_bytes = spool, free_bytes
        self.at_first = self.taken()
        monkeypatch.setattr("shutil.disk_usage", lambda path: self)

    def taken(self) -> int:
        return sum(path.stat().st_size for path in self.spool.bundles_dir.rglob("*.png"))

    @property
    def free(self) -> int:
        return self.free_bytes + self.at_first - self.taken()


class TestDisk:
    """A bundle of the usual 3 MB and the reserve of 20 MB are to be free: 23,000,000 bytes."""

    def test_the_reserve_and_another_bundle_must_be_free(
        self, spool: Spool, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        disk = FreeDisk(spool, 23_000_000, monkeypatch)
        assert spool.make_room() == []
        assert spool.space_problem() is None
        disk.free_bytes -= 1
        with pytest.raises(
            SpoolFullError, match=r"23 MB are free on its disk, and a bundle with the reserve takes 23;"
        ):
            spool.make_room()
        assert "no located bundle is left to delete" in str(spool.space_problem())

    def test_located_bundles_are_deleted_until_it_is(
        self, spool: Spool, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        for name in "abc":
            captured(spool, name, size=2_000_000)
            spool.set_answer(answer_for(name), Tracker())
        disk = FreeDisk(spool, 20_000_000, monkeypatch)
        assert spool.space_problem() is None
        assert spool.make_room() == ["a", "b"]
        disk.free_bytes -= 4_000_000
        assert spool.space_problem() is not None
        with pytest.raises(SpoolFullError, match="no located bundle is left to delete"):
            spool.make_room()

    def test_a_disk_that_cannot_be_asked_is_a_problem(
        self, spool: Spool, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        def gone(path: Path) -> None:
            raise OSError(5, "Input/output error")

        monkeypatch.setattr("shutil.disk_usage", gone)
        assert spool.space_problem() == f"{spool.folder}: Input/output error; look at the disk"


class TestIndex:
    def test_it_waits_for_the_disk_at_each_commit(self, spool: Spool) -> None:
        """SQLite: in WAL mode only ``synchronous = FULL`` (2) keeps a committed transaction through a power cut."""
        assert spool._db.execute("PRAGMA synchronous").fetchone() == (2,)
        assert spool._db.execute("PRAGMA journal_mode").fetchone() == ("wal",)

    def test_it_forgets_the_oldest_bundles_that_are_gone_and_no_others(
        self, spool: Spool, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr("rig.daemon.spool.store.ROWS_KEPT", 3)
        for name in ("a", "b", "c", "d"):
            captured(spool, name, size=1)
            spool.set_answer(answer_for(name), Tracker())
        for name in ("b", "c", "d"):
            spool._delete(name)
        spool.reconcile()
        assert [entry.bundle for entry in spool.entries(10)] == ["d", "c", "b", "a"]
        for name in ("e", "f"):  # numbers 5 and 6: up to 3 is too old, if it is gone
            captured(spool, name, size=1)
        assert [entry.bundle for entry in spool.entries(10)] == ["f", "e", "d", "a"]
        assert spool.answer_of("d") is not None
        assert spool.answer_of("c") is None

    @pytest.mark.parametrize("answered", [True, False])
    def test_a_bundle_that_comes_back_is_searched_only_if_it_has_no_answer(
        self, spool: Spool, tmp_path: Path, answered: bool
    ) -> None:
        captured(spool, "a", size=1)
        if answered:
            spool.set_answer(answer_for("a"), Tracker())
        else:
            for _ in range(2):
                spool.set_failed("a", "crashed")
        (spool.bundles_dir / "a").rename(tmp_path / "taken away")
        spool.reconcile()
        assert (spool.folder_of("a"), spool.next_waiting()) == (None, None)
        (tmp_path / "taken away" / "frames" / "N.png").write_bytes(b"x" * 998)
        (tmp_path / "taken away").rename(spool.bundles_dir / "a")
        assert spool.reconcile() == ["a"]
        (entry,) = spool.entries(10)
        assert (entry.here, entry.tries, entry.size_bytes) == (True, 0, 1000)
        assert entry.state == ("located" if answered else "waiting")
        assert (spool.answer_of("a") is not None) == answered
        assert (spool.next_waiting() is None) == answered

    def test_one_of_another_version_is_left_alone(self, tmp_path: Path) -> None:
        with Spool(tmp_path, QUOTA_MB) as spool:
            captured(spool, "a", size=1)
            spool._db.execute("PRAGMA user_version = 2")
        with pytest.raises(SpoolError, match=r"is of another version of skyfix \(2\); give another"):
            Spool(tmp_path, QUOTA_MB)
        assert not list(tmp_path.glob("damaged-*"))

    def test_one_with_a_damaged_page_is_moved_aside(self, tmp_path: Path) -> None:
        with Spool(tmp_path, QUOTA_MB) as spool:
            for name in "ab":
                captured(spool, name, size=1)
        file = tmp_path / "index.sqlite"
        content = bytearray(file.read_bytes())
        page = int.from_bytes(content[16:18], "big")  # the file format: page size at 16, then pages of it
        content[page : page + 8] = b"\xff" * 8
        file.write_bytes(content)
        with Spool(tmp_path, QUOTA_MB) as spool:
            assert sorted(entry.bundle for entry in spool.entries(10)) == ["a", "b"]
        (aside,) = tmp_path.glob("damaged-*-index.sqlite")
        assert aside.read_bytes() == content


class TestRestart:
    def test_the_way_since_a_capture_is_not_the_way_since_a_bundle_that_somebody_put_there(
        self, tmp_path: Path
    ) -> None:
        with Spool(tmp_path, QUOTA_MB) as spool:
            captured(spool, "a")
            spool.set_answer(answer_for("a"), Tracker())
            spool.remember(ODOMETER, "since a")
            put_bundle(spool, "b")
            spool.make_room()
            spool.set_answer(answer_for("b"), Tracker())
            assert spool.recall(ODOMETER) is None
            captured(spool, "c", A_LEG)
            (entry,) = spool.entries(1)
            assert spool.tracker_for(entry)[1] is None
            spool.set_answer(answer_for("c"), Tracker())
            captured(spool, "d", A_LEG)
            (entry,) = spool.entries(1)
            assert spool.tracker_for(entry)[1] is not None

    def test_a_bundle_whose_capture_was_not_noted_to_the_end_is_taken_in(self, tmp_path: Path) -> None:
        with Spool(tmp_path, QUOTA_MB) as spool:
            captured(spool, "a")
            spool.set_answer(answer_for("a"), Tracker())
            spool.begin_capture("rest", A_LEG)
            put_bundle(spool, "b")  # and the power fails
        with Spool(tmp_path, QUOTA_MB) as spool:
            entry = spool.next_waiting()
            assert entry is not None
            assert (entry.bundle, entry.trigger) == ("b", "rest")
            leg = spool.tracker_for(entry)[1]
            assert leg is not None
            assert leg.step_m.tolist() == [200.0, 10.0]

    @pytest.mark.parametrize("left_a_bundle", [True, False])
    def test_the_way_to_a_capture_is_counted_once_wherever_the_power_fails(
        self, tmp_path: Path, left_a_bundle: bool
    ) -> None:
        section = OdometryInput()
        now_s = time.monotonic()
        odometer = Odometer(section, now_s)
        odometer.begin(now_s)

        def east(at_s: float) -> None:
            odometer.velocity(Velocity(10.0, 90.0), at_s)

        for second in range(21):
            east(now_s + second)
        with Spool(tmp_path, QUOTA_MB) as spool:
            spool.remember(ODOMETER, odometer.to_json())
            leg = odometer.begin(now_s + 20.0)
            spool.begin_capture("rest", leg, odometer.to_json())
            if left_a_bundle:
                put_bundle(spool, "a")  # and the power fails
        with Spool(tmp_path, QUOTA_MB) as spool:
            odometer = Odometer(section, now_s + 20.5, spool.recall(ODOMETER))
            east(now_s + 21.0)
            on = odometer.movement(now_s + 21.0)
            assert on is not None
            assert on.step_m[0] == pytest.approx(10.0 if left_a_bundle else 210.0)

    def test_what_was_being_written_or_deleted_goes(self, tmp_path: Path) -> None:
        with Spool(tmp_path, QUOTA_MB) as spool:
            put_bundle(spool, ".b.partial")
            put_bundle(spool, ".a.removed")
        with Spool(tmp_path, QUOTA_MB) as spool:
            assert list(spool.bundles_dir.iterdir()) == []
            assert spool.entries(10) == []

    def test_files_added_by_the_search_count_too(self, spool: Spool) -> None:
        captured(spool, "a")
        (before,) = spool.entries(10)
        (spool.bundles_dir / "a" / "skylines.json").write_bytes(b"x" * 12_345)
        spool.set_answer(answer_for("a"), Tracker())
        (after,) = spool.entries(10)
        assert after.size_bytes == before.size_bytes + 12_345

    def test_a_missing_folder_is_reported(self, tmp_path: Path) -> None:
        with Spool(tmp_path, QUOTA_MB) as spool:
            captured(spool, "a")
            (spool.bundles_dir / "a").rename(tmp_path / "elsewhere")
        with Spool(tmp_path, QUOTA_MB) as spool:
            (entry,) = spool.entries(10)
            assert (entry.state, entry.reason, entry.here) == ("failed", "its folder is gone", False)

    def test_a_damaged_index_is_rebuilt(self, tmp_path: Path) -> None:
        with Spool(tmp_path, QUOTA_MB) as spool:
            captured(spool, "a")
        (tmp_path / "index.sqlite").write_bytes(b"no database" * 1000)
        with Spool(tmp_path, QUOTA_MB) as spool:
            assert [entry.bundle for entry in spool.entries(10)] == ["a"]
        assert list(tmp_path.glob("damaged-*-index.sqlite"))

    def test_an_answer_and_the_track_are_stored_together(
        self, spool: Spool, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        captured(spool, "a")

        def full(*_: object) -> None:
            raise sqlite3.OperationalError("database or disk is full")

        monkeypatch.setattr("rig.daemon.spool.store.remember", full)
        with pytest.raises(SpoolError, match="disk is full"):
            spool.set_answer(answer_for("a"), Tracker())
        assert spool.answer_of("a") is None
        assert spool.next_waiting() is not None

    def test_a_spool_serves_one_daemon(self, spool: Spool) -> None:
        with pytest.raises(SpoolError, match="another rig run uses this spool"):
            Spool(spool.folder, QUOTA_MB)
