"""Fixtures that all tests share."""

import os
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings
from mutate.score import Book

# Two workers share the processors; linear algebra on threads of its own would make each wait for the other. Before numpy loads.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# How long one example takes says more about the machine's other work than about the code.
settings.register_profile("unhurried", deadline=None)
# What decides whether a change lands gives the same answer twice; everywhere else new examples are tried each time.
settings.register_profile("repeatable", deadline=None, derandomize=True)
settings.load_profile("repeatable" if os.environ.get("CI") else "unhurried")


def pytest_addoption(parser: pytest.Parser) -> None:
    """Options of the long tests."""
    parser.addoption("--captures", type=int, default=500, help="how many captures the soak test takes")
    parser.addoption(
        "--soak-minutes", type=float, default=15.0, help="how long the daemon's soak test goes on"
    )
    parser.addoption("--soak-seed", type=int, default=1, help="another seed, other faults")
    parser.addoption("--starts", type=int, default=5, help="how often the daemon is started for its figures")
    parser.addoption("--idle-s", type=float, default=60.0, help="how long the idle daemon is looked at")


LEFT_OUT = pytest.StashKey[Counter[str]]()
TARGETS = {"system": "make test-system", "long": "make test-all"}
"""The tests that the default run leaves out, by marker, and what runs them."""


def pytest_configure(config: pytest.Config) -> None:
    config.stash[LEFT_OUT] = Counter()


def pytest_deselected(items: Sequence[pytest.Item]) -> None:
    for item in items:
        marker = next((marker for marker in TARGETS if item.get_closest_marker(marker)), None)
        if marker is not None:
            item.config.stash[LEFT_OUT][marker] += 1


def pytest_sessionfinish(session: pytest.Session) -> None:
    if hasattr(session.config, "workeroutput"):
        session.config.workeroutput["left out"] = dict(session.config.stash[LEFT_OUT])


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any) -> None:
    """Of parallel workers, each of which has collected everything."""
    node.config.stash[LEFT_OUT] |= Counter(getattr(node, "workeroutput", {}).get("left out", {}))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    for marker, number in sorted(config.stash[LEFT_OUT].items()):
        terminalreporter.write_line(f"tests left out: {number} {marker} ({TARGETS[marker]})")
    stale = Book(Path(__file__).parent / "mutation").stale()
    if stale:
        terminalreporter.write_line(f"mutation scores out of date: {len(stale)} modules (make mutate)")


@pytest.fixture(scope="session")
def skyfix_data() -> Path:
    """The folder with terrain and pictures that are too large or not free enough to ship."""
    folder = os.environ.get("SKYFIX_DATA")
    if not folder:
        pytest.skip("SKYFIX_DATA is not set: it names the folder with the terrain that does not ship")
    return Path(folder)
