"""The search answers a few quick cases of different kinds as it did when the answers were frozen; `make answers` asks all."""

import pytest
from frozen_answers.__main__ import FROZEN
from frozen_answers.answer import read_frozen
from frozen_answers.cases import all_cases
from frozen_answers.compare import compare_case
from frozen_answers.explain import is_wrong_fix
from frozen_answers.run import compute

QUICK = [
    "scenario/few_frames/1",
    "pictures/all-in-fog",
    "twins/prior-around-one",
    "ground/tiny-2",
    "files/two-files",
    "readings/altitude-wrong-+3000-m",
    "drive/hills-near",
]
MISSTATED_CRS = {
    "files/crs-wrong-hemisphere",
    "files/crs-neighbouring-zone",
    "files/nad27-utm",
    "files/nad27-degrees",
}
"""Their files name another CRS than the one that the camera stands in: right in the grid, wrong on the Earth."""


@pytest.fixture(scope="module")
def frozen():
    return read_frozen(FROZEN)


@pytest.mark.parametrize("name", QUICK)
def test_a_quick_case_is_answered_as_it_was(frozen, name):
    comparison = compare_case(name, frozen[name], compute(name).found)
    assert comparison.explanation is None, [change.text() for change in comparison.beyond]


def test_every_case_is_frozen_and_every_frozen_answer_has_its_case(frozen):
    assert sorted(frozen) == sorted(all_cases())


def test_the_file_is_small_sorted_and_without_defects(frozen):
    assert FROZEN.stat().st_size < 500_000
    assert list(frozen) == sorted(frozen)
    assert not [name for name, case in frozen.items() if any(one.status == "error" for one in case.answers)]


def test_all_statuses_are_among_the_answers(frozen):
    statuses = [answer.status for case in frozen.values() for answer in case.answers]
    for status in ("fix", "ambiguous", "none", "refused"):
        assert statuses.count(status) >= 4, status


def test_no_frozen_fix_is_far_from_the_truth(frozen):
    # a wrong place called a fix is the worst that the search can do
    wrong = {name for name, case in frozen.items() if any(map(is_wrong_fix, case.answers))}
    assert wrong - MISSTATED_CRS == set()
