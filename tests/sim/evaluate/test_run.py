"""A whole evaluation: table, resumption, command line."""

import sys
from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio.windows import Window

from sim.commands.cli import main
from sim.errors import SimulationError
from sim.evaluate.case import Experiment
from sim.evaluate.row import CaseRow
from sim.evaluate.run import run_cases
from sim.evaluate.scenario import EvaluationScenario

SMALL = {
    "place": {"edge_margin_m": 300.0, "enclosed_fraction": 0.5},
    "camera": {
        "width_px": 160,
        "height_px": 120,
        "fx_px": 123.2,
        "fy_px": 123.2,
        "cx_px": 79.5,
        "cy_px": 59.5,
    },
    "errors": {"contour_sigma_px": 0.5},
}
TIMES = {"time_s", "timing_s"}


@pytest.fixture(scope="module")
def crop(santa_cruz: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Some hills of the terrain that ships."""
    path = tmp_path_factory.mktemp("dem") / "crop.tif"
    with rasterio.open(santa_cruz) as whole:
        window = Window(400, 200, 220, 220)
        profile = whole.profile | {"width": 220, "height": 220, "transform": whole.window_transform(window)}
        profile.pop("blockxsize", None), profile.pop("blockysize", None)
        with rasterio.open(path, "w", **(profile | {"tiled": False})) as part:
            part.write(whole.read(1, window=window), 1)
    return path


@pytest.fixture(scope="module")
def experiment(crop: Path) -> Experiment:
    return Experiment((crop,), EvaluationScenario.model_validate(SMALL), seed=4)


@pytest.fixture(scope="module")
def finished(experiment: Experiment, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[CaseRow]]:
    table = tmp_path_factory.mktemp("whole") / "cases.csv"
    return table, run_cases(experiment, range(3), table)


def timeless(rows: list[CaseRow]) -> list[dict[str, str]]:
    return [{k: v for k, v in row.to_cells().items() if k not in TIMES} for row in rows]


def test_cases_are_located_where_they_were_made(finished: tuple[Path, list[CaseRow]]) -> None:
    fixes = [row for row in finished[1] if row.status == "fix"]
    assert [row.case for row in fixes] == [0, 2]
    for row in fixes:
        assert row.easting_m is not None
        assert row.northing_m is not None
        off_m = np.hypot(row.easting_m - row.true_easting_m, row.northing_m - row.true_northing_m)
        assert row.error_m == pytest.approx(off_m, rel=1e-3)
        assert off_m < 3.0
        assert row.truth_among
        assert row.truth_probability > 0.99
        assert row.mahalanobis2 is not None
        assert row.mahalanobis2 < 9.21  # 99% of a chi-square with two degrees of freedom
        assert row.sigma_major_m is not None
        assert row.crlb_rms_m is not None
        assert 0.0 < row.crlb_rms_m < 2.0 * row.sigma_major_m
    assert all(row.crlb_rms_m is not None and 0.0 < row.crlb_rms_m < 30.0 for row in finished[1])


def test_an_interrupted_run_ends_with_the_same_rows(
    experiment: Experiment, finished: tuple[Path, list[CaseRow]], tmp_path: Path
) -> None:
    whole, rows = finished
    lines = whole.read_text().splitlines(keepends=True)
    table = tmp_path / "cases.csv"
    table.write_text(
        "".join(lines[:3]) + lines[3][:40]
    )  # settings, header, one row, and a row that was cut off
    computed: list[int] = []
    again = run_cases(experiment, range(3), table, report=lambda row: computed.append(row.case))
    assert computed == [1, 2]
    assert timeless(again) == timeless(rows)
    assert [line.split(",")[0] for line in table.read_text().splitlines()[2:]] == ["0", "1", "2"]


def test_rows_of_another_experiment_are_not_mixed_in(
    experiment: Experiment, finished: tuple[Path, list[CaseRow]]
) -> None:
    other = Experiment(experiment.dems, experiment.scenario, seed=5)
    with pytest.raises(SimulationError, match="made with another seed; choose another --out, or --fresh"):
        run_cases(other, range(3), finished[0])


def test_a_file_that_is_no_table_is_left_alone(experiment: Experiment, tmp_path: Path) -> None:
    table = tmp_path / "cases.csv"
    table.write_text("case,seed\n1,2\n")
    with pytest.raises(SimulationError, match="no table of cases"):
        run_cases(experiment, range(1), table)
    assert table.read_text() == "case,seed\n1,2\n"


@pytest.mark.long
def test_processes_side_by_side_make_the_same_cases(
    experiment: Experiment, finished: tuple[Path, list[CaseRow]], tmp_path: Path
) -> None:
    rows = run_cases(experiment, range(3), tmp_path / "cases.csv", jobs=2)
    assert timeless(rows) == timeless(finished[1])


@pytest.mark.long
def test_pictures_of_a_case_are_located_too(experiment: Experiment, tmp_path: Path) -> None:
    scenario = EvaluationScenario.model_validate({k: v for k, v in SMALL.items() if k != "camera"})
    pictures = Experiment(experiment.dems, scenario, seed=4, level="image")
    (row,) = run_cases(pictures, [0], tmp_path / "cases.csv")
    assert row.contour_median_px is not None
    assert row.contour_median_px < 1.0
    assert row.crlb_rms_m is None


def run_command(monkeypatch: pytest.MonkeyPatch, *arguments: str | Path) -> int:
    monkeypatch.setattr(sys, "argv", ["sim", "evaluate", *map(str, arguments)])
    with pytest.raises(SystemExit) as end:
        main()
    return int(np.int64(end.value.code or 0))


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("[errors]\ncontour_sgima_px = 1.0\n", "errors.contour_sgima_px: unknown key"),
        ("[errors]\ncontour_sigma_px = -1.0\n", "errors.contour_sigma_px: Input should be greater"),
        ("[view]\ndrawn_frames = [3, 1]\n", "1 to 32 frames"),
        ("errors = [", "not valid TOML"),
    ],
)
def test_a_bad_scenario_ends_with_one_line_and_status_2(
    content: str,
    said: str,
    crop: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    bad = tmp_path / "bad.toml"
    bad.write_text(content)
    assert run_command(monkeypatch, "--dem", crop, "--scenario", bad, "--out", tmp_path / "out") == 2
    message = capsys.readouterr().err
    assert said in message
    assert str(bad) in message
    assert message.count("\n") == 1


@pytest.mark.parametrize(
    ("folder", "said"),
    [("", "the name of the folder is empty"), ("/proc/self/out", "--out: /proc/self/out: cannot be written")],
)
def test_an_unwritable_folder_is_reported_before_the_cases(
    folder: str,
    said: str,
    crop: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    scenario = tmp_path / "small.toml"
    scenario.write_text("[errors]\ncontour_sigma_px = 1.0\n")
    monkeypatch.chdir(tmp_path)
    assert run_command(monkeypatch, "--dem", crop, "--scenario", scenario, "--out", folder) == 2
    message = capsys.readouterr().err
    assert said in message
    assert message.count("\n") == 1
    assert [file.name for file in tmp_path.iterdir()] == ["small.toml"]


def test_the_command_writes_table_summary_and_plots(
    crop: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    scenario = tmp_path / "small.toml"
    scenario.write_text(
        "[place]\nedge_margin_m = 300.0\nenclosed_fraction = 0.5\n[errors]\ncontour_sigma_px = 1.0\n"
    )
    out = tmp_path / "out"
    arguments = ["--dem", crop, "--scenario", scenario, "--out", out, "--cases", "2", "--estimator-only"]
    assert run_command(monkeypatch, *arguments) == 0
    assert "## small" in capsys.readouterr().out
    assert {"cases.csv", "summary.json", "summary.md", "reliability.png"} <= {p.name for p in out.iterdir()}
