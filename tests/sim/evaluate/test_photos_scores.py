"""How skylines and places are scored, on arrays made by hand; and a small run on the real data."""

import dataclasses
import itertools
import json
import math
import sys
from pathlib import Path

import numpy as np
import pytest

from localizer.skyline.find import ColumnState, Skyline, find_skyline
from sim.commands.cli import main
from sim.errors import SimulationError
from sim.evaluate.photos import tables
from sim.evaluate.photos.position_search import Trial, is_true_place, judge, skyline_of_trace
from sim.evaluate.photos.run import PhotoEvaluation, evaluate_photos
from sim.evaluate.photos.skyline_score import combined_score, score_skyline
from sim.evaluate.photos.traced_pictures import HELD_OUT, TUNED_ON, hand_traced


def found(rows: list[float], confidence: list[float]) -> Skyline:
    state = np.where(np.isnan(rows), ColumnState.NO_SKY, ColumnState.OK).astype(np.uint8)
    return Skyline(np.array(rows), np.ones(len(rows)), np.array(confidence), state)


def test_errors_are_scaled_to_a_width_of_1000_px():
    score = score_skyline(found([10.0] * 500, [1.0] * 500), np.full(500, 8.0), 100)
    assert score.error_px == pytest.approx(4.0)


def test_all_columns_and_confident_columns_are_distinguished():
    score = score_skyline(
        found([1.0, 2.0, 3.0, 4.0], [1.0, 0.9, 0.2, 0.5]), np.array([1.0, 1.0, 1.0, 1.0]), 9
    )
    assert sorted(score.size_px(confident_only=False)) == pytest.approx([0.0, 250.0, 500.0, 750.0])
    assert sorted(score.size_px(confident_only=True)) == pytest.approx([0.0, 250.0, 750.0])
    assert score.confident_share == pytest.approx(0.75)


def test_a_column_without_a_found_skyline_counts_against_the_confident_share():
    score = score_skyline(found([5.0, math.nan], [1.0, 0.0]), np.array([5.0, 5.0]), 9)
    assert score.confident_share == pytest.approx(0.5)
    assert len(score.error_px) == 1


def test_columns_whose_skyline_is_unknown_or_outside_the_picture_do_not_count():
    score = score_skyline(found([5.0] * 4, [1.0] * 4), np.array([5.0, math.nan, -3.0, 100.0]), 100)
    assert score.columns == 1
    assert score.confident_share == 1.0


def test_a_nearer_ridge_and_a_cloud_are_distinguished():
    truth = np.full(1000, 50.0)
    rows = np.full(1000, 50.0)
    nearer, cloud = rows.copy(), rows.copy()
    nearer[:100] += 30.0
    cloud[:100] -= 30.0
    sure = [1.0] * 1000
    assert score_skyline(found(list(rows), sure), truth, 200).verdict == "ok"
    assert score_skyline(found(list(nearer), sure), truth, 200).verdict == "below it"
    assert score_skyline(found(list(cloud), sure), truth, 200).verdict == "above it"
    assert score_skyline(found(list(rows), [0.0] * 1000), truth, 200).verdict == "mostly silent"


def test_pictures_together_count_by_their_columns():
    one = score_skyline(found([5.0] * 3, [1.0] * 3), np.full(3, 5.0), 9)
    other = score_skyline(found([5.0], [0.0]), np.full(1, 5.0), 9)
    assert combined_score([one, other]).confident_share == pytest.approx(0.75)


def test_the_true_place_is_within_five_cells_or_five_sigmas():
    assert is_true_place(499.0, 10.0, 0.0, 100.0)
    assert not is_true_place(501.0, 10.0, 0.0, 100.0)
    assert is_true_place(501.0, 101.0, 0.0, 100.0)
    assert is_true_place(400.0, 10.0, 82.0, 25.0)


@pytest.mark.parametrize(
    ("status", "best_is_true", "truth_among", "verdict"),
    [
        ("fix", True, True, "right"),
        ("fix", False, True, "WRONG"),
        ("ambiguous", False, True, "fair"),
        ("ambiguous", False, False, "missed"),
        ("none", False, False, "none"),
    ],
)
def test_an_answer_is_judged_by_what_it_claims(status, best_is_true, truth_among, verdict):
    assert judge(status, best_is_true, truth_among) == verdict


def test_a_trace_is_certain_where_it_is_and_absent_where_it_is_not():
    skyline = skyline_of_trace(np.array([4.0, math.nan]))
    assert list(skyline.state) == [ColumnState.OK, ColumnState.DOUBTFUL]
    assert list(skyline.confidence) == [1.0, 0.0]


HALVES = ([TUNED_ON, "1"], [HELD_OUT, "1"], ["both", "2"])
TRIAL = Trial(
    "rendered", "bt", "found", "2 deg", "known", "fix", 4.2, 3.0, 0.999, 1, 90.0, 0.9, 2.8, 0.6, "right"
)


def test_a_wrong_fix_stands_out_and_is_counted():
    wrong = dataclasses.replace(TRIAL, name="yo", error_m=4000.0, verdict="WRONG")
    evaluation = PhotoEvaluation([], [], [TRIAL, wrong])
    assert evaluation.wrong_fixes == [wrong]
    assert "**WRONG**" in tables.position_table(evaluation.trials)
    assert tables.position_summary(evaluation.trials).splitlines()[-1] == (
        "| rendered | found | 2 deg | known | 1 | 0 | 0 | 0 | 1 |"
    )


def test_everything_that_was_measured_is_json_too():
    good = score_skyline(found([5.0] * 3, [1.0] * 3), np.full(3, 5.0), 9)
    silent = score_skyline(found([5.0] * 3, [0.0] * 3), np.full(3, 5.0), 9)
    evaluation = PhotoEvaluation([("hand", "a", TUNED_ON, good)], [("dusk", silent)], [TRIAL])
    read = json.loads(json.dumps(evaluation.fields(), allow_nan=False))
    assert read["pictures"][0]["median_px"] == 0.0
    assert (read["made_harder"][0]["change"], read["made_harder"][0]["median_px"]) == ("dusk", None)
    assert read["places"][0]["verdict"] == "right"


def test_the_halves_are_reported_apart_and_together():
    one = score_skyline(found([5.0] * 3, [1.0] * 3), np.full(3, 5.0), 9)
    table = tables.skyline_summary([("hand", "a", TUNED_ON, one), ("hand", "b", HELD_OUT, one)])
    rows = [line.strip("| ").split(" | ")[:3] for line in table.splitlines()[2:]]
    assert rows == [[name, *rest] for name in ("hand", "all") for rest in HALVES]


def test_a_data_folder_that_is_not_there_is_named(tmp_path):
    with pytest.raises(SimulationError, match=r"nowhere: not there"):
        evaluate_photos(tmp_path / "nowhere", None)


def test_a_missing_part_of_the_data_is_named(tmp_path):
    with pytest.raises(SimulationError, match="local-only/skylines: not there"):
        evaluate_photos(tmp_path, None)


def test_two_real_photographs_are_traced(skyfix_data: Path):
    for picture in itertools.islice(hand_traced(skyfix_data), 2):
        score = score_skyline(
            find_skyline(picture.image_bgr), picture.true_row_px, picture.image_bgr.shape[0]
        )
        assert score.verdict == "ok"
        assert np.median(score.size_px(confident_only=True)) < 2.0


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "--photos"),
        (["--photos", "nowhere"], "nowhere: not there"),
        (["--photos", "nowhere", "--cases", "3"], "leave --cases away"),
        (["--photos", "nowhere", "--dem", "x.tif"], "leave --dem away"),
    ],
)
def test_the_command_says_in_one_line_what_is_missing(arguments, said, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["sim", "evaluate", *arguments])
    with pytest.raises(SystemExit) as ended:
        main()
    message = capsys.readouterr().err
    assert ended.value.code == 2
    assert said in message
    assert message.count("\n") == 1
