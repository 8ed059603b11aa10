"""A disk that keeps only what was brought to it: every state that a power cut can leave behind.

The rules are those of POSIX and no better. ``fsync`` of a file keeps its content, ``fsync`` of a folder keeps the names in
it. What was not synced may be kept or lost: the content of a file wholly or from its middle on, the changes of a folder's
names from any one of them on. Changes of different folders are kept or lost independently. A rename is kept whole or not
at all.
"""

import builtins
import io
import os
import shutil
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

CALLS = ("fsync", "fdatasync", "rename", "replace", "unlink", "remove", "rmdir", "mkdir", "truncate", "open")
MAX_STATES = 2000
Tree = dict[str, bytes | None]
"""Content by path; None for a folder."""


@dataclass(eq=False)
class _Node:
    """A file or a folder: as programs see it, and as it is on the disk."""

    is_folder: bool
    content: bytes = b""
    kept_content: bytes = b""
    names: dict[str, "_Node"] = field(default_factory=dict)
    kept_names: dict[str, "_Node"] = field(default_factory=dict)


@dataclass(frozen=True)
class _Change:
    """One change of names that is not yet on the disk: a creation, a removal, or a rename with both of its sides."""

    sides: tuple[tuple[_Node, str, _Node | None], ...]

    @property
    def folders(self) -> set[_Node]:
        return {folder for folder, _, _ in self.sides}


@dataclass(frozen=True)
class PowerCut:
    """One moment at which the power can fail.

    ``call`` names the system call before or after it, ``reported`` what had been reported as done, ``states`` every
    content that the disk can have.
    """

    call: str
    reported: tuple[str, ...]
    states: tuple[Tree, ...]


class Disk:
    """Records what happens below ``root`` while ``recorded`` lasts. What is there before is on the disk."""

    def __init__(self, root: Path, always_kept: Callable[[str], bool] = lambda name: False) -> None:
        """``always_kept``: names of files whose program syncs them where Python cannot see it, such as SQLite."""
        self.root = root
        self.cuts: list[PowerCut] = []
        self._always_kept = always_kept
        self._is_looking = False
        self._lock = threading.RLock()
        self._reported: list[str] = []
        self._pending: list[_Change] = []
        self._by_inode: dict[int, _Node] = {}
        self._root = self._node_at(root)
        self._look()
        self._keep_all()

    def report(self, what: str) -> None:
        """What the program has just reported as done: it must survive from here on."""
        with self._lock:
            self._look()
            self._reported.append(what)
            self._cut(f"after {what}")

    @contextmanager
    def recorded(self) -> Iterator[None]:
        """Record system calls while the context lasts."""
        with pytest.MonkeyPatch.context() as patched:
            for name in CALLS:
                patched.setattr(os, name, self._watched(name, getattr(os, name)))
            opened = self._watched("open", builtins.open)
            patched.setattr(io, "open", opened)
            patched.setattr(builtins, "open", opened)
            yield
        self._look()
        self._cut("at the end")

    def _watched(self, name: str, call: Callable[..., Any]) -> Callable[..., Any]:
        def watched(*arguments: Any, **more: Any) -> Any:
            with self._lock:
                if self._is_looking:
                    return call(*arguments, **more)
                self._look()
                shown = f"{name}({', '.join(map(str, arguments))})"
                self._cut(f"before {shown}")
                result = call(*arguments, **more)
                self._look()
                if name in ("fsync", "fdatasync"):
                    self._sync(os.fstat(arguments[0]).st_ino)
                self._cut(f"after {shown}")
                return result

        return watched

    def _look(self) -> None:
        """Notice what has changed since the last look."""
        self._is_looking = True
        try:
            removed: list[tuple[_Node, str, _Node]] = []
            added: list[tuple[_Node, str, _Node]] = []
            seen = {self.root.stat().st_ino}
            self._look_into(self.root, self._root, removed, added, seen)
        finally:
            self._is_looking = False
        taken = {(folder, name) for folder, name, _ in added}
        for folder, name, node in removed:
            to = next((each for each in added if each[2] is node), None)
            if to is None and (folder, name) in taken:
                continue  # the change that gives its name to another file says so
            sides: list[tuple[_Node, str, _Node | None]] = [(folder, name, None)]
            if to is not None:
                added.remove(to)
                sides.append(to)
            self._pending.append(_Change(tuple(sides)))
        self._pending.extend(_Change((each,)) for each in added)
        for change in [
            each for each in self._pending if all(self._always_kept(side[1]) for side in each.sides)
        ]:
            self._keep(change)
        self._by_inode = {inode: node for inode, node in self._by_inode.items() if inode in seen}

    def _look_into(
        self,
        path: Path,
        folder: _Node,
        removed: list[tuple[_Node, str, _Node]],
        added: list[tuple[_Node, str, _Node]],
        seen: set[int],
    ) -> None:
        names: dict[str, _Node] = {}
        with os.scandir(path) as entries:
            for entry in sorted(entries, key=lambda each: each.name):
                here = Path(entry.path)
                node = names[entry.name] = self._node_at(here)
                seen.add(here.lstat().st_ino)
                if node.is_folder:
                    self._look_into(here, node, removed, added, seen)
                elif not here.is_symlink():
                    node.content = here.read_bytes()
                    if self._always_kept(entry.name):
                        node.kept_content = node.content
        before, folder.names = folder.names, names
        for name in sorted({*before, *names}):
            old, new = before.get(name), names.get(name)
            if old is new:
                continue
            if old is not None:
                removed.append((folder, name, old))
            if new is not None:
                added.append((folder, name, new))

    def _node_at(self, path: Path) -> _Node:
        found = path.lstat()
        return self._by_inode.setdefault(found.st_ino, _Node(path.is_dir() and not path.is_symlink()))

    def _sync(self, inode: int) -> None:
        node = self._by_inode.get(inode)
        if node is None:  # outside of the root
            return
        node.kept_content = node.content
        wanted: set[_Node] = {node}
        kept = []
        for change in reversed(self._pending):  # with a rename all that came before it on its other side
            if change.folders & wanted:
                wanted |= change.folders
                kept.append(change)
        for change in reversed(kept):
            self._keep(change)

    def _keep(self, change: _Change) -> None:
        self._pending.remove(change)
        for folder, name, there in change.sides:
            _set(folder.kept_names, name, there)

    def _all_nodes(self) -> set[_Node]:
        found: set[_Node] = set()
        left = [self._root, *(node for change in self._pending for _, _, node in change.sides if node)]
        while left:
            node = left.pop()
            if node not in found:
                found.add(node)
                left += [*node.names.values(), *node.kept_names.values()]
        return found

    def _keep_all(self) -> None:
        self._pending.clear()
        for node in self._all_nodes():
            node.kept_content, node.kept_names = node.content, dict(node.names)

    def _cut(self, call: str) -> None:
        states = {}
        reachable = self._all_nodes()
        self._pending = [change for change in self._pending if change.folders & reachable]
        for kept in _possible(self._pending):
            for share in (0.0, 0.5, 1.0):
                tree = self._tree(kept, share)
                states[tuple(tree.items())] = tree
        self.cuts.append(PowerCut(call, tuple(self._reported), tuple(states.values())))

    def _tree(self, kept: list[_Change], share: float) -> Tree:
        """What is on the disk if these changes of names are, and this share of each content that was not synced."""
        names: dict[_Node, dict[str, _Node]] = {}
        for change in kept:
            for folder, name, node in change.sides:
                _set(names.setdefault(folder, dict(folder.kept_names)), name, node)
        tree: Tree = {}

        def walk(folder: _Node, prefix: str) -> None:
            for name, node in sorted(names.get(folder, folder.kept_names).items()):
                tree[prefix + name] = None if node.is_folder else _content(node, share)
                if node.is_folder:
                    walk(node, f"{prefix}{name}/")

        walk(self._root, "")
        return tree


def _set(names: dict[str, _Node], name: str, node: _Node | None) -> None:
    if node is None:
        names.pop(name, None)
    else:
        names[name] = node


def _content(node: _Node, share: float) -> bytes:
    kept, now = node.kept_content, node.content
    common = len(kept) if now.startswith(kept) else 0
    if share == 0.0 or kept == now:
        return kept
    return now[: common + int(share * (len(now) - common))]


def _possible(changes: list[_Change]) -> list[list[_Change]]:
    """Which changes can be on the disk: in each folder all up to some one."""
    found: list[tuple[list[_Change], frozenset[_Node]]] = [([], frozenset())]
    for change in changes:
        more = [([*kept, change], stopped) for kept, stopped in found if not change.folders & stopped]
        found = [(kept, stopped | change.folders) for kept, stopped in found] + more
        assert len(found) <= MAX_STATES, "too many changes at once to look at every order"
    return [kept for kept, _ in found]


def look_at_all(disk: Disk, folder: Path, check: Callable[[Path, PowerCut], None]) -> int:
    """Put every state into ``folder`` and check it; returns how many differ. A failure names the moment."""
    looked_at = set()
    for cut in disk.cuts:
        for state in cut.states:
            key = (tuple(state.items()), cut.reported)
            if key in looked_at:
                continue
            looked_at.add(key)
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir()
            for path, content in state.items():
                if content is None:
                    (folder / path).mkdir()
                else:
                    (folder / path).write_bytes(content)
            try:
                check(folder, cut)
            except Exception as error:
                held = {path: None if content is None else len(content) for path, content in state.items()}
                raise AssertionError(
                    f"power cut {cut.call}, reported {cut.reported}: {error!r}; on the disk: {held}"
                ) from error
    return len(looked_at)
