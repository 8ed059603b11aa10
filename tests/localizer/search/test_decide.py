"""From places and their evidence to a status, complete probabilities, and a reason."""

import dataclasses

import numpy as np
import pytest

from localizer.search.decide import decide, log_mass, no_place, rejection_reason, with_refined_best
from localizer.search.fit.correlated_errors import ErrorModel
from localizer.search.fit.refine import Refined
from localizer.search.reasons import no_skyline
from localizer.search.selection import _rejected_weight

CELL_M = 30.0


def place(row: float = 100.0, **changes: object) -> Refined:
    good = Refined(
        row=row,
        col=50.0,
        altitude_m=800.0,
        azimuth_bias_deg=0.1,
        azimuth_bias_sigma_deg=0.1,
        tilt_bias_deg=0.0,
        frame_errors_deg=np.zeros((4, 3)),
        covariance_enu_m2=np.eye(2),
        neg_log_posterior=-3000.0,
        dem_error_m=1.0,
        correlation_columns=2.0,
        inlier_share=0.98,
        prior_chi2=4.0,
        residual_px={"N": 0.5},
        mean_column_nll=-5.0,
        evidence=90.0,
        error_model=ErrorModel(0.1, 0.5, 240.0),
    )
    return dataclasses.replace(good, **changes)


def decision(*places: Refined, elsewhere: float = 0.0):
    return decide([log_mass(one, CELL_M) for one in places], places, CELL_M, elsewhere)


def test_one_place_that_explains_what_is_seen_is_a_fix_without_a_reason():
    answer = decision(place())
    assert (answer.status, answer.reason, answer.elsewhere) == ("fix", None, 0.0)
    assert list(answer.probabilities) == [1.0]


@pytest.mark.parametrize("count", [2, 3, 4])
def test_equal_places_share_the_probability(count):
    answer = decision(*(place(100.0 + 50 * i) for i in range(count)))
    assert (answer.status, answer.reason.code) == ("ambiguous", "several_places")
    assert list(answer.probabilities) == pytest.approx([1.0 / count] * count)
    assert str(count) in answer.reason.text


def test_a_place_gains_by_its_evidence_and_by_what_the_readings_say_of_it():
    by_evidence = decision(place(), place(200.0, evidence=86.0)).probabilities
    by_readings = decision(place(), place(200.0, prior_chi2=12.0)).probabilities
    assert by_evidence == pytest.approx([0.881, 0.119], abs=0.001)  # 4 nats, half of which count
    assert by_readings == pytest.approx(by_evidence)


def test_what_was_not_compared_keeps_its_probability():
    answer = decision(place(), elsewhere=0.25)
    assert (answer.status, answer.reason.code) == ("ambiguous", "several_places")
    assert "not compared" in answer.reason.text
    assert answer.probabilities[0] == pytest.approx(0.8)
    assert answer.elsewhere == pytest.approx(0.2)
    assert decision(place(), elsewhere=0.005).status == "fix"
    assert decision(place(), elsewhere=0.011).status == "ambiguous"


def test_negligible_places_are_left_to_elsewhere():
    answer = decision(place(), place(200.0, evidence=60.0))
    assert len(answer.candidates) == 1
    assert 0.0 < answer.elsewhere < 1e-6
    assert answer.probabilities[0] + answer.elsewhere == pytest.approx(1.0)


def test_a_wide_mode_has_more_mass_than_a_narrow_one_of_the_same_height():
    wide = place(200.0, covariance_enu_m2=100.0 * np.eye(2))
    assert decision(place(), wide).probabilities[1] > 0.8
    # below a tenth of a cell, width is chance
    narrow = place(200.0, covariance_enu_m2=0.01 * np.eye(2))
    assert decision(place(), narrow).probabilities == pytest.approx([0.5, 0.5], abs=0.03)


@pytest.mark.parametrize(
    ("changes", "code", "words"),
    [
        ({"evidence": 24.9}, "too_little_skyline", "evidence of 24.9 where 25"),
        ({"covariance_enu_m2": np.diag([151.0**2, 1.0])}, "too_little_skyline", "151 m"),
    ],
)
def test_one_place_with_weak_evidence_or_a_large_covariance_is_no_fix(changes, code, words):
    answer = decision(place(**changes))
    assert (answer.status, answer.reason.code) == ("ambiguous", code)
    assert words in answer.reason.text


def test_a_fix_whose_last_ellipse_is_too_wide_becomes_ambiguous():
    wide = place(covariance_enu_m2=np.diag([151.0**2, 1.0]))
    answer = with_refined_best(decision(place()), wide, CELL_M)
    assert (answer.status, answer.reason.code) == ("ambiguous", "too_little_skyline")
    assert with_refined_best(decision(place()), place(), CELL_M).reason is None


@pytest.mark.parametrize(
    ("changes", "skyline_deg", "code", "words"),
    [
        ({"evidence": 14.9}, 200.0, "outside", "DEM"),
        ({"evidence": 14.9}, 30.0, "too_little_skyline", "30 deg"),
        ({"dem_error_m": 11.8}, 200.0, "dem_error", "12 m"),
        ({"inlier_share": 0.59}, 200.0, "contradicted", "59%"),
        ({"prior_chi2": 65.0}, 200.0, "contradicted", "readings"),
    ],
)
def test_the_reason_for_rejecting_a_place_says_what_would_help(changes, skyline_deg, code, words):
    reason = rejection_reason(place(**changes), 12.0, 16, skyline_deg)
    assert reason.code == code
    assert words in reason.text
    assert reason.text.endswith(".")


def test_a_place_just_within_the_limits_is_not_rejected():
    limits = {"evidence": 15.0, "dem_error_m": 11.7, "inlier_share": 0.6, "prior_chi2": 64.9}
    assert rejection_reason(place(**limits), 12.0, 16, 200.0) is None


def test_without_a_place_all_probability_is_elsewhere():
    answer = no_place(no_skyline())
    assert (answer.status, answer.elsewhere, answer.candidates) == ("none", 1.0, [])
    assert answer.reason.code == "too_little_skyline"


def test_a_rejected_place_is_weighted_by_its_log_odds_behind_the_best():
    best = place()  # log-odds 88
    assert _rejected_weight(place(evidence=90.0), best) == 1.0
    assert _rejected_weight(place(evidence=80.0), best) == 1.0, "around it there may be a better one"
    assert _rejected_weight(place(evidence=60.0), best) == pytest.approx(np.exp(-10.0))
    chance, worse = place(evidence=2.0), place(evidence=-50.0)
    assert _rejected_weight(worse, best) == _rejected_weight(chance, best) == pytest.approx(np.exp(-39.0))
