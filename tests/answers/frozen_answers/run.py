"""Answers of many cases, in processes of one thread each, kept on the disk as they come."""

import hashlib
import importlib.metadata
import itertools
import multiprocessing
import os
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from pathlib import Path

from pydantic import BaseModel, ConfigDict, ValidationError

import localizer
import sim
from frozen_answers.answer import Answer, Frozen, answers_to
from frozen_answers.cases import all_cases
from frozen_answers.inputs import fingerprint

THREADS = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")
MAKING = ("answer", "ground", "inputs", "looks")
"""Modules of this package, beside the cases, on which an answer depends."""
COMPUTING = ("numpy", "scipy", "numba", "opencv-python-headless", "pyproj", "rasterio")


class Computed(BaseModel):
    """A line of the file of a run. ``code``: digest of what computed it; ``cpu_s``: processor time."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    code: str
    cpu_s: float
    found: Frozen


def compute(name: str) -> Computed:
    """Make the input of a case, and search. A defect of the program is an answer, so that the other cases go on."""
    begin = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        question = all_cases()[name](Path(folder))
        inputs = fingerprint(question)
        try:
            answers = answers_to(question, Path(folder))
        except Exception as error:  # noqa: BLE001 - reported, and never frozen
            traceback.print_exc()
            answers = (Answer(status="error", reason=f"{type(error).__name__}: {error}"),)
    found = Frozen(case=name, input=(inputs.text, *inputs.numbers), answers=answers)
    return Computed(code=code_digest(), cpu_s=round(time.process_time() - begin, 2), found=found)


def run(
    names: Sequence[str],
    results: Path,
    *,
    jobs: int = 2,
    fresh: bool = False,
    report: Callable[[Computed, bool], None] = lambda _computed, _kept: None,
) -> dict[str, Computed]:
    """The answers of the cases, by name. Those in ``results`` that the same code computed are taken from there.

    ``report``: called for each case; the second argument says whether it was taken from there.
    """
    kept = {} if fresh else _read(results)
    results.parent.mkdir(parents=True, exist_ok=True)
    results.write_text("".join(f"{line.model_dump_json()}\n" for line in kept.values()), encoding="utf-8")
    found = {name: kept[name] for name in names if name in kept}
    for computed in found.values():
        report(computed, True)
    missing = [name for name in names if name not in found]
    with results.open("a", encoding="utf-8") as file:
        for computed in _in_processes(missing, jobs) if jobs > 1 else map(compute, missing):
            file.write(f"{computed.model_dump_json()}\n")
            file.flush()
            found[computed.found.case] = computed
            report(computed, False)
    return found


def _read(results: Path) -> dict[str, Computed]:
    if not results.exists():
        return {}
    found = {}
    for line in results.read_text(encoding="utf-8").splitlines():
        try:
            computed = Computed.model_validate_json(line)
        except ValidationError:
            continue  # the line at which the run was interrupted
        if computed.code == code_digest():
            found[computed.found.case] = computed
    return found


def _in_processes(names: Sequence[str], jobs: int) -> Iterator[Computed]:
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, "1"))
    # New processes, not forks: numba takes its number of threads at the start.
    pool = ProcessPoolExecutor(
        jobs, multiprocessing.get_context("spawn"), initializer=_leave_interrupts_to_parent
    )
    try:
        waiting: list[Future[Computed]] = [pool.submit(compute, name) for name in names]
        for done in as_completed(waiting):
            yield done.result()
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _leave_interrupts_to_parent() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)


_DIGEST: list[str] = []


def code_digest() -> str:
    """Of the sources of localizer, sim and the cases, and of the versions of what they compute with."""
    if not _DIGEST:
        digest = hashlib.sha256(sys.version.encode())
        for name in COMPUTING:
            digest.update(f"{name} {importlib.metadata.version(name)}".encode())
        here = Path(__file__).parent
        cases = [*(here / "cases").rglob("*.py"), *(here / f"{name}.py" for name in MAKING)]
        packages = [Path(package.__file__ or "").parent.rglob("*") for package in (localizer, sim)]
        for path in sorted([*cases, *itertools.chain(*packages)]):
            if path.suffix in (".py", ".toml", ".tif"):
                digest.update(path.read_bytes())
        _DIGEST.append(digest.hexdigest()[:16])
    return _DIGEST[0]
