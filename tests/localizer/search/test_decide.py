"""From places and their evidence to a status, complete probabilities, and a reason."""

import numpy as np
import pytest
from fits import refined

from localizer.search.decide import (
    decide,
    is_plausible,
    log_mass,
    no_place,
    rejection_reason,
    with_refined_best,
)
from localizer.search.fit.refine import Refined
from localizer.search.reasons import no_skyline
from localizer.search.selection import _rejected_weight

CELL_M = 30.0


def place(row: float = 100.0, **changes: object) -> Refined:
    given = {"azimuth_bias_deg": 0.1, "neg_log_posterior": -3000.0, "mean_column_nll": -5.0}
    return refined(row, **(given | changes))


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


# ---- each limit, with its value: just on one side of it and just on the other


@pytest.mark.parametrize(
    ("below", "at", "code"),
    [
        ({"evidence": 14.999}, {"evidence": 15.0}, "outside"),
        ({"dem_error_m": 11.7601}, {"dem_error_m": 11.7599}, "dem_error"),  # 0.98 of the largest, 12 m
        ({"inlier_share": 0.5999}, {"inlier_share": 0.6}, "contradicted"),
        ({"prior_chi2": 65.0}, {"prior_chi2": 64.999}, "contradicted"),  # 7 squared, and 16 readings
    ],
)
def test_a_place_is_believed_up_to_each_limit(below, at, code):
    assert rejection_reason(place(**below), 12.0, 16, 200.0).code == code
    assert rejection_reason(place(**at), 12.0, 16, 200.0) is None
    assert not is_plausible(place(**below), 12.0, 16)
    assert is_plausible(place(**at), 12.0, 16)


def test_the_limit_of_the_readings_grows_with_their_number():
    assert rejection_reason(place(prior_chi2=58.9), 12.0, 10, 200.0) is None
    assert rejection_reason(place(prior_chi2=59.1), 12.0, 10, 200.0).code == "contradicted"


def test_of_several_reasons_the_first_that_would_help_is_given():
    everything = {"evidence": 1.0, "dem_error_m": 12.0, "inlier_share": 0.1, "prior_chi2": 1e3}
    found = []
    for mended in ("evidence", "dem_error_m", "inlier_share", "prior_chi2"):
        reason = rejection_reason(place(**everything), 12.0, 16, 200.0)
        found.append((reason.code, "readings" in reason.text))
        del everything[mended]
    assert found == [
        ("outside", False),
        ("dem_error", False),
        ("contradicted", False),
        ("contradicted", True),
    ]
    assert rejection_reason(place(), 12.0, 16, 200.0) is None


@pytest.mark.parametrize(("skyline_deg", "code"), [(39.9, "too_little_skyline"), (40.1, "outside")])
def test_less_than_40_deg_of_skyline_is_called_too_little(skyline_deg, code):
    assert rejection_reason(place(evidence=0.0), 12.0, 16, skyline_deg).code == code


@pytest.mark.parametrize(
    ("elsewhere", "status"),
    [(0.01009, "fix"), (0.01011, "ambiguous")],  # 1 / (1 + 0.0101) = 0.99
)
def test_a_fix_has_a_probability_of_99_percent(elsewhere, status):
    assert decision(place(), elsewhere=elsewhere).status == status


@pytest.mark.parametrize(("evidence", "status"), [(24.999, "ambiguous"), (25.0, "fix")])
def test_a_fix_has_an_evidence_of_25(evidence, status):
    assert decision(place(evidence=evidence)).status == status


TURN = np.array([[np.cos(0.7), -np.sin(0.7)], [np.sin(0.7), np.cos(0.7)]])


@pytest.mark.parametrize(("widest_m", "code"), [(149.9, None), (150.1, "too_little_skyline")])
def test_a_fix_is_known_to_5_cells_in_its_worst_direction(widest_m, code):
    covariance = TURN @ np.diag([widest_m**2, 1.0]) @ TURN.T
    for answer in (
        decision(place(covariance_enu_m2=covariance)),
        with_refined_best(decision(place()), place(covariance_enu_m2=covariance), CELL_M),
    ):
        assert answer.status == ("fix" if code is None else "ambiguous")
        assert (answer.reason and answer.reason.code) == code


def test_the_last_fit_replaces_the_first_place_and_no_other():
    first, second, last = place(), place(200.0, evidence=86.0), place(100.1)
    undecided = decision(first, second)
    answer = with_refined_best(undecided, last, CELL_M)
    assert [c.row for c in answer.candidates] == [100.1, 200.0]
    assert (answer.status, answer.reason) == ("ambiguous", undecided.reason)
    assert answer.probabilities is undecided.probabilities
    assert with_refined_best(no_place(no_skyline()), last, CELL_M).status == "none"


@pytest.mark.parametrize(("share", "listed"), [(1.01e-4, 2), (0.99e-4, 1)])
def test_a_place_of_a_ten_thousandth_is_listed(share, listed):
    answer = decide([0.0, np.log(share / (1.0 - share))], [place(), place(200.0)], CELL_M, 0.0)
    assert len(answer.candidates) == len(answer.probabilities) == listed
    assert answer.elsewhere == pytest.approx(0.0 if listed == 2 else share, abs=1e-12)


def test_the_best_place_is_listed_however_improbable_it_is():
    answer = decision(place(), elsewhere=1e6)
    assert len(answer.candidates) == 1
    assert answer.elsewhere == pytest.approx(1.0 - 1e-6, abs=1e-9)


def test_the_mass_of_a_mode_is_half_its_log_odds_and_its_volume():
    # log-odds 90 - 4/2 = 88, of which half; the covariance widened by a tenth of a cell, 3 m
    covariance = np.array([[40.0, 12.0], [12.0, 16.0]])
    volume = 0.5 * np.log((40.0 + 9.0) * (16.0 + 9.0) - 12.0**2)
    assert log_mass(place(covariance_enu_m2=covariance), CELL_M) == pytest.approx(44.0 + volume)
    assert place(evidence=30.0, prior_chi2=10.0).log_odds == 25.0


def test_probabilities_are_shares_of_the_masses_and_what_was_not_compared():
    answer = decide([0.0, np.log(0.5), np.log(0.25)], [place(r) for r in (100.0, 200.0, 300.0)], CELL_M, 0.25)
    assert list(answer.probabilities) == pytest.approx([0.5, 0.25, 0.125])  # of 1 + 0.5 + 0.25 + 0.25
    assert answer.elsewhere == pytest.approx(0.125)


@pytest.mark.parametrize(
    ("log_odds", "weight"),
    [
        (82.0, 1.0),  # 88 of the best one; refinement may raise it by 10
        (76.0, np.exp(-1.0)),  # 12 behind, 2 more than that, half of which count
        (78.0, 1.0),
    ],
)
def test_a_rejected_place_may_gain_10_by_refinement(log_odds, weight):
    assert _rejected_weight(place(evidence=log_odds + 2.0), place()) == pytest.approx(weight)
