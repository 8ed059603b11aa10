"""The paper's Table I again: its places, its counts, and errors that are a small part of its own."""

import dataclasses
import json
import math

import pytest

from sim.commands.cli import sim
from sim.paper.experiment import TABLE_I, Row, mean, paper_places
from sim.paper.table import print_table


def repeated(capsys, *arguments: str) -> dict:
    sim.main(["paper", *arguments, "--json"], standalone_mode=False)
    return json.loads(capsys.readouterr().out)


def test_the_table_holds_the_means_that_the_paper_tells():
    assert mean([run.error_noise_free for run in TABLE_I]) == pytest.approx(0.874, abs=0.001)
    assert mean([run.error_sigma5 for run in TABLE_I]) == pytest.approx(1.835, abs=0.01)
    assert mean([1.0, None]) is None


def test_on_another_dem_the_places_lie_where_they_lie_on_the_papers():
    places = paper_places(rows=718, cols=914, embedded=False)
    assert places[4] == pytest.approx((200.2 * 717 / 358, 200.2 * 913 / 456))
    assert paper_places(718, 914, embedded=True)[4] == (200.2, 200.2)


def test_one_place_is_found_with_and_without_noise(capsys, monkeypatch):
    monkeypatch.setattr("sim.paper.experiment.TABLE_I", TABLE_I[:1])
    found = repeated(capsys)
    (row,) = found["rows"]
    assert row["status_noise_free"] == row["status_sigma5"] == "fix"
    assert found["mean_error_noise_free"] == row["error_noise_free"] < 0.05
    assert row["error_sigma5"] < 0.1
    for noise in ("noise_free", "sigma5"):
        assert row[f"error_{noise}"] < 4.0 * row[f"claimed_{noise}"]
    assert 0.2 < row["grid_only_error_noise_free"] <= math.sqrt(0.5)  # to the nearest grid point
    assert row["candidates_after_one_direction"] > row["candidates_after_all"] > 0


@pytest.mark.long
def test_the_means_are_less_than_a_tenth_of_the_papers(capsys):
    found = repeated(capsys)
    assert {row["status_sigma5"] for row in found["rows"]} == {"fix"}
    assert found["mean_error_noise_free"] < 0.05
    assert found["mean_error_sigma5"] < 0.1


def test_the_claimed_accuracy_is_shown_with_every_error(capsys):
    row = Row((150.2, 100.8), 342, 7, 1000, "fix", "fix", 0.011, 0.04, 0.5, 1.0, 0.02, 0.05)
    print_table([dataclasses.replace(row, actual=run.actual) for run in TABLE_I])
    told = capsys.readouterr().out
    assert (
        told.count("0.011 ± 0.020") == told.count("0.040 ± 0.050") == len(TABLE_I) + 1
    )  # each place, and the mean
    assert "± what the answer claims" in " ".join(told.split())
