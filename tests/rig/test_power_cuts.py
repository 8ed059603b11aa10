"""The power fails between any two system calls: what is on the disk is complete or absent, and what was reported is there.

``fakes.power_cut`` gives every state that POSIX allows at each moment.
"""

import os
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from fakes.power_cut import Disk, PowerCut, look_at_all
from fakes.whole_rig import RunningRig

from localizer.bundle import Altitude, Camera, load_bundle
from localizer.show.report_folder import _replace_all
from rig.atomic import write_atomically
from rig.bundle.archive import bundles_of_archive, unpack_archive, write_archive
from rig.bundle.writer import FrameRecord, Measurement, write_bundle
from rig.calibrate.config_edit import name_in_config
from rig.calibrate.inclinometer import temperature
from rig.daemon.spool.store import Spool
from rig.series.journal import Plan, begin_series, load_series, locked_series
from rig.telemetry.reader import TelemetryFile, mend
from rig.telemetry.writer import recording_telemetry

NOW = datetime(2026, 11, 23, 4, 31, 51, tzinfo=UTC)
Check = Callable[[Path, PowerCut], None]


def measurement(*labels: str) -> Measurement:
    """With one small picture for each label."""
    camera = Camera(width_px=8, height_px=6, fx_px=50.0, fy_px=50.0, cx_px=3.5, cy_px=2.5)
    picture = np.arange(8 * 6 * 3, dtype=np.uint8).reshape(6, 8, 3)
    frames = [FrameRecord(label, picture, NOW, 0.1, 0.1, 5.0, 0.01, -0.3, 0.02, {}) for label in labels]
    return Measurement(NOW, camera, 2.0, Altitude(value_m=1432.6, sigma_m=5.0), 0.5, 0.02, frames, {}, {})


@pytest.fixture
def disk(tmp_path: Path) -> Disk:
    """An empty one."""
    root = tmp_path / "disk"
    root.mkdir()
    return Disk(root, always_kept=lambda name: name.startswith("index.sqlite"))


@pytest.fixture
def looked_at(tmp_path: Path) -> Callable[[Disk, Check], int]:
    """Checks every state of a disk; how many there are."""
    return lambda disk, check: look_at_all(disk, tmp_path / "after the power cut", check)


Look = Callable[[Disk, Check], int]


def complete_bundles(folder: Path) -> list[str]:
    """The ids of the bundles in a folder, each of which is read to its last byte."""
    found = sorted(path for path in folder.glob("*") if not path.name.startswith("."))
    return [load_bundle(path).id for path in found]


# ---- the disk itself


def states_after(disk: Disk) -> list[dict[str, bytes | None]]:
    return list(disk.cuts[-1].states)


def test_what_was_not_synced_may_be_lost(disk: Disk) -> None:
    with disk.recorded():
        (disk.root / "a").write_bytes(b"1234")
    assert states_after(disk) == [{}, {"a": b""}, {"a": b"12"}, {"a": b"1234"}]


def test_a_synced_file_may_have_no_name_and_a_synced_name_no_content(disk: Disk) -> None:
    with disk.recorded():
        file = os.open(disk.root / "a", os.O_CREAT | os.O_WRONLY)
        os.write(file, b"1234")
        os.fsync(file)
        os.close(file)
    assert states_after(disk) == [{}, {"a": b"1234"}]
    with disk.recorded():
        (disk.root / "b").write_bytes(b"56")
        folder = os.open(disk.root, os.O_RDONLY)
        os.fsync(folder)
        os.close(folder)
    assert states_after(disk) == [{"a": b"1234", "b": content} for content in (b"", b"5", b"56")]


def test_a_rename_is_kept_whole_or_not_and_what_it_replaces_goes_with_it(disk: Disk) -> None:
    for name in ("new", "old"):
        (disk.root / name).write_bytes(name.encode())
    full = Disk(disk.root)
    with full.recorded():
        (full.root / "new").rename(full.root / "old")
    assert states_after(full) == [{"new": b"new", "old": b"old"}, {"old": b"new"}]


def test_changes_of_different_folders_are_kept_independently(disk: Disk) -> None:
    (disk.root / "a").mkdir()
    (disk.root / "a" / "x").write_bytes(b"x")
    full = Disk(disk.root)
    with full.recorded():
        (full.root / "a").rename(full.root / "b")
        (full.root / "b" / "x").unlink()
    assert states_after(full) == [
        {"a": None, "a/x": b"x"},
        {"b": None, "b/x": b"x"},
        {"a": None},
        {"b": None},
    ]


# ---- every writer of what is kept


def test_a_small_file_is_the_old_or_the_new_one(disk: Disk, looked_at: Look) -> None:
    file = disk.root / "new folder" / "below it" / "file"
    with disk.recorded():
        write_atomically(file, b"first")
        disk.report("first")
        write_atomically(file, b"the second")
        disk.report("second")

    def check(root: Path, cut: PowerCut) -> None:
        there = root / file.relative_to(disk.root)
        content = there.read_bytes() if there.exists() else None
        allowed = [None, b"first", b"the second"][len(cut.reported) :]
        assert content in allowed

    assert looked_at(disk, check) > 10


def test_a_bundle_is_complete_or_absent_and_there_once_it_is_reported(disk: Disk, looked_at: Look) -> None:
    with disk.recorded():
        for _ in range(2):
            disk.report(write_bundle(disk.root / "field" / "bundles", measurement("N", "E")).name)

    def check(root: Path, cut: PowerCut) -> None:
        assert set(cut.reported) <= set(complete_bundles(root / "field" / "bundles"))

    assert looked_at(disk, check) > 20


@pytest.mark.parametrize("name", ["x.tar", "x.zip"])
def test_an_archive_is_complete_or_absent_and_there_once_it_is_reported(
    disk: Disk, looked_at: Look, tmp_path: Path, name: str
) -> None:
    bundle = load_bundle(write_bundle(tmp_path / "bundles", measurement("N")))
    with disk.recorded():
        write_archive(disk.root / "out" / name, [bundle])
        disk.report(name)

    def check(root: Path, cut: PowerCut) -> None:
        archive = root / "out" / name
        assert archive.exists() or not cut.reported
        if archive.exists():
            assert [each.id for each in bundles_of_archive(archive)] == [bundle.id]

    assert looked_at(disk, check) >= 4


def test_imported_bundles_are_complete_or_absent_and_there_once_they_are_reported(
    disk: Disk, looked_at: Look, tmp_path: Path
) -> None:
    bundles = [load_bundle(write_bundle(tmp_path / "bundles", measurement("N"))) for _ in range(2)]
    write_archive(tmp_path / "x.tar", bundles)
    with disk.recorded():
        unpack_archive(tmp_path / "x.tar", disk.root / "home" / "imported")
        disk.report("all")

    def check(root: Path, cut: PowerCut) -> None:
        found = complete_bundles(root / "home" / "imported")
        assert len(found) == 2 or not cut.reported

    assert looked_at(disk, check) > 20


def test_a_bundle_that_the_spool_deletes_is_never_a_half_one(disk: Disk, looked_at: Look) -> None:
    with Spool(disk.root / "spool", 100) as spool:
        kept, going = (write_bundle(spool.bundles_dir, measurement("N", "E")).name for _ in range(2))
        spool.reconcile()
        full = Disk(disk.root, always_kept=lambda name: name.startswith("index.sqlite"))
        with full.recorded():
            spool._delete(going)
            full.report("deleted")

    def check(root: Path, cut: PowerCut) -> None:
        found = complete_bundles(root / "spool" / "bundles")
        assert kept in found
        with Spool(root / "spool", 100) as after:
            assert sorted(entry.bundle for entry in after.entries(10) if entry.here) == found

    assert looked_at(full, check) > 10


def test_a_bundle_that_the_spool_has_taken_in_is_on_the_disk(disk: Disk, looked_at: Look) -> None:
    with disk.recorded(), Spool(disk.root / "var" / "spool", 100) as spool:
        spool.begin_capture("command", None)
        name = write_bundle(spool.bundles_dir, measurement("N")).name
        assert spool.end_capture() == name
        disk.report(name)

    def check(root: Path, cut: PowerCut) -> None:
        if not cut.reported:
            return
        with Spool(root / "var" / "spool", 100) as after:
            (entry,) = after.entries(10)
            assert (entry.bundle, entry.trigger, entry.state) == (name, "command", "waiting")

    looked_at(disk, check)


def test_a_series_knows_each_bundle_that_it_has_reported(disk: Disk, looked_at: Look) -> None:
    plan = Plan(2, 0.0, ("N",), "rover")
    with disk.recorded():
        begun = begin_series(disk.root / "out", plan)
        disk.report("begun")
        for number in (1, 2):
            begun.begin(number)
            disk.report(f"begin {number}")
            bundle = load_bundle(write_bundle(begun.bundles, measurement("N")))
            begun.taken(number, 1.0, bundle, {})
            disk.report(f"taken {number}")

    def check(root: Path, cut: PowerCut) -> None:
        folder = root / "out" / begun.id
        if not cut.reported:
            return
        with locked_series(folder) as after:
            numbers = [set(after.begun), set(after.outcomes)]
            for kind, known in zip(("begin", "taken"), numbers, strict=True):
                assert {int(each[-1]) for each in cut.reported if each.startswith(kind)} <= known
            assert {outcome.bundle for outcome in after.outcomes.values()} <= set(
                complete_bundles(after.bundles)
            )
        assert load_series(folder).plan == plan

    assert looked_at(disk, check) > 40


def test_the_configuration_names_the_old_or_the_new_calibration(disk: Disk, looked_at: Look) -> None:
    before = '[rig]\nname = "rover"\n\n[calibration]\ncamera = "old.json"\n'
    (disk.root / "rig.toml").write_text(before)
    full = Disk(disk.root)
    with full.recorded():
        name_in_config(full.root / "rig.toml", "camera", full.root / "new.json")
        full.report("named")

    def check(root: Path, cut: PowerCut) -> None:
        allowed = [before, before.replace("old.json", "new.json")][len(cut.reported) :]
        assert (root / "rig.toml").read_text() in allowed

    assert looked_at(full, check) > 3


def test_the_files_of_a_report_are_whole_and_no_old_place_lies_beside_a_new_page(
    disk: Disk, looked_at: Look
) -> None:
    old = {"report.html": b"old page", "fix.gpx": b"old place"}
    new = {"report.html": b"new page, no place"}
    for name, content in old.items():
        (disk.root / name).write_bytes(content)
    full = Disk(disk.root)
    with full.recorded():
        _replace_all(full.root, new)
        full.report("report")

    def check(root: Path, cut: PowerCut) -> None:
        held = {path.name: path.read_bytes() for path in root.iterdir() if path.is_file()}
        only_the_place_gone = {"report.html": b"old page"}
        assert held in ([old, only_the_place_gone, new] if not cut.reported else [new])

    assert looked_at(full, check) > 3


def test_a_session_has_its_name_on_the_disk_while_it_is_recorded_and_all_of_it_once_it_ends(
    running: RunningRig, disk: Disk, looked_at: Look
) -> None:
    with disk.recorded():
        with recording_telemetry(disk.root / "new" / "s.mcap", running.config()) as path:
            disk.report("recording")
        disk.report("session")
        mend(path, disk.root / "mended.mcap")
        disk.report("mended")

    def check(root: Path, cut: PowerCut) -> None:
        for what, name in (("session", "new/s.mcap"), ("mended", "mended.mcap")):
            if what in cut.reported:
                file = TelemetryFile(root / name)
                assert len(list(file)) > 0
                assert file.problem is None
        assert (root / "new" / "s.mcap").exists() or not cut.reported

    assert looked_at(disk, check) > 3


def test_a_log_of_hours_keeps_each_reading(
    disk: Disk, looked_at: Look, monkeypatch: pytest.MonkeyPatch
) -> None:
    level = SimpleNamespace(temperature_c=21.5, mean_g=(0.0, 0.0, 1.0))
    monkeypatch.setattr(temperature, "read_level", lambda *_: (level, None, None))
    section = SimpleNamespace(average_s=0.0)
    log = disk.root / "log.csv"
    with disk.recorded():
        for number in (1, 2):
            temperature.record_temperature_log(None, section, log, 0.0)  # type: ignore[arg-type]
            disk.report(f"reading {number}")

    def check(root: Path, cut: PowerCut) -> None:
        there = root / log.name
        lines = there.read_text().splitlines() if there.exists() else []
        assert sum(line.endswith("21.5,0.0,0.0,1.0") for line in lines) >= len(cut.reported)

    assert looked_at(disk, check) > 3
