"""Trials of the mutants of modules, in a copy of the project, several modules at a time."""

import compileall
import contextlib
import multiprocessing
import os
import pickle
import random
import shutil
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from multiprocessing.queues import SimpleQueue
from pathlib import Path
from typing import Any

import numba

from mutate.mutants import Mutant, mutants_of
from mutate.result import Result
from mutate.tests_of import Chosen, Runs, observe, run

COPIED = (
    "rig",
    "localizer",
    "sim",
    "tests",
    "configs",
    "docs",
    "systemd",
    "pyproject.toml",
    "README.md",
    "Makefile",
)
HEAVY = (
    "numpy", "scipy.optimize", "scipy.stats", "scipy.ndimage", "numba", "cv2", "pydantic", "click", "rich.console", "pyproj",
    "rasterio", "hypothesis", "fastapi", "structlog", "serial", "smbus2", "dynamixel_sdk", "coverage", "pytest",
)  # fmt: skip
"""Libraries that are loaded once, before the process forks into one child a mutant."""
KERNEL = "@kernel("
BASE_S = 20.0
SLOWER = 8.0
"""A mutant whose tests take longer than BASE_S and this many times their usual time does not end: the tests notice."""


def try_modules(
    root: Path, work: Path, modules: dict[str, list[str]], *, most: int | None, jobs: int
) -> Iterator[Result]:
    """Try the mutants of each module with the tests that are named for it; yield results as they come.

    `most` limits how many mutants of a module are tried: chosen at random, the same ones each time.
    """
    context = multiprocessing.get_context("fork")
    asked: SimpleQueue[Any] = context.SimpleQueue()
    answered: SimpleQueue[Any] = context.SimpleQueue()
    for name, tests in modules.items():
        asked.put((name, tests))
    workers = [
        context.Process(target=_work, args=(root, work / f"{os.getpid()}-{number}", most, asked, answered))
        for number in range(min(jobs, len(modules)))
    ]
    for worker in workers:
        asked.put(None)
        worker.start()
    try:
        for _ in modules:
            while answered.empty() and any(worker.is_alive() for worker in workers):
                time.sleep(0.2)
            if answered.empty():
                raise RuntimeError("a process of the trials ended early")
            yield answered.get()
    finally:
        for worker in workers:
            worker.terminate()
            worker.join()
        for number in range(len(workers)):
            shutil.rmtree(work / f"{os.getpid()}-{number}", ignore_errors=True)


def _work(
    root: Path, tree: Path, most: int | None, asked: SimpleQueue[Any], answered: SimpleQueue[Any]
) -> None:
    tree.mkdir(parents=True)
    for part in COPIED:
        if (root / part).is_dir():
            shutil.copytree(root / part, tree / part, symlinks=True)
        else:
            shutil.copy2(root / part, tree / part)
    for package in ("rig", "localizer", "sim"):
        compileall.compile_dir(tree / package, quiet=1)
    os.chdir(tree)
    os.environ["PYTHONPATH"] = str(tree)
    os.environ["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = "1"
    os.environ["CI"] = "1"  # hypothesis tries the same examples each time
    sys.path.insert(0, str(tree))
    for library in HEAVY:
        with contextlib.suppress(ImportError):
            __import__(library)
    while (question := asked.get()) is not None:
        module, tests = question
        answered.put(_try_module(tree, module, tests, most))


def _try_module(tree: Path, module: str, tests: list[str], most: int | None) -> Result:
    started = os.times()
    path = tree / module
    text = path.read_text()
    mutants = mutants_of(text)
    chosen = mutants
    if most is not None and most < len(mutants):
        order = {mutant: number for number, mutant in enumerate(mutants)}
        chosen = sorted(random.Random(module).sample(mutants, most), key=order.__getitem__)
    # Compiled code tells nobody which of its lines run, and would have to be compiled anew for each mutant.
    as_python = KERNEL in text
    runs = _observed(path, tests, as_python=as_python)
    if runs.failed:
        return Result(module, len(mutants), 0, (), 0.0, f"without a fault, {runs.failed[0]} fails")
    survivors = []
    modified = path.stat()
    try:
        for mutant in chosen:
            path.write_text(mutant.applied(text))
            _forget_compiled(path)
            if not _noticed(mutant, runs, as_python=as_python):
                survivors.append(mutant.name)
    finally:
        path.write_text(text)
        os.utime(path, ns=(modified.st_atime_ns, modified.st_mtime_ns))
        _forget_compiled(path)
    ended = os.times()
    cpu_s = sum(ended[:4]) - sum(started[:4])
    return Result(module, len(mutants), len(chosen), tuple(survivors), cpu_s)


def _forget_compiled(path: Path) -> None:
    for compiled in (path.parent / "__pycache__").glob(f"{path.stem}.*.pyc"):
        compiled.unlink()


def _observed(path: Path, tests: Sequence[str], *, as_python: bool) -> Runs:
    result = path.with_suffix(".observed")
    status = _in_child(
        lambda: _keep(result, observe(path, tests)), 3600.0, keep_bytecode=True, as_python=as_python
    )
    if status != 0:
        raise RuntimeError(f"the tests of {path} end with status {status}")
    try:
        runs: Runs = pickle.loads(result.read_bytes())
        return runs
    finally:
        result.unlink()


def _keep(path: Path, value: object) -> int:
    path.write_bytes(pickle.dumps(value))
    return 0


def _noticed(mutant: Mutant, runs: Runs, *, as_python: bool) -> bool:
    """Whether a test fails: first of those that ran the line, then of all that are in a file with one of those."""
    by_line = runs.tests_by_line
    ran: set[str] = set().union(
        *(by_line.get(line, set()) for line in range(mutant.line, mutant.last_line + 1))
    )
    if mutant.at_import:
        ran = set().union(*by_line.values())
    files = {name.split("::")[0] for name in ran}
    near = {name for name in runs.seconds if name.split("::")[0] in files}
    return any(_fails(names, runs, as_python=as_python) for names in (ran, near - ran) if names)


def _fails(names: set[str], runs: Runs, *, as_python: bool) -> bool:
    seconds = {name: runs.seconds[name] for name in names}
    files = sorted({name.split("::")[0] for name in names})
    usual_s = sum(seconds.values())
    status = _in_child(
        lambda: run(files, first_failure=True, plugins=[Chosen(seconds)]),
        BASE_S + SLOWER * usual_s,
        as_python=as_python,
    )
    return status != 0


def _in_child(
    work: Callable[[], int], limit_s: float, *, as_python: bool, keep_bytecode: bool = False
) -> int:
    """Exit status of `work` in a forked process; that and all that it has started end with it, at `limit_s` at the latest."""
    child = os.fork()
    if child == 0:
        status = 70
        try:
            os.setsid()
            sys.dont_write_bytecode = not keep_bytecode
            os.environ["PYTHONDONTWRITEBYTECODE"] = "" if keep_bytecode else "1"
            if as_python:
                os.environ["NUMBA_DISABLE_JIT"] = "1"
                numba.config.DISABLE_JIT = 1  # type: ignore[attr-defined]
            with Path(os.devnull).open("w") as nothing:
                os.dup2(nothing.fileno(), 1)
                os.dup2(nothing.fileno(), 2)
            status = work()
        finally:
            os._exit(status)
    until = time.monotonic() + limit_s
    ended_with: int | None = None
    while time.monotonic() < until and ended_with is None:
        ended, wait_status = os.waitpid(child, os.WNOHANG)
        if ended:
            ended_with = os.waitstatus_to_exitcode(wait_status)
        else:
            time.sleep(0.01)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)
    if ended_with is None:
        os.waitpid(child, 0)
        return -signal.SIGKILL
    return ended_with
