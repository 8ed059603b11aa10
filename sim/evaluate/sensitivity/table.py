"""The table of a sensitivity run, in Markdown and as JSON."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from sim.evaluate.row import CaseRow
from sim.evaluate.sensitivity.constants import FACTORS, Tuned
from sim.evaluate.sensitivity.run import DEFAULT, Measured, Plan, key
from sim.evaluate.summary import coverage, is_wrong_fix, right_fixes


@dataclass(frozen=True)
class Line:
    """One variant. None where no case has the figure."""

    constant: str
    meaning: str
    change: str
    """``default``, ``half`` or ``double``."""
    setting: str
    fixes: int
    wrong_fixes: int
    ambiguous: int
    none: int
    status_changes: int
    """Cases whose status differs from the default's."""
    median_error_m: float | None
    """Of the fixes."""
    median_shift_sigmas: float | None
    """How far places moved from the default's, in its standard deviations (longer axis), over cases that have both."""
    median_sigma_ratio: float | None
    """Standard deviation of a place (longer axis) over the default's, over cases that have both."""
    coverage_95: float | None
    """Share of the fixes that are not wrong whose truth lies in the 95 % ellipse."""
    time_ratio: float
    """CPU time over the default's."""


def lines(measured: Mapping[str, Measured], constants: Sequence[Tuned]) -> list[Line]:
    """The default of each setting, then the constants halved and doubled, as far as they were measured."""
    settings = list(dict.fromkeys(tuned.setting for tuned in constants))
    bases = {setting: measured[key(setting)] for setting in settings if key(setting) in measured}
    out = [_line("all as they are", "", DEFAULT, setting, base, base) for setting, base in bases.items()]
    for tuned in constants:
        for change in FACTORS:
            variant = measured.get(key(tuned.setting, tuned, change))
            if variant is not None:
                base = bases[tuned.setting]
                out.append(_line(tuned.label, tuned.meaning, change, tuned.setting, variant, base))
    return out


def _line(constant: str, meaning: str, change: str, setting: str, variant: Measured, base: Measured) -> Line:
    rows = variant.rows
    fixes = [row for row in rows if row.status == "fix"]
    errors_m = [row.error_m for row in fixes if row.error_m is not None]
    shifts = [s for s in map(_shift_sigmas, rows, base.rows) if s is not None]
    pairs = [(row.sigma_major_m, old.sigma_major_m) for row, old in zip(rows, base.rows, strict=True)]
    ratios = [new / old for new, old in pairs if new is not None and old is not None]
    return Line(
        constant=constant,
        meaning=meaning,
        change=change,
        setting=setting,
        fixes=len(fixes),
        wrong_fixes=sum(map(is_wrong_fix, rows)),
        ambiguous=sum(row.status == "ambiguous" for row in rows),
        none=sum(row.status == "none" for row in rows),
        status_changes=sum(row.status != old.status for row, old in zip(rows, base.rows, strict=True)),
        median_error_m=float(np.median(errors_m)) if errors_m else None,
        median_shift_sigmas=float(np.median(shifts)) if shifts else None,
        median_sigma_ratio=float(np.median(ratios)) if ratios else None,
        coverage_95=coverage(right_fixes(rows))["0.95"],
        time_ratio=variant.cpu_s / base.cpu_s,
    )


def _shift_sigmas(row: CaseRow, base: CaseRow) -> float | None:
    if row.easting_m is None or base.easting_m is None or base.sigma_major_m is None:
        return None
    assert row.northing_m is not None
    assert base.northing_m is not None
    return float(
        np.hypot(row.easting_m - base.easting_m, row.northing_m - base.northing_m) / base.sigma_major_m
    )


def as_fields(table: Sequence[Line]) -> list[dict[str, Any]]:
    """For JSON."""
    return [asdict(line) for line in table]


def as_markdown(table: Sequence[Line], constants: Sequence[Tuned], plan: Plan, command: str) -> str:
    """A page: what was run, how to read it, the table, and the constants that it lacks."""
    count = len(plan.scenarios) * plan.cases
    names = ", ".join(f"`{path.stem}`" for path in plan.scenarios)
    head = (
        "constant",
        "meaning",
        "change",
        "fix",
        "wrong",
        "amb.",
        "none",
        "status changed",
        "median error m",
        "median shift, sigma",
        "sigma ratio",
        "in 95 %",
        "time",
    )
    rows = [_row(head), _row(["---"] * len(head))]
    for line in table:
        rows.append(
            _row(
                (
                    f"`{line.constant}`" if line.meaning else f"{line.constant}, {line.setting}",
                    line.meaning,
                    line.change,
                    str(line.fixes),
                    str(line.wrong_fixes),
                    str(line.ambiguous),
                    str(line.none),
                    str(line.status_changes) if line.status_changes else "-",
                    _number(line.median_error_m),
                    _number(line.median_shift_sigmas),
                    _number(line.median_sigma_ratio),
                    "-" if line.coverage_95 is None else f"{line.coverage_95:.0%}",
                    f"{line.time_ratio:.2f}",
                )
            )
        )
    return "\n".join(
        [
            "# Sensitivity of the search to its tuned constants",
            "",
            f"Made by `{command}`. Each constant of `localizer/search` was halved and doubled, and the same {count} cases were "
            f"located again: {plan.cases} of each of the scenarios {names} (`configs/scenarios/evaluate`), DEM "
            f"`{plan.dem.name}`, seed {plan.seed}, contours without pictures. Constants that matter only where the DEM is the "
            "terrain itself were measured with the first scenario and contours of the searched surface (`exact DEM`).",
            "",
            "- *half*, *double*: of a probability or a share, its distance from 1; of a grid, its reach.",
            "- *wrong*: a fix more than 5 cells and 5 sigma from the truth. *status changed*: cases whose status differs "
            "from the default's.",
            "- *median shift*: how far the place moves from the default's, in the default's standard deviations. *sigma "
            "ratio*: standard deviation of the place over the default's, median.",
            "- *in 95 %*: share of the fixes that are not wrong whose truth lies in the 95 % ellipse. *time*: CPU time over "
            "the default's, drawing the cases included.",
            "- The cases are few: the table shows which constants change an answer at all, not rates. `--cases` takes more.",
            "",
            *rows,
            "",
            *_missing(table, constants),
        ]
    )


def _missing(table: Sequence[Line], constants: Sequence[Tuned]) -> list[str]:
    """Constants that an interrupted run has not halved and doubled both."""
    rows = [line.constant for line in table]
    names = [f"`{tuned.label}`" for tuned in constants if rows.count(tuned.label) < len(FACTORS)]
    return [f"Not measured yet: {', '.join(names)}.", ""] if names else []


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def _row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"
