"""All constants, each halved and doubled, over the same cases; a run that was interrupted goes on."""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from localizer.documents import DocumentError, json_values
from sim.errors import SimulationError
from sim.evaluate.row import CaseRow
from sim.evaluate.run import ONE_THREAD
from sim.evaluate.sensitivity.constants import FACTORS, Setting, Tuned
from sim.evaluate.sensitivity.variant import change_constant, copy_localizer
from sim.evaluate.table import _source_digest

SCENARIOS = ("realistic", "dem_error", "few_frames", "occluded", "twins")
"""In ``configs/scenarios/evaluate``; the exact DEM is measured with the first."""
DEFAULT = "default"


@dataclass(frozen=True)
class Measured:
    """The cases as one variant located them. ``cpu_s``: of the whole process, drawing the cases included."""

    rows: tuple[CaseRow, ...]
    scenarios: tuple[str, ...]
    cpu_s: float


@dataclass(frozen=True)
class Plan:
    """The cases: ``cases`` of each scenario, numbers 0, 1, ..., on one DEM."""

    dem: Path
    scenarios: tuple[Path, ...]
    cases: int
    seed: int

    def jobs(self) -> dict[str, Any]:
        """As the worker reads it."""
        every = [[str(path.resolve()), case] for path in self.scenarios for case in range(self.cases)]
        exact = [job for job in every if job[0] == every[0][0]]
        return {"dem": str(self.dem.resolve()), "seed": self.seed, "contours": every, "exact DEM": exact}


def measure(
    plan: Plan, constants: Sequence[Tuned], store: Path, report: Callable[[str, dict[str, Measured]], None]
) -> dict[str, Measured]:
    """What each variant came to, by ``key``. ``store`` (JSON Lines) keeps each as it comes; those in it are not run again.

    ``report`` is told of each variant when it is done, and of all that are done.

    Raises:
        SimulationError: a variant could not locate the cases, or ``store`` holds another plan's.
    """
    done = _stored(store, plan)
    settings: list[Setting] = sorted({tuned.setting for tuned in constants})
    wanted: list[tuple[str, Setting, Tuned | None, float]] = [
        (key(setting), setting, None, 1.0) for setting in settings
    ]
    wanted += [
        (key(tuned.setting, tuned, name), tuned.setting, tuned, factor)
        for tuned in constants
        for name, factor in FACTORS.items()
    ]
    missing = [variant for variant in wanted if variant[0] not in done]
    if missing:
        with tempfile.TemporaryDirectory(prefix="skyfix-sensitivity-") as folder, _worker(plan) as ask:
            base = copy_localizer(Path(folder) / "base")
            ask(base, missing[0][1])  # compiles the kernels, which would count as time of the first variant
            for number, (name, setting, tuned, factor) in enumerate(missing):
                done[name] = _measured(ask, base, Path(folder), setting, tuned, factor)
                _append(store, name, done[name])
                report(f"{number + 1} of {len(missing)}: {name}", done)
    return {name: done[name] for name, *_ in wanted}


def key(setting: Setting, tuned: Tuned | None = None, change: str = DEFAULT) -> str:
    """Of a variant: ``contours: decide.FIX_EVIDENCE half``."""
    return f"{setting}: {f'{tuned.label} ' if tuned else ''}{change}"


def _measured(
    ask: Callable[[Path, Setting], list[dict[str, Any]] | None],
    base: Path,
    folder: Path,
    setting: Setting,
    tuned: Tuned | None,
    factor: float,
) -> Measured:
    """The default is located with the copy itself, the others with copies of that."""
    if tuned is None:
        rows = ask(base, setting)
    else:
        with tempfile.TemporaryDirectory(dir=folder) as variant:
            change_constant(copy_localizer(Path(variant), base), tuned, factor)
            rows = ask(Path(variant), setting)
    if rows is None:
        raise SimulationError(
            f"{tuned.label if tuned else 'the default'}: the cases could not be located, see above"
        )
    return _from_fields(rows)


def _from_fields(rows: list[dict[str, Any]]) -> Measured:
    scenarios = tuple(str(row.pop("scenario")) for row in rows)
    cpu_s = sum(float(row.pop("cpu_s")) for row in rows)
    return Measured(tuple(CaseRow.model_validate(row) for row in rows), scenarios, cpu_s)


@contextmanager
def _worker(plan: Plan) -> Iterator[Callable[[Path, Setting], list[dict[str, Any]] | None]]:
    process = subprocess.Popen(
        [sys.executable, "-m", "sim.evaluate.sensitivity.worker", json.dumps(plan.jobs())],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=os.environ | ONE_THREAD,
    )

    def ask(folder: Path, setting: Setting) -> list[dict[str, Any]] | None:
        assert process.stdin is not None
        assert process.stdout is not None
        _send(process.stdin, {"folder": str(folder), "setting": setting})
        line = process.stdout.readline()
        if not line:
            raise SimulationError("the process that locates the cases has ended, see above")
        rows: list[dict[str, Any]] | None = json.loads(line)
        return rows

    try:
        yield ask
    finally:
        assert process.stdin is not None
        process.stdin.close()
        process.wait()


def _send(pipe: IO[str], request: dict[str, str]) -> None:
    pipe.write(json.dumps(request) + "\n")
    pipe.flush()


def _stored(store: Path, plan: Plan) -> dict[str, Measured]:
    if not store.exists():
        store.write_text(json.dumps({"plan": _facts(plan)}) + "\n", encoding="utf-8")
        return {}
    text = store.read_text(encoding="utf-8")
    complete = text[: text.rfind("\n") + 1]  # a line that was cut off does not count
    try:
        first, *lines = [json_values(line) for line in complete.splitlines()]
        if first["plan"] != _facts(plan):
            raise SimulationError(f"{store}: holds other cases, or another localizer's; choose another --out")
        return {
            fields["variant"]: Measured(
                tuple(CaseRow.model_validate(row) for row in fields["rows"]),
                tuple(fields["scenarios"]),
                fields["cpu_s"],
            )
            for fields in lines
        }
    except (DocumentError, ValueError, KeyError, TypeError):
        raise SimulationError(f"{store}: is no file of this command; choose another --out") from None


def _facts(plan: Plan) -> dict[str, Any]:
    return {
        "dem": plan.dem.name,
        "scenarios": [path.stem for path in plan.scenarios],
        "cases": plan.cases,
        "seed": plan.seed,
        "localizer": _source_digest(),
    }


def _append(store: Path, name: str, measured: Measured) -> None:
    fields = {
        "variant": name,
        "scenarios": measured.scenarios,
        "cpu_s": measured.cpu_s,
        "rows": [row.model_dump() for row in measured.rows],
    }
    with store.open("a", encoding="utf-8") as file:
        file.write(json.dumps(fields) + "\n")
