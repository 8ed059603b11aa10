"""Which tests run which line of a module, how long each takes, and running a choice of them."""

import contextlib
import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import coverage
import pytest

QUIET = ["-q", "--no-header", "--no-summary", "-p", "no:cacheprovider"]
PLUGINS = ("_hypothesis_pytestplugin", "pytest_timeout", "sim.pytest_plugin")
"""Of pytest, those that the tests need; the others only take time to load (``PYTEST_DISABLE_PLUGIN_AUTOLOAD``)."""


@dataclass
class Runs:
    """What one run of the tests of a module showed."""

    tests_by_line: dict[int, set[str]] = field(default_factory=dict)
    """Names of the tests that ran a line, of lines within functions."""
    seconds: dict[str, float] = field(default_factory=dict)
    failed: list[str] = field(default_factory=list)


def observe(module: Path, tests: Sequence[str]) -> Runs:
    """Run `tests` (files or folders) and see which of them run which lines of `module`."""
    measured = coverage.Coverage(data_file=None, include=[str(module)], config_file=False)
    watching = _Watching(measured)
    measured.start()
    try:
        status = run(tests, plugins=[watching])
    finally:
        measured.stop()
    runs = watching.runs
    if status not in (0, 1):
        runs.failed.append(f"pytest ended with status {status}")
    for line, names in measured.get_data().contexts_by_lineno(str(module)).items():
        runs.tests_by_line[line] = {name for name in names if name}
    return runs


def run(tests: Sequence[str], *, first_failure: bool = False, plugins: Sequence[object] = ()) -> int:
    """Run `tests` in this process, quietly; return pytest's exit status."""
    named = [part for plugin in PLUGINS for part in ("-p", plugin)]
    arguments = [*QUIET, *named, *(["-x"] if first_failure else []), *tests]
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        return int(pytest.main(arguments, plugins=list(plugins)))


class Chosen:
    """Runs the named tests only, the quickest first."""

    def __init__(self, seconds: dict[str, float]) -> None:
        self.seconds = seconds

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        chosen = [item for item in items if item.nodeid in self.seconds]
        items[:] = sorted(chosen, key=lambda item: self.seconds[item.nodeid])


class _Watching:
    """Tells `coverage` which test is running, and keeps times and failures."""

    def __init__(self, measured: coverage.Coverage) -> None:
        self.measured = measured
        self.runs = Runs()

    @pytest.hookimpl(hookwrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        self.measured.switch_context(item.nodeid)
        yield
        self.measured.switch_context("")

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self.runs.seconds[report.nodeid] = self.runs.seconds.get(report.nodeid, 0.0) + report.duration
        if report.failed:
            self.runs.failed.append(report.nodeid)
