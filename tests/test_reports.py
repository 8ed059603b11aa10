"""docs/reports.md: every report has a source and a test that exists."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
REPORTS = ROOT / "docs" / "reports.md"
COLUMNS = ("report", "source", "what it does in the world", "test")


def rows() -> Iterator[list[str]]:
    """The cells of each report."""
    for line in REPORTS.read_text(encoding="utf-8").splitlines():
        cells = [cell.strip() for cell in line.removeprefix("|").removesuffix("|").split(" | ")]
        if line.startswith("|") and cells[0] not in (COLUMNS[0], "---"):
            yield cells


def names_of_tests(path: Path) -> set[str]:
    """Names of the test functions in a file."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)}


@pytest.mark.parametrize("cells", [pytest.param(cells, id=cells[0][:60]) for cells in rows()])
def test_a_report_names_its_source_and_tests_that_exist(cells: list[str]) -> None:
    assert len(cells) == len(COLUMNS), cells
    assert all(cells), cells
    named = re.findall(r"`(tests/[^`:]+\.py)::(test_[^`\[]+)[^`]*`", cells[-1])
    assert named, f"no test is named as `tests/FILE.py::test_NAME`: {cells[-1]}"
    for file, test in named:
        assert (ROOT / file).is_file(), file
        assert test in names_of_tests(ROOT / file), f"{file} has no {test}"
