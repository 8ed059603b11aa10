"""The arithmetic of the summary on tables made by hand."""

import numpy as np
import pytest
from scipy import stats

from sim.evaluate.row import CaseRow
from sim.evaluate.summary import coverage, is_wrong_fix, reliability, summarize, summarize_by_dem, upper_bound


def row(case: int = 0, **changes: object) -> CaseRow:
    values: dict[str, object] = dict.fromkeys(CaseRow.model_fields)
    values |= {"case": case, "seed": 1, "dem": "a.tif", "outside": False, "status": "fix", "frames": 4}
    values |= {name: 0.0 for name in values if name.startswith("true_")}
    values |= {"error_m": 1.0, "error_cells": 0.1, "mahalanobis2": 1.0, "probability": 1.0, "candidates": 1}
    values |= {
        "truth_among": True,
        "truth_probability": 1.0,
        "columns_used": 9,
        "cells": 9,
        "after_altitude": 9,
    }
    values |= {"after": "{}", "points_explored": 9, "time_s": 1.0, "timing_s": "{}"}
    return CaseRow.model_validate(values | changes)


def test_a_row_survives_the_way_to_the_disk_and_back() -> None:
    there = row(7, error_m=1.25, crlb_rms_m=0.5, true_easting_m=577773.03)
    assert CaseRow.from_cells(there.to_cells()) == there


@pytest.mark.parametrize(
    ("changes", "wrong"),
    [
        ({}, False),
        ({"error_cells": 6.0, "mahalanobis2": 26.0}, True),
        ({"error_cells": 6.0, "mahalanobis2": 24.0}, False),  # far off, but it says so
        ({"error_cells": 4.0, "mahalanobis2": 90.0}, False),  # too sure of itself, but the right place
        ({"error_cells": 6.0, "mahalanobis2": 26.0, "status": "ambiguous"}, False),
        ({"outside": True}, True),
        ({"outside": True, "status": "none"}, False),
    ],
)
def test_what_a_wrong_fix_is(changes: dict[str, object], wrong: bool) -> None:
    assert is_wrong_fix(row(**changes)) == wrong


def test_the_bound_without_a_wrong_fix_is_the_rule_of_three() -> None:
    assert upper_bound(0, 1000) == pytest.approx(1.0 - 0.05 ** (1.0 / 1000.0))
    assert upper_bound(2, 100) == pytest.approx(0.0616, abs=1e-4)  # Clopper and Pearson's tables
    assert upper_bound(3, 3) == 1.0
    assert upper_bound(0, 0) is None


def test_shares_errors_and_bound_of_a_small_table() -> None:
    rows = [
        row(0, error_m=3.0, crlb_rms_m=2.0),
        row(1, error_m=4.0, crlb_rms_m=2.0),
        row(2, error_m=900.0, error_cells=30.0, mahalanobis2=1e4, crlb_rms_m=1.0, truth_among=False),
        row(3, status="ambiguous", error_m=50.0, time_s=9.0),
        row(
            4,
            status="none",
            error_m=None,
            error_cells=None,
            mahalanobis2=None,
            probability=None,
            truth_among=False,
        ),
    ]
    figures = summarize(rows)
    assert (figures["fix"], figures["ambiguous"], figures["none"]) == pytest.approx((0.6, 0.2, 0.2))
    assert figures["wrong_fixes"] == 1
    assert figures["wrong_fix_cases"] == [2]
    assert figures["error_m"]["median"] == 4.0
    assert figures["error_m"]["rmse"] == pytest.approx(np.sqrt((9.0 + 16.0 + 810000.0) / 3.0))
    assert figures["error_right_m"]["rmse"] == pytest.approx(np.sqrt(12.5))
    assert figures["rmse_over_crlb"] == pytest.approx(np.sqrt(12.5) / 2.0)  # the wrong one left out
    assert figures["truth_among_candidates"] == pytest.approx(0.6)
    assert figures["truth_among_when_ambiguous"] == 1.0
    assert figures["time_s"]["median"] == 1.0


def test_coverage_of_honest_ellipses_is_nominal() -> None:
    squares = stats.chi2.ppf((np.arange(1000) + 0.5) / 1000.0, 2)
    found = coverage([row(i, mahalanobis2=float(m)) for i, m in enumerate(squares)])
    assert found == pytest.approx({"0.5": 0.5, "0.9": 0.9, "0.95": 0.95, "0.99": 0.99}, abs=2e-3)


def test_reliability_counts_how_often_a_probability_was_right() -> None:
    far = {"error_cells": 100.0, "mahalanobis2": 1e4}
    rows = [row(0, probability=0.5), row(1, probability=0.5, **far), row(2, probability=1.0)]
    low, high = reliability(rows)
    assert (low["from"], low["answers"], low["mean_probability"], low["right"]) == (0.4, 2, 0.5, 0.5)
    assert (high["to"], high["answers"], high["right"]) == (1.0, 1, 1.0)


def test_each_dem_has_figures_of_its_own() -> None:
    parts = summarize_by_dem([row(0), row(1, dem="b.tif", status="none")])
    assert {name: part["fix"] for name, part in parts.items()} == {"all": 0.5, "a.tif": 1.0, "b.tif": 0.0}
