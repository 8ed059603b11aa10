"""The page of faults that the tests notice names tests and modules that are there."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "noticed-faults.md").read_text()
TESTS = {
    name
    for file in ROOT.glob("tests/**/test_*.py")
    for name in re.findall(r"def (test_\w+)", file.read_text())
}


def test_it_has_a_row_for_many_faults() -> None:
    assert len(re.findall(r"^\| `(?:rig|localizer)/", PAGE, re.MULTILINE)) > 100


@pytest.mark.parametrize("test", sorted(set(re.findall(r"::(test_\w+)", PAGE))))
def test_a_test_that_it_names_is_there(test: str) -> None:
    assert test in TESTS


@pytest.mark.parametrize("module", sorted(set(re.findall(r"(?:rig|localizer)/[\w/]+\.py", PAGE))))
def test_a_module_that_it_names_is_there(module: str) -> None:
    assert (ROOT / module).is_file()
