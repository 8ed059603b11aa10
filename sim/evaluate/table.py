"""The table of cases on disk: one line of settings, a CSV header, one row per case.

Rows are appended as they finish, so that an interrupted run can be resumed.
"""

import csv
import hashlib
import io
import json
import os
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

from pydantic import ValidationError

import localizer
from localizer.documents import DocumentError, json_values
from sim.errors import SimulationError
from sim.evaluate.case import Experiment
from sim.evaluate.row import CaseRow

COLUMNS = list(CaseRow.model_fields)
MARK = "# settings "


def settings_of(experiment: Experiment) -> dict[str, Any]:
    """Settings common to all rows of a table: the experiment, and the localizer's version."""
    return {
        "level": experiment.level,
        "estimator_only": experiment.estimator_only,
        "seed": experiment.seed,
        "dems": {dem.name: _digest(dem) for dem in experiment.dems},
        "scenario": experiment.scenario.model_dump(mode="json"),
        "localizer": _source_digest(),
    }


def read_table(path: Path, settings: dict[str, Any]) -> dict[int, CaseRow]:
    """The rows of an earlier run by case, none without one. A truncated line is ignored.

    Raises:
        SimulationError: the table was made with other settings, or is no such table.
    """
    if not path.exists():
        return {}
    try:
        text = path.read_text(encoding="utf-8")
        text = text[: text.rfind("\n") + 1]
        if not text:
            return {}
        first, _, body = text.partition("\n")
        if not first.startswith(MARK):
            raise ValueError("its first line holds no settings")
        _compare(path, json_values(first.removeprefix(MARK)), json.loads(json.dumps(settings)))
        rows = [CaseRow.from_cells(cells) for cells in csv.DictReader(io.StringIO(body))]
    except (ValueError, ValidationError, DocumentError, csv.Error) as error:
        reason = str(error).splitlines()[0]
        raise SimulationError(f"{path}: is no table of cases: {reason}; choose another --out") from error
    return {row.case: row for row in rows}


def start_table(path: Path, settings: dict[str, Any], rows: Sequence[CaseRow]) -> None:
    """Rewrite a table in the order of the cases; the old one stays until the new one is complete."""
    fresh = path.with_suffix(".part")
    with fresh.open("w", encoding="utf-8", newline="") as file:
        file.write(MARK + json.dumps(settings) + "\n")
        writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        writer.writeheader()
        for row in sorted(rows, key=lambda r: r.case):
            writer.writerow(row.to_cells())
        file.flush()
        os.fsync(file.fileno())  # else a power cut after the rename leaves an empty table
    fresh.replace(path)


def append_row(path: Path, row: CaseRow) -> None:
    """Add one row."""
    line = io.StringIO()
    csv.DictWriter(line, COLUMNS, lineterminator="\n").writerow(row.to_cells())
    with path.open("a", encoding="utf-8", newline="") as file:
        file.write(line.getvalue())


def _compare(path: Path, old: dict[str, Any], new: dict[str, Any]) -> None:
    different = [name for name in new if old.get(name) != new[name]]
    if different:
        raise SimulationError(
            f"{path}: holds cases made with another {' and '.join(different)}; choose another --out, or --fresh"
        )


def _digest(path: Path) -> str:
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()[:16]
    except OSError as error:
        raise SimulationError(f"DEM {path}: {error.strerror or error}; name a readable file") from error


@cache
def _source_digest() -> str:
    """Digest of the localizer's files, at first use in this process."""
    total = hashlib.sha256()
    folder = Path(localizer.__file__).parent
    for path in sorted(folder.rglob("*.py")):
        total.update(path.relative_to(folder).as_posix().encode() + path.read_bytes())
    return total.hexdigest()[:16]
