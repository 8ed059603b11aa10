"""Scripted operator of the simulated rig: runs a command of ``rig`` and does what it asks for."""

import os
import re
import subprocess
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

from sim.launch.child_command import find_command, search_path

ASKS = "Then press Enter."
QUESTION = "[Y/n]"
ENDS_WITHIN_S = 15.0
"""Time for switching the torque off; nothing else takes long."""
TURN = re.compile(r"turn the vehicle by about (\d+) deg to the right")


@dataclass(frozen=True)
class Done:
    """Result of a command: exit status, output, and the last line on standard error."""

    status: int
    out: str
    last_line: str


def turn_asked_deg(line: str) -> float | None:
    """The angle by which a line asks to turn the vehicle; None if it does not."""
    found = TURN.search(line)
    return float(found.group(1)) if found else None


def operate(
    command: Sequence[str],
    environment: Mapping[str, str],
    act: Callable[[str], None],
    hear: Callable[[str], None],
) -> Done:
    """Run a command; ``act`` does what a line asks for before Enter is sent; questions are answered with yes.

    An early end of this call also ends the command.
    """
    with tempfile.TemporaryFile("w+", encoding="utf-8") as out:
        process = subprocess.Popen(
            [find_command(command[0]), *command[1:]],
            env={**os.environ, **environment, "PATH": search_path()},
            stdin=subprocess.PIPE,
            stdout=out,
            stderr=subprocess.PIPE,
            text=True,
            bufsize=1,
        )
        assert process.stdin is not None
        assert process.stderr is not None
        last_line = ""
        with process, _terminating_on_error(process):
            for line in process.stderr:
                last_line = line.rstrip("\n") or last_line
                hear(line.rstrip("\n"))
                if last_line.endswith(ASKS):
                    act(last_line)
                if last_line.endswith((ASKS, QUESTION)):
                    process.stdin.write("\n")
                    process.stdin.flush()
        out.seek(0)
        return Done(process.returncode, out.read(), last_line)


@contextmanager
def _terminating_on_error(process: "subprocess.Popen[str]") -> Iterator[None]:
    """End a process if the context ends with an exception."""
    try:
        yield
    except BaseException:
        process.terminate()
        try:
            process.wait(ENDS_WITHIN_S)
        except subprocess.TimeoutExpired:
            process.kill()
        raise
