"""Runs a command as a shell does: in the foreground, with signals forwarded and its exit status returned."""

import contextlib
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import FrameType
from typing import IO

from sim.errors import SimulationError

FORWARDED = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def search_path() -> str:
    """PATH with the scripts of this Python first, so that ``rig`` is the one of the same installation."""
    return os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", os.defpath)])


def find_command(name: str) -> str:
    """The executable of that name.

    Raises:
        SimulationError: there is none.
    """
    found = shutil.which(name, path=search_path())
    if found is None:
        raise SimulationError(f"command {name!r} not found; give one that is on the PATH, after --")
    return found


def run_command(
    command: Sequence[str],
    environment: Mapping[str, str],
    started: Callable[[int], None] = lambda pid: None,
    stdout: IO[str] | None = None,
) -> int:
    """Run ``command`` with ``environment`` added to the present one, and wait for it.

    It gets its own process group, in the foreground of the terminal if there is one: Ctrl-C reaches it once, and
    signals to this process are forwarded. Returns its exit status, 128 + n if signal n ended it. ``started`` gets its
    process id; ``stdout`` replaces its standard output.

    Raises:
        SimulationError: the command cannot be started.
    """
    executable = find_command(command[0])
    environment = {**os.environ, **environment, "PATH": search_path()}
    with _kept_signals() as kept:
        try:
            process = subprocess.Popen(
                [executable, *command[1:]], env=environment, process_group=0, stdout=stdout
            )
        except OSError as error:
            raise SimulationError(f"command {command[0]!r} cannot be started: {error.strerror}") from error
        kept.hand_to(process.pid)
        started(process.pid)
        with _foreground(process.pid):
            status = process.wait()
    return status if status >= 0 else 128 - status


class _Signals:
    """Signals for a process group: stored until it exists."""

    def __init__(self) -> None:
        self._waiting: list[int] = []
        self._group: int | None = None

    def arrive(self, number: int, _frame: FrameType | None) -> None:
        if self._group is None:
            self._waiting.append(number)
            return
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._group, number)

    def hand_to(self, group: int) -> None:
        self._group = group
        for number in self._waiting:
            self.arrive(number, None)


@contextlib.contextmanager
def _kept_signals() -> Iterator[_Signals]:
    """Intercept the signals that end a program while the context lasts."""
    signals = _Signals()
    previous = {number: signal.signal(number, signals.arrive) for number in FORWARDED}
    try:
        yield signals
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def _foreground(group: int) -> Iterator[None]:
    """Give the terminal to a process group while the context lasts, if this process owns it."""
    terminal = sys.__stdin__.fileno() if sys.__stdin__ and not sys.__stdin__.closed else -1
    if terminal < 0 or not os.isatty(terminal) or os.tcgetpgrp(terminal) != os.getpgrp():
        yield
        return
    # A process in the background that touches the terminal is stopped unless it ignores SIGTTOU.
    previous = signal.signal(signal.SIGTTOU, signal.SIG_IGN)
    try:
        with contextlib.suppress(OSError):
            os.tcsetpgrp(terminal, group)
            os.killpg(group, signal.SIGCONT)  # in case it read early and was stopped
        yield
    finally:
        os.tcsetpgrp(terminal, os.getpgrp())
        signal.signal(signal.SIGTTOU, previous)
