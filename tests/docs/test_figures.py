"""The figures: all that is drawn is committed and shown, small, and made by code that runs."""

import re
from pathlib import Path

import numpy as np
import pytest
from generate.figures import coverage, curvature, decision, drawing, errors
from generate.figures.__main__ import FIGURES, main
from generate.figures.drawing import FOLDER, MOST_BYTES

PAGE = (FOLDER.parent / "how-it-works.md").read_text()
FILES = sorted(FOLDER.iterdir())


def test_every_figure_is_committed_and_shown() -> None:
    assert {file.stem for file in FILES} == set(FIGURES)
    assert set(re.findall(r"\(figures/([\w.-]+)\)", PAGE)) == {file.name for file in FILES}


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.name)
def test_a_figure_is_small_and_loads_nothing(file: Path) -> None:
    assert file.stat().st_size <= MOST_BYTES
    if file.suffix == ".svg":
        links = re.findall(r'(?:href|src)="([^"#][^"]*)"', file.read_text())
        assert [link for link in links if not link.startswith("data:")] == []


@pytest.mark.parametrize("draw", [curvature.draw, decision.draw, coverage.draw_coverage])
def test_a_figure_is_drawn_again_byte_for_byte(
    draw: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(drawing, "FOLDER", tmp_path)
    assert callable(draw)
    draw()
    (drawn,) = tmp_path.iterdir()
    assert drawn.read_bytes() == (FOLDER / drawn.name).read_bytes()


def test_a_figure_that_is_too_large_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(drawing, "FOLDER", tmp_path)
    monkeypatch.setattr(drawing, "MOST_BYTES", 10)
    with pytest.raises(ValueError, match="larger than 10 bytes"):
        drawing.save(drawing.new_figure(1.0, 1.0), "small.svg")


def test_the_name_of_no_figure_is_bad_usage(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["figures", "geometrie"])
    assert main() == 2
    assert "geometrie" in capsys.readouterr().err


def test_independent_columns_count_in_full_and_shared_errors_do_not() -> None:
    assert errors.effective_number(2.0 * np.eye(50)) == pytest.approx(50.0)
    assert errors.effective_number(np.full((50, 50), 1.0) + 1e-9 * np.eye(50)) == pytest.approx(1.0, rel=1e-6)
    by_distance = [errors.effective_number(errors.covariance(d, 300.0)) for d in (300.0, 1000.0, 10_000.0)]
    assert by_distance == pytest.approx([1.5, 4.6, 587.4], abs=0.1)  # as the page says


def test_the_coverage_shown_is_that_of_the_measurements() -> None:
    page = """
| scenario | n | fix | in 50 % | in 90 % | in 95 % | in 99 % |
| --- | --- | --- | --- | --- | --- | --- |
| cloud | 200 | 98 % | 68 % | 94 % | 95 % | 99 % |
| outside | 9 | 0 % | - | - | - | - |
"""
    assert coverage.measured_coverage(page) == {"cloud": (196, (0.68, 0.94, 0.95, 0.99))}
    measured = coverage.measured_coverage(coverage.MEASUREMENTS.read_text())
    assert set(coverage.SHOWN) <= set(measured)
