"""The comparer sees each kind of difference, says how large it is, and names what would explain it.

The answers are made by hand. The frozen covariance is diag(4, 9): sigmas of 2 m to the east and 3 m to the north.
"""

import json

import pytest
from frozen_answers.answer import Answer, Frozen
from frozen_answers.compare import compare, compare_answers, compare_case
from frozen_answers.show import as_json

EAST, NORTH = 500_000.0, 4_600_000.0
FIX = Answer(
    status="fix",
    crs="EPSG:32610",
    easting_m=EAST,
    northing_m=NORTH,
    off_m=1.5,
    covariance_m2=(4.0, 0.0, 9.0),
    probability=0.999,
    elsewhere=0.001,
    candidates=((EAST, NORTH, 0.999, 3.0),),
    evidence=120.0,
    inlier_share=0.95,
    dem_error_m=3.0,
    azimuth_bias_deg=0.4,
    tilt_bias_deg=0.01,
    points=640,
)
TWINS = FIX.model_copy(
    update={
        "status": "ambiguous",
        "reason": "several_places",
        "probability": 0.55,
        "elsewhere": 0.0,
        "candidates": ((EAST, NORTH, 0.55, 3.0), (EAST + 3000.0, NORTH, 0.45, 3.0)),
    }
)
NONE = Answer(status="none", reason="outside")
INPUT = ("a1b2c3d4", 100.0, 52_000.0)


def case(*answers: Answer, inputs=INPUT) -> Frozen:
    return Frozen(case="hand/made", input=inputs, answers=answers)


def changed(answer: Answer = FIX, **fields) -> Answer:
    return answer.model_copy(update=fields)


def judged(frozen: Answer, now: Answer):
    return compare_case("hand/made", case(frozen), case(now))


def amounts(frozen: Answer, now: Answer) -> dict[str, float]:
    return {change.what: change.amount for change in compare_answers(frozen, now)}


def test_an_equal_answer_is_the_same():
    comparison = judged(FIX, FIX.model_copy())
    assert comparison.explanation is None
    assert comparison.changes == ()


def test_a_place_counts_in_sigmas_of_the_frozen_covariance():
    # 3 m to the east are 1.5 sigma, 3 m to the north are 1
    assert amounts(FIX, changed(easting_m=EAST + 3.0))["place"] == pytest.approx(1.5)
    assert amounts(FIX, changed(northing_m=NORTH - 3.0))["place"] == pytest.approx(1.0)
    # a correlated covariance [[4, 3], [3, 9]] has the inverse [[9, -3], [-3, 4]] / 27: (1, 1) is sqrt(7 / 27) off
    slanted = changed(covariance_m2=(4.0, 3.0, 9.0))
    moved = changed(slanted, easting_m=EAST + 1.0, northing_m=NORTH + 1.0)
    assert amounts(slanted, moved)["place"] == pytest.approx((7.0 / 27.0) ** 0.5)


@pytest.mark.parametrize(("east_m", "why"), [(0.19, None), (0.21, "place moved"), (19.0, "place moved")])
def test_a_place_may_move_by_a_tenth_of_a_sigma(east_m, why):
    # sigma east is 2 m
    assert judged(FIX, changed(easting_m=EAST + east_m)).explanation == why


@pytest.mark.parametrize(
    ("fields", "what", "amount"),
    [
        ({"covariance_m2": (4.2, 0.0, 9.0)}, "sigma", 0.0244),  # ln sqrt(4.2 / 4)
        ({"covariance_m2": (4.0, 0.0, 8.0)}, "sigma", 0.0589),  # ln sqrt(9 / 8)
        ({"probability": 0.992}, "probability", 0.007),
        ({"elsewhere": 0.008}, "elsewhere", 0.007),
        ({"evidence": 119.5}, "evidence", 0.5),
        ({"inlier_share": 0.94}, "inlier share", 0.01),
        ({"dem_error_m": 3.1}, "DEM error", 0.1),
        ({"azimuth_bias_deg": 0.41}, "azimuth bias", 0.01),
        ({"tilt_bias_deg": 0.013}, "tilt bias", 0.003),
        ({"points": 630}, "points", 10.0),
    ],
)
def test_each_quantity_is_measured_and_reported_by_itself(fields, what, amount):
    comparison = judged(FIX, changed(**fields))
    assert [change.what for change in comparison.beyond] == [what]
    assert comparison.beyond[0].amount == pytest.approx(amount, rel=0.01)


@pytest.mark.parametrize(
    "fields",
    [
        {"covariance_m2": (4.05, 0.0, 9.1)},
        {"probability": 0.996},
        {"evidence": 120.05},
        {"inlier_share": 0.951},
        {"points": 641},
    ],
)
def test_what_is_within_its_tolerance_is_the_same_but_kept(fields):
    comparison = judged(FIX, changed(**fields))
    assert comparison.explanation is None
    assert len(comparison.changes) == 1


@pytest.mark.parametrize(
    ("frozen", "now", "why"),
    [
        (FIX, NONE, "other status"),
        (NONE, FIX, "other status"),
        (FIX, TWINS, "other status"),
        (NONE, Answer(status="refused", reason="DEM: too few cells"), "other status"),
        (FIX, changed(covariance_m2=(16.0, 0.0, 36.0)), "same place, other sigma"),
        (FIX, changed(probability=0.991, elsewhere=0.009), "same place, other probability"),
        (FIX, changed(evidence=140.0), "same place, other evidence"),
        (NONE, changed(NONE, reason="contradicted"), "other details"),
        (FIX, changed(left_out="E"), "other details"),
        (FIX, changed(crs="EPSG:32611"), "place moved"),
    ],
)
def test_the_explanation_follows_what_changed_most(frozen, now, why):
    assert judged(frozen, now).explanation == why


def other_place(answer: Answer, east_m: float, **fields) -> Answer:
    first = (EAST + east_m, NORTH, answer.candidates[0][2], 3.0)
    return changed(answer, easting_m=EAST + east_m, candidates=(first,), off_m=abs(east_m), **fields)


@pytest.mark.parametrize(
    ("evidence", "why"),
    [
        (120.05, "another place, same evidence"),
        (125.0, "another place, more evidence"),
        (90.0, "another place, less evidence"),
    ],
)
def test_another_place_is_explained_by_its_evidence(evidence, why):
    assert judged(FIX, other_place(FIX, 700.0, evidence=evidence)).explanation == why


def swapped(first: float, second: float) -> Answer:
    """The twins with the eastern one first."""
    places = (EAST + 3000.0, NORTH, first, 3.0), (EAST, NORTH, second, 3.0)
    return changed(TWINS, easting_m=EAST + 3000.0, probability=first, candidates=places)


def test_the_other_of_two_twins_is_a_swap():
    assert judged(TWINS, swapped(0.55, 0.45)).explanation == "twin swap"


def test_which_of_two_equals_comes_first_does_not_matter():
    equal = changed(
        TWINS, probability=0.501, candidates=((EAST, NORTH, 0.501, 3.0), (EAST + 3000.0, NORTH, 0.499, 3.0))
    )
    assert judged(equal, swapped(0.5005, 0.4995)).explanation is None


def test_an_alternative_that_is_gone_is_seen_where_all_else_is_equal():
    three = changed(TWINS, candidates=(*TWINS.candidates, (EAST, NORTH + 900.0, 0.02, 3.0)))
    (change,) = judged(three, TWINS).beyond
    assert (change.what, change.frozen, change.now) == ("alternatives", 3.0, 2.0)


def test_an_alternative_somewhere_else_is_seen():
    elsewhere = changed(TWINS, candidates=(TWINS.candidates[0], (EAST - 3000.0, NORTH, 0.45, 3.0)))
    assert judged(TWINS, elsewhere).explanation == "same place, other probability"


def test_a_negligible_alternative_is_not_compared():
    with_one_more = changed(candidates=(*FIX.candidates, (EAST + 80.0, NORTH, 0.0005, 3.0)))
    assert judged(FIX, with_one_more).explanation is None


def test_changed_inputs_are_told_from_a_changed_answer():
    other = compare_case("hand/made", case(FIX), case(FIX, inputs=("a1b2c3d4", 100.0, 52_009.0)))
    assert other.explanation == "inputs changed"
    assert other.changes == ()
    exact = compare_case("hand/made", case(FIX), case(FIX, inputs=("ffffffff", 100.0, 52_000.0)))
    assert exact.explanation == "inputs changed"


def test_last_bits_of_the_inputs_change_nothing():
    assert (
        compare_case("hand/made", case(FIX), case(FIX, inputs=("a1b2c3d4", 100.0, 52_000.4))).explanation
        is None
    )


def test_a_fix_far_from_the_truth_is_said_first():
    assert judged(FIX, other_place(FIX, 700.0)).alarm == "a fix 700 m from the truth"
    assert judged(FIX, changed(off_m=59.0)).alarm is None  # two cells
    assert judged(FIX, changed(off_m=61.0)).alarm is not None
    assert (
        judged(FIX, changed(off_m=61.0, covariance_m2=(64.0, 0.0, 64.0))).alarm is None
    )  # 5.4 of its sigmas of 11 m
    assert (
        judged(other_place(FIX, 700.0), other_place(FIX, 700.0)).alarm is None
    )  # it was one when it was frozen


def test_a_defect_is_said_first():
    comparison = judged(FIX, Answer(status="error", reason="ZeroDivisionError: division by zero"))
    assert comparison.alarm == "defect: ZeroDivisionError: division by zero"
    assert comparison.explanation == "other status"


def test_a_drive_is_compared_stop_by_stop():
    comparison = compare_case("hand/made", case(FIX, FIX, TWINS), case(FIX, changed(evidence=140.0), NONE))
    assert {change.look for change in comparison.beyond} == {1, 2}
    assert comparison.explanation == "same place, other evidence"  # of the first stop that differs


def test_a_drive_with_fewer_answers_differs():
    assert compare_case("hand/made", case(FIX, FIX), case(FIX)).explanation == "other status"


def test_new_cases_and_cases_that_are_gone_are_named():
    comparisons = compare({"a": case(FIX), "b": case(FIX)}, {"b": case(FIX), "c": case(FIX)})
    assert [(one.case, one.explanation) for one in comparisons] == [
        ("a", "case gone"),
        ("b", None),
        ("c", "new case"),
    ]


def test_the_json_has_all_that_a_program_needs():
    comparisons = compare(
        {"a": case(FIX), "b": case(FIX)}, {"a": case(NONE), "b": case(changed(evidence=120.05))}
    )
    content = json.loads(as_json(comparisons))
    assert (content["cases"], content["same"]) == (2, 1)
    assert content["explanations"] == {"other status": 1}
    (different,) = content["different"]
    assert different["case"] == "a"
    status = next(change for change in different["changes"] if change["what"] == "status")
    assert (status["frozen"], status["now"], status["beyond"]) == ("fix", "none", True)
    place = next(change for change in different["changes"] if change["what"] == "place")
    assert place["amount"] is None  # a place against none
    assert content["largest"]["evidence"] == {"amount": pytest.approx(0.05), "case": "b"}
    assert content["tolerances"]["place"] == 0.1


def test_a_line_of_the_file_reads_back_as_it_was():
    written = case(TWINS, NONE)
    assert Frozen.model_validate_json(written.to_line()) == written
