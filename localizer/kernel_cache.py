"""Where compiled kernels are kept on disk: in folders whose names say from which sources they were made.

numba uses what it compiled for a function until the file of that function changes. The machine code also contains the kernels
that the function calls and the constants that it names, and these may stand in other files. The folder's name therefore has a
hash of all these files. numba itself checks its own version and the processor.
"""

import contextlib
import functools
import hashlib
import re
import shutil
from pathlib import Path
from typing import Any

from numba.core.caching import CompileResultCacheImpl, FunctionCache

KEPT_FOLDERS = 3
"""Folders kept for each module, the newest: after a change to and fro nothing has to be compiled again."""

_KERNEL = re.compile(r"^@kernel\(", re.MULTILINE)
_IMPORT = re.compile(r"^(?:from ([\w.]+) import (\([^)]*\)|[^\n]*)|import ([\w.]+))", re.MULTILINE)


def keep_on_disk(compiled: Any) -> None:
    """Let a function that ``numba.njit`` returned load its machine code from disk, and save it when it was compiled."""
    if hasattr(compiled, "py_func"):  # with NUMBA_DISABLE_JIT it is the plain function
        compiled._cache = _Cache(compiled.py_func)  # type: ignore[no-untyped-call]


@functools.cache
def folder_name(module: Path) -> str:
    """Name of the folder for the kernels of a module: its own name and a hash of all ``compiled_sources``."""
    digest = hashlib.sha256()
    for file in compiled_sources(module):
        digest.update(hashlib.sha256(file.read_bytes()).digest())
    return f"{module.stem}-{digest.hexdigest()[:12]}"


def compiled_sources(module: Path) -> list[Path]:
    """The file of a module that has kernels, and those of its package that its kernels are compiled from, sorted.

    Followed are imports at the top level: of modules that have kernels, of whole modules, and of names in capitals, which are
    constants.
    """
    found: set[Path] = set()
    ahead = [module]
    while ahead:
        file = ahead.pop()
        if file not in found:
            found.add(file)
            ahead += _compiled_imports(file)
    return sorted(found)


@functools.cache
def _compiled_imports(file: Path) -> list[Path]:
    above = file.parent
    while (above / "__init__.py").exists():
        above = above.parent
    package = file.relative_to(above).parts[0] if above != file.parent else None
    followed: list[Path] = []
    for origin, names, whole in _IMPORT.findall(file.read_text(encoding="utf-8")):
        if package not in (None, (origin or whole).partition(".")[0]):
            continue
        imported = re.findall(r"\w+", re.sub("#.*", "", names))
        followed += _files(above, [whole, *(f"{origin}.{name}" for name in imported)])
        constants = any(name.isupper() for name in imported)
        followed += [
            each
            for each in _files(above, [origin])
            if constants or "kernel" in imported or _KERNEL.search(each.read_text(encoding="utf-8"))
        ]
    return followed


def _files(above: Path, modules: list[str]) -> list[Path]:
    """The files of those names that are modules below a folder."""
    paths = [above.joinpath(*name.split(".")) for name in modules if name]
    return [
        file
        for path in paths
        for file in (path.parent / f"{path.name}.py", path / "__init__.py")
        if file.is_file()
    ]


class _OwnFolder:
    """Mixed into a locator of numba: a folder of this module and its sources within the one that numba would take."""

    _py_file: str

    def get_cache_path(self) -> str:
        return str(Path(super().get_cache_path()) / folder_name(Path(self._py_file)))  # type: ignore[misc]

    def ensure_cache_path(self) -> None:
        folder = Path(self.get_cache_path())
        is_new = not folder.exists()
        super().ensure_cache_path()  # type: ignore[misc]
        if is_new:
            _remove_old(folder)


def _remove_old(folder: Path) -> None:
    """Remove the oldest folders of the same module. A process that still uses one compiles anew and makes it again."""
    module = folder.name.rpartition("-")[0]
    with contextlib.suppress(OSError):  # another process may remove them too
        others = [other for other in folder.parent.glob(f"{module}-{'?' * 12}") if other != folder]
        others.sort(key=lambda other: other.stat().st_mtime, reverse=True)
        for other in others[KEPT_FOLDERS - 1 :]:
            shutil.rmtree(other, ignore_errors=True)


class _Implementation(CompileResultCacheImpl):
    _locator_classes: Any = tuple(
        type(locator.__name__, (_OwnFolder, locator), {})
        for locator in CompileResultCacheImpl._locator_classes
    )


class _Cache(FunctionCache):
    _impl_class = _Implementation
