"""Runs all cases of an experiment, in parallel if requested, resumable after an interruption."""

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from pathlib import Path

from sim.evaluate.case import Experiment, run_case
from sim.evaluate.row import CaseRow
from sim.evaluate.table import append_row, read_table, settings_of, start_table

ONE_THREAD = {"NUMBA_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


def run_cases(
    experiment: Experiment,
    cases: Sequence[int],
    table: Path,
    jobs: int = 1,
    fresh: bool = False,
    report: Callable[[CaseRow], None] = lambda _row: None,
) -> list[CaseRow]:
    """The rows of the cases; those already in ``table`` are not computed again.

    Each row is on disk before ``report`` is called. With more than one job the cases run in separate single-threaded
    processes; results do not depend on that.

    Raises:
        SimulationError: a DEM cannot be used, or the table was made with other settings.
    """
    settings = settings_of(experiment)
    rows = {} if fresh else read_table(table, settings)
    start_table(table, settings, list(rows.values()))
    missing = [case for case in cases if case not in rows]
    for row in (
        _in_processes(experiment, missing, jobs) if jobs > 1 else _in_this_process(experiment, missing)
    ):
        append_row(table, row)
        rows[row.case] = row
        report(row)
    start_table(table, settings, list(rows.values()))
    return [rows[case] for case in cases]


def _in_this_process(experiment: Experiment, cases: Sequence[int]) -> Iterator[CaseRow]:
    for case in cases:
        yield run_case(experiment, case)


def _in_processes(experiment: Experiment, cases: Sequence[int], jobs: int) -> Iterator[CaseRow]:
    if not cases:
        return
    with _environment(ONE_THREAD):
        # New processes, not forks: numba needs its number of threads at start-up.
        pool = ProcessPoolExecutor(
            min(jobs, len(cases)), multiprocessing.get_context("spawn"), initializer=_ignore_interrupts
        )
        try:
            waiting: list[Future[CaseRow]] = [pool.submit(run_case, experiment, case) for case in cases]
            for done in as_completed(waiting):
                yield done.result()
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def _ignore_interrupts() -> None:
    """Ignore Ctrl-C, which reaches the whole process group: the parent decides, workers finish their case."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextmanager
def _environment(changes: dict[str, str]) -> Iterator[None]:
    before = {name: os.environ.get(name) for name in changes}
    os.environ.update(changes)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
