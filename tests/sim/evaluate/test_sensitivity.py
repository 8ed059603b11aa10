"""A constant of the search is halved or doubled in a copy of the localizer, and reaches all that uses it."""

import ast
import json
import re
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import pytest

import localizer
from sim.errors import SimulationError
from sim.evaluate.row import CaseRow
from sim.evaluate.sensitivity.constants import FACTORS, TUNED, Tuned
from sim.evaluate.sensitivity.run import SCENARIOS, Measured, Plan, key, measure
from sim.evaluate.sensitivity.table import as_markdown, lines
from sim.evaluate.sensitivity.variant import change_constant, copy_localizer

SEARCH = Path(localizer.__file__).parent / "search"
BY_NAME = {tuned.label: tuned for tuned in TUNED}


@pytest.fixture(scope="module")
def base(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return copy_localizer(tmp_path_factory.mktemp("base"))


def values_in_copy(folder: Path, code: str) -> list[float]:
    """What ``code`` prints as JSON where the localizer comes from the folder."""
    program = f"import json, sys; sys.path.insert(0, {str(folder)!r}); {code}"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    values: list[float] = json.loads(done.stdout)
    return values


def changed(base: Path, folder: Path, label: str, factor: float) -> Path:
    change_constant(copy_localizer(folder, base), BY_NAME[label], factor)
    return folder


def test_a_doubled_constant_reaches_modules_that_import_it_by_value_and_default_arguments(base, tmp_path):
    code = (
        "import inspect; from localizer.search.fit import local_optima, outliers, refine; "
        "print(json.dumps([outliers.GEMAN_MCCLURE_SIGMAS, refine.LIKELIHOOD_FROM, "
        "inspect.signature(local_optima.refit).parameters['likelihood_from'].default]))"
    )
    scale = changed(base, tmp_path / "scale", "stage2.GEMAN_MCCLURE_SIGMAS", 2.0)
    count = changed(base, tmp_path / "count", "fit.refine.LIKELIHOOD_FROM", 0.5)
    assert values_in_copy(base, code) == [4.0, 8, 8]
    assert values_in_copy(scale, code) == [8.0, 8, 8]
    assert values_in_copy(count, code) == [4.0, 4, 4]


@pytest.mark.long
def test_a_doubled_constant_reaches_compiled_kernels(base, tmp_path):
    """One column that is a hundred sigmas off costs what an outlier costs."""
    code = (
        "import numpy as np; from localizer.search.fit.correlated_errors import *; one = np.ones(1); "
        "columns = Columns(0.1 * one, np.zeros((1, 5)), 1e-6 * one, 1e-9 * one, np.inf * one, 30.0, np.eye(5), "
        "np.zeros(5)); print(json.dumps([whitened_nll(columns, ErrorModel(0.1, 0.1, 240.0))]))"
    )
    assert values_in_copy(base, code) == [6.0]
    # the base's compiled kernel lies beside it now, and must not serve the variant
    doubled = changed(base, tmp_path / "doubled", "fit.correlated_errors.OUTLIER_NLL", 2.0)
    assert values_in_copy(doubled, code) == [12.0]


@pytest.mark.parametrize("tuned", TUNED, ids=lambda tuned: tuned.label)
def test_every_constant_can_be_changed_and_says_that_it_is_tuned(tuned, tmp_path):
    path = Path("localizer", "search", *tuned.module.split(".")).with_suffix(".py")
    source = (SEARCH.parents[1] / path).read_text(encoding="utf-8")
    (tmp_path / path).parent.mkdir(parents=True)
    (tmp_path / path).write_text(source, encoding="utf-8")
    for factor in FACTORS.values():
        change_constant(tmp_path, tuned, factor)
    assert (tmp_path / path).read_text(encoding="utf-8") != source
    ast.parse((tmp_path / path).read_text(encoding="utf-8"))
    assert re.search(r"Tuned\s+on|Chosen", docstring_of(source, tuned.name))


def docstring_of(source: str, name: str) -> str:
    """The string below a constant's assignment."""
    body = ast.parse(source).body
    for statement, following in pairwise(body):
        if isinstance(statement, ast.Assign) and ast.unparse(statement.targets[0]) == name:
            assert isinstance(following, ast.Expr), f"{name} has no docstring"
            return str(ast.literal_eval(following.value))
    raise AssertionError(f"{name} is not assigned")


@pytest.mark.parametrize(
    ("kind", "value", "factor", "becomes"),
    [
        ("scale", "3.0", 2.0, 6.0),
        ("complement", "0.99", 0.5, 0.995),
        ("count", "3", 0.5, 2),
        ("count", "1", 0.5, 1),
        ("first", "(2.4, 0.4)", 0.5, (1.2, 0.4)),
        ("all", "(0.2, 1.5)", 2.0, (0.4, 3.0)),
    ],
)
def test_half_and_double_of_each_kind(tmp_path, kind, value, factor, becomes):
    path = tmp_path / "localizer" / "search" / "some.py"
    path.parent.mkdir(parents=True)
    path.write_text(f"BEFORE = 1\nIT = {value}  # of something\nAFTER = 2\n", encoding="utf-8")
    change_constant(tmp_path, Tuned("some", "IT", "", kind), factor)
    names: dict[str, object] = {}
    exec(path.read_text(encoding="utf-8"), names)
    assert names["IT"] == pytest.approx(becomes)
    assert (names["BEFORE"], names["AFTER"]) == (1, 2)


def test_a_constant_that_is_not_there_is_an_error(base, tmp_path):
    with pytest.raises(SimulationError, match="assigns NONE_SUCH 0 times"):
        change_constant(copy_localizer(tmp_path, base), Tuned("decide", "NONE_SUCH", ""), 2.0)


def row(status: str = "fix", easting_m: float = 0.0, error_m: float = 1.0) -> CaseRow:
    known = {name: 0 for name, field in CaseRow.model_fields.items() if field.is_required()}
    return CaseRow.model_validate(
        known
        | {
            "dem": "a.tif",
            "outside": False,
            "truth_among": True,
            "after": "{}",
            "timing_s": "{}",
            "status": status,
            "easting_m": easting_m,
            "northing_m": 0.0,
            "error_m": error_m,
            "error_cells": error_m / 30.0,
            "mahalanobis2": error_m**2,
            "sigma_major_m": 2.0,
        }
    )


def measured(*rows: CaseRow, cpu_s: float = 10.0) -> Measured:
    return Measured(rows, ("realistic",) * len(rows), cpu_s)


def test_the_table_compares_each_variant_with_the_default_case_by_case():
    evidence, reach = BY_NAME["decide.FIX_EVIDENCE"], BY_NAME["stage1.SIGMAS"]
    variants = {
        key("contours"): measured(row(), row()),
        key("contours", evidence, "half"): measured(row(), row(easting_m=1.0, error_m=3.0), cpu_s=5.0),
        key("contours", evidence, "double"): measured(row("ambiguous"), row("fix", 4.0, error_m=300.0)),
    }
    default, half, double = lines(variants, [evidence, reach])
    assert (default.fixes, default.status_changes, default.time_ratio) == (2, 0, 1.0)
    assert (half.median_error_m, half.median_shift_sigmas, half.time_ratio) == (2.0, 0.25, 0.5)
    assert (half.median_sigma_ratio, default.median_sigma_ratio) == (1.0, 1.0)
    assert (double.fixes, double.ambiguous, double.status_changes, double.wrong_fixes) == (1, 1, 1, 1)
    text = as_markdown(
        [default, half, double], [evidence, reach], Plan(Path("a.tif"), (Path("realistic.toml"),), 2, 1), "it"
    )
    assert "| `decide.FIX_EVIDENCE` |" in text
    assert "| `stage1.SIGMAS` |" not in text
    assert "Not measured yet: `stage1.SIGMAS`." in text


@pytest.mark.long
def test_a_run_measures_keeps_and_goes_on(santa_cruz, tmp_path):
    scenarios = Path(__file__).parents[3] / "configs" / "scenarios" / "evaluate"
    plan = Plan(santa_cruz, (scenarios / f"{SCENARIOS[0]}.toml",), 1, 4)
    constant = BY_NAME["decide.FIX_EVIDENCE"]
    told: list[str] = []
    store = tmp_path / "variants.jsonl"
    first = measure(plan, [constant], store, lambda line, _done: told.append(line))
    assert len(first) == len(told) == 3
    assert {m.rows[0].status for m in first.values()} <= {"fix", "ambiguous"}
    assert measure(plan, [constant], store, lambda line, _done: told.append(line)) == first
    assert len(told) == 3
    with pytest.raises(SimulationError, match="other cases"):
        measure(Plan(plan.dem, plan.scenarios, 2, 4), [constant], store, lambda _line, _done: None)
