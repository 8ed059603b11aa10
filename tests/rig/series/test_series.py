"""``rig capture --repeat``: numbered bundles, and a series that can be resumed."""

import json
import os
import re
import signal
import threading
import time
from collections import namedtuple
from datetime import timedelta
from pathlib import Path

import pytest
from fakes.bundle import write_one
from fakes.command import Run, one_line, written
from fakes.servos import HARDWARE_ERROR
from fakes.whole_rig import RunningRig

from localizer.bundle import Bundle, load_bundle
from rig.series import run as series_run
from rig.series.journal import (
    Outcome,
    Plan,
    Series,
    SeriesError,
    begin_series,
    load_series,
    locked_series,
    unfinished_series,
)
from rig.series.summary import summary, summary_text

PLAN = Plan(3, 0.0, ("N", "E"), "test")


@pytest.fixture
def bundle(tmp_path: Path) -> Bundle:
    return load_bundle(write_one(tmp_path / "elsewhere"))


def the_series(folder: Path) -> Path:
    (path,) = (folder / "bundles").glob("series-*")
    return path


def test_a_series_goes_on_after_a_failure(
    run: Run, running: RunningRig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    note = Series.failed

    def overload_once() -> None:
        if running.rig.readings_taken == 2:
            running.rig.pan.registers[HARDWARE_ERROR] = 0x20

    def note_and_put_right(series: Series, number: int, took_s: float, reason: str) -> Outcome:
        running.rig.pan.registers[HARDWARE_ERROR] = 0
        return note(series, number, took_s, reason)

    running.rig.before_reading = overload_once
    monkeypatch.setattr(Series, "failed", note_and_put_right)
    options = "--config", written(running, tmp_path), "--directions", "E", "--repeat", "2", "--every", "1"
    status, out, err = run("capture", *options)
    assert status == 2
    (bundle_dir,) = out.splitlines()
    folder = the_series(tmp_path)
    assert Path(bundle_dir).parent == folder / "bundles"
    assert load_bundle(Path(bundle_dir)).model_extra["raw"]["series"] == {"id": folder.name, "number": 2}
    assert [path.name for path in (folder / "previews").iterdir()] == [f"0002-{Path(bundle_dir).name}.jpg"]
    assert "rig: 1 of 2: pan and tilt head: pan servo (id 1)" in err
    assert f"{folder.name}: 1 of 2 bundles taken, 1 failed" in err
    assert "  failed  1 at " in err
    found = json.loads((folder / "summary.json").read_text())
    assert (found["taken"], found["failed"], found["left"]) == (1, 1, 0)
    assert found["readings"]["altitude_m"]["mean"] == pytest.approx(540.3, abs=1.0)
    assert not running.rig.torque_is_on
    assert load_series(folder).ended


def test_ctrl_c_ends_with_a_summary_and_the_same_command_goes_on(
    run: Run, running: RunningRig, tmp_path: Path
) -> None:
    options = "--config", written(running, tmp_path), "--directions", "E", "--repeat", "2", "--json"

    def stop_in_the_second() -> None:
        while not list(tmp_path.glob("bundles/series-*/bundles/2*")) or not running.rig.torque_is_on:
            time.sleep(0.02)
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=stop_in_the_second, daemon=True).start()
    status, out, err = run("capture", *options)
    assert status == 130, err
    first, ended = map(json.loads, out.splitlines())
    assert (first["number"], first["problem"]) == (1, None)
    assert (ended["summary"]["taken"], ended["summary"]["left"]) == (1, 1)
    assert err.splitlines()[-1] == "rig: interrupted"
    assert not running.rig.torque_is_on
    assert not list(tmp_path.glob("bundles/series-*/bundles/.*")), "nothing half-written"

    text = summary_text(ended["summary"]).splitlines()
    assert text[0].endswith(": 1 of 2 bundles taken, 0 failed, 1 left: the same command goes on with them")
    assert not any("spread" in line for line in text), "of one bundle there is none"

    status, out, err = run("capture", *options)
    assert status == 0
    assert "goes on with" in err
    second, ended = map(json.loads, out.splitlines())
    assert second["number"] == 2
    assert Path(second["preview"]).is_file()
    assert (ended["summary"]["taken"], ended["summary"]["left"]) == (2, 0)
    lines = summary_text(ended["summary"]).splitlines()
    assert any(re.match(r"  E skyline share +\d\.\d{3}       spread \d\.\d{3} \(", line) for line in lines), (
        lines
    )
    assert len(list(the_series(tmp_path).glob("bundles/*"))) == 2


def test_space_for_all_of_it_is_checked_before_anything_moves(
    run: Run, running: RunningRig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr("shutil.disk_usage", lambda path: usage(10**9, 10**9 - 30_000_000, 30_000_000))
    line = one_line(run("capture", "--config", written(running, tmp_path), "--repeat", "100"))
    assert "100 bundles may need 193 MB, 30 MB are free, enough for 5; make room" in line
    assert not running.servos.requests
    assert not (tmp_path / "bundles").exists()


def test_options_of_a_series_alone(run: Run, running: RunningRig, tmp_path: Path) -> None:
    line = one_line(run("capture", "--config", written(running, tmp_path), "--every", "5"))
    assert "--every and --fresh go with --repeat" in line


def test_the_record_survives_a_torn_line(tmp_path: Path, bundle: Bundle) -> None:
    series = begin_series(tmp_path, PLAN)
    series.begin(1)
    series.taken(1, 3.0, bundle, {"altitude_m": 1.0})
    series.begin(2)
    with (series.folder / "series.jsonl").open("a") as file:
        file.write('{"taken": 2, "ti')
    found = unfinished_series(tmp_path, PLAN)
    assert found is not None
    assert found.remaining() == [2, 3]
    with locked_series(found.folder) as again:
        again.failed(2, 1.0, "why")
    assert load_series(found.folder).remaining() == [3], "the torn line did not eat the next one"


def test_only_an_unfinished_series_of_the_same_plan_goes_on(tmp_path: Path) -> None:
    other = Plan(3, 0.0, ("N",), "test")
    series = begin_series(tmp_path, PLAN)
    assert unfinished_series(tmp_path, other) is None
    series.end()
    assert unfinished_series(tmp_path, PLAN) is None


def test_two_processes_do_not_take_one_series(tmp_path: Path) -> None:
    folder = begin_series(tmp_path, PLAN).folder
    with (
        locked_series(folder),
        pytest.raises(SeriesError, match="another process is taking this series"),
        locked_series(folder),
    ):
        pass


def test_a_damaged_record_is_named_with_its_line(tmp_path: Path) -> None:
    folder = begin_series(tmp_path, PLAN).folder
    with (folder / "series.jsonl").open("a") as file:
        file.write('{"begun": 1}\n{"ended": "x"}\n')
    with pytest.raises(SeriesError, match=r"series.jsonl: line 2 is damaged .*--fresh begins another"):
        unfinished_series(tmp_path, PLAN)


def test_a_bundle_whose_record_a_crash_forestalled_is_not_taken_twice(
    run: Run, running: RunningRig, tmp_path: Path
) -> None:
    options = "--config", written(running, tmp_path), "--directions", "E", "--repeat", "2"
    assert run("capture", *options)[0] == 0
    folder = the_series(tmp_path)
    record = folder / "series.jsonl"
    lines = record.read_text().splitlines(keepends=True)
    record.write_text("".join(lines[:4]))  # header, 1 begun, 1 taken, 2 begun
    status, _out, err = run("capture", *options)
    assert status == 0
    assert "bundle 2 of 2 was there already" in err
    assert len(list((folder / "bundles").iterdir())) == 2
    assert [o.bundle for o in load_series(folder).outcomes.values()] == sorted(
        path.name for path in (folder / "bundles").iterdir()
    )


@pytest.mark.parametrize(("gone_s", "waits_s"), [(10.0, 50.0), (100.0, 0.0), (-5000.0, 60.0)])
def test_a_stopped_series_keeps_its_rhythm(
    tmp_path: Path, gone_s: float, waits_s: float, bundle: Bundle
) -> None:
    series = Series(tmp_path, Plan(3, 60.0, ("N",), "test"))
    series.begin(1)
    assert series_run._remaining_wait_s(series) == 0.0, "what was under way is taken again at once"
    series.taken(1, 3.0, bundle, {})
    series.begun[1] -= timedelta(seconds=gone_s)
    assert series_run._remaining_wait_s(series) == pytest.approx(waits_s, abs=2.0)


def test_headings_about_north_spread_little(tmp_path: Path, bundle: Bundle) -> None:
    series = Series(tmp_path, PLAN)
    for number, heading_deg in enumerate((359.9, 0.1), 1):
        series.begin(number)
        series.taken(number, 2.0, bundle, {"heading_deg": heading_deg})
    found = summary(series)["readings"]["heading_deg"]
    assert found["spread"] == pytest.approx(0.1414, abs=1e-3)
    assert found["mean"] % 360.0 == pytest.approx(0.0, abs=1e-3) or found["mean"] == pytest.approx(360.0)
