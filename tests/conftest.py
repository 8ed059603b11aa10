"""Fixtures that all tests share."""

import os
from pathlib import Path

import pytest
from hypothesis import settings

# How long one example takes says more about the machine's other work than about the code.
settings.register_profile("unhurried", deadline=None)
# What decides whether a change lands gives the same answer twice; everywhere else new examples are tried each time.
settings.register_profile("repeatable", deadline=None, derandomize=True)
settings.load_profile("repeatable" if os.environ.get("CI") else "unhurried")


def pytest_addoption(parser: pytest.Parser) -> None:
    """Options of the soak test."""
    parser.addoption("--captures", type=int, default=500, help="how many captures the soak test takes")
    parser.addoption("--soak-seed", type=int, default=1, help="another seed, other faults")


@pytest.fixture(scope="session")
def skyfix_data() -> Path:
    """The folder with terrain and pictures that are too large or not free enough to ship."""
    folder = os.environ.get("SKYFIX_DATA")
    if not folder:
        pytest.skip("SKYFIX_DATA is not set: it names the folder with the terrain that does not ship")
    return Path(folder)
