"""Compiled kernels are used again as long as nothing that they were compiled from has changed, and no longer."""

import ast
import importlib
import os
import pkgutil
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numba
import numpy as np
import pytest
from numba.core.dispatcher import Dispatcher

import localizer
import sim
from localizer import kernel_cache

CALLED = """
from localizer.jit import kernel

@kernel()
def tenfold(x):
    return 10 * x
"""
CALLER = """
from localizer.jit import kernel
from pair.called import tenfold
from pair.constants import (
    OFFSET,  # (of no unit)
)

@kernel()
def outer(x):
    return tenfold(x) + OFFSET
"""
CONSTANTS = "OFFSET = 0\n"


@pytest.fixture
def pair(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A package in which a kernel calls one of another module and names a constant of a third."""
    folder = tmp_path / "pair"
    folder.mkdir()
    for name, text in (("__init__", ""), ("called", CALLED), ("caller", CALLER), ("constants", CONSTANTS)):
        (folder / f"{name}.py").write_text(text)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")
    return folder


@pytest.fixture
def outer(pair: Path) -> Callable[[], Any]:
    """The kernel as a new process would import it."""

    def imported() -> Any:
        for name in [name for name in sys.modules if name.partition(".")[0] == "pair"]:
            del sys.modules[name]
        importlib.invalidate_caches()
        kernel_cache.folder_name.cache_clear()
        kernel_cache._compiled_imports.cache_clear()
        return importlib.import_module("pair.caller").outer

    return imported


def from_disk(kernel: Any) -> bool:
    return sum(kernel.stats.cache_hits.values()) > 0


def folders(below: Path) -> list[str]:
    return sorted(path.name for path in below.rglob("caller-*"))


def test_a_kernel_is_loaded_from_disk_and_not_compiled_a_second_time(outer) -> None:
    first = outer()
    assert (first(2), from_disk(first)) == (20, False)
    second = outer()
    assert (second(2), from_disk(second)) == (20, True)


@pytest.mark.parametrize(
    ("module", "before", "after", "value"),
    [("called", "10 * x", "15 * x", 30), ("constants", "OFFSET = 0", "OFFSET = 7", 27)],
)
def test_a_change_in_another_module_reaches_a_kernel_that_was_compiled_with_it(
    outer, pair: Path, module: str, before: str, after: str, value: int
) -> None:
    assert outer()(2) == 20
    file = pair / f"{module}.py"
    file.write_text(file.read_text().replace(before, after))
    assert outer()(2) == value


def test_after_a_change_and_back_nothing_is_compiled_again(outer, pair: Path) -> None:
    assert outer()(2) == 20
    for text in (CALLED.replace("10", "15"), CALLED):
        (pair / "called.py").write_text(text)
        kernel = outer()
        kernel(2)
    assert from_disk(kernel)


def test_a_change_in_a_module_that_the_kernel_is_not_compiled_from_compiles_nothing(
    outer, pair: Path
) -> None:
    outer()(2)
    (pair / "words.py").write_text("GREETING = 'hello'\n")
    (pair / "__init__.py").write_text("from pair.words import GREETING\n")
    kernel = outer()
    kernel(2)
    assert from_disk(kernel)


def test_only_the_newest_three_versions_stay_on_disk(outer, pair: Path) -> None:
    made = []
    for minute in range(5):
        (pair / "constants.py").write_text(f"OFFSET = {minute}\n")
        outer()
        (newest,) = set(folders(pair)) - set(made)
        made.append(newest)
        os.utime(pair / "__pycache__" / newest, (minute * 60, minute * 60))
        (pair / "__pycache__" / "other-0123456789ab").mkdir(exist_ok=True)
    assert folders(pair) == sorted(made[-3:])
    assert (pair / "__pycache__" / "other-0123456789ab").exists()


def test_kernels_go_where_the_user_says(outer, pair: Path, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "cache"))
    outer()(2)
    assert len(folders(tmp_path / "cache")) == 1
    assert folders(pair) == []
    again = outer()
    again(2)
    assert from_disk(again)


def test_beside_modules_that_cannot_be_written_to_kernels_go_to_the_home(
    outer, pair: Path, tmp_path: Path, monkeypatch
) -> None:
    (pair / "__pycache__").write_text("no folder can be made here")  # also root is refused
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    outer()(2)
    assert len(folders(tmp_path / "home" / "numba")) == 1
    again = outer()
    again(2)
    assert from_disk(again)


def modules_with_kernels() -> list[ModuleType]:
    modules = []
    for package in (localizer, sim):
        for found in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            spec = importlib.util.find_spec(found.name)
            assert spec is not None
            assert spec.origin is not None
            if "@kernel(" in Path(spec.origin).read_text() and not found.name.endswith("kernel_cache"):
                modules.append(importlib.import_module(found.name))
    return modules


def test_every_value_that_a_kernel_names_comes_from_a_file_that_its_folder_depends_on() -> None:
    """Seen from the functions as Python holds them, not from the text of their imports."""
    modules = modules_with_kernels()
    assert len(modules) > 12
    for module in modules:
        sources = kernel_cache.compiled_sources(Path(str(module.__file__)))
        constants = set().union(*(constants_of(file) for file in sources))
        for kernel in [each for each in vars(module).values() if isinstance(each, Dispatcher)]:
            for name in kernel.py_func.__code__.co_names:
                value = kernel.py_func.__globals__.get(name)
                if isinstance(value, Dispatcher):
                    assert Path(value.py_func.__code__.co_filename) in sources, (module, name)
                elif isinstance(value, int | float | tuple | np.ndarray):
                    assert name in constants, (module, name)


def constants_of(file: Path) -> set[str]:
    """Names that a module assigns at its top level."""
    statements = ast.parse(file.read_text()).body
    return {
        node.id
        for statement in statements
        if isinstance(statement, ast.Assign | ast.AnnAssign)
        for node in ast.walk(statement)
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)
    }


def test_naming_all_folders_costs_milliseconds() -> None:
    files = [Path(str(module.__file__)) for module in modules_with_kernels()]
    kernel_cache.folder_name.cache_clear()
    kernel_cache._compiled_imports.cache_clear()
    start = time.process_time()
    for file in files:
        kernel_cache.folder_name(file)
    assert time.process_time() - start < 0.1
