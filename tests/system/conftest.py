"""What the system tests share: they need programs of the operating system, which tests/system/packages installs."""

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

Program = Callable[[str], Path]


@pytest.fixture(scope="session")
def program() -> Program:
    """Gives the path of a program; the test fails where it is not installed."""

    def find(name: str) -> Path:
        found = shutil.which(name, path=os.environ["PATH"] + ":/usr/sbin:/sbin")
        if found is None:
            pytest.fail(f"{name} is not installed: tests/system/packages installs it", pytrace=False)
        return Path(found)

    return find
