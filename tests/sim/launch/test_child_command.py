"""Running a command with the simulated rig: exit status and signals are handed on."""

import signal
import subprocess
import sys

import pytest

from sim.errors import SimulationError
from sim.launch.child_command import run_command

WAITS = "import signal, sys; print('up', flush=True); signal.pause()"
OUTER = (
    "from sim.launch.child_command import run_command; import sys; "
    f"sys.exit(run_command([sys.executable, '-c', {WAITS!r}], {{}}))"
)


@pytest.mark.parametrize(
    ("code", "status"), [("raise SystemExit(7)", 7), ("import os; os.kill(os.getpid(), 9)", 137)]
)
def test_the_exit_status_is_the_commands(code: str, status: int) -> None:
    assert run_command([sys.executable, "-c", code], {}) == status


def test_the_environment_is_added() -> None:
    check = "import os, shutil; raise SystemExit(os.environ['SKYFIX_CONFIG'] != 'x' or shutil.which('rig') is None)"
    assert run_command([sys.executable, "-c", check], {"SKYFIX_CONFIG": "x"}) == 0


def test_an_unknown_command_is_one_line() -> None:
    with pytest.raises(SimulationError, match="'no-such-command' not found"):
        run_command(["no-such-command"], {})


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_reach_the_command(number: signal.Signals) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", OUTER], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as outer:
        assert outer.stdout is not None
        assert outer.stdout.readline() == b"up\n"
        outer.send_signal(number)
        assert outer.wait(timeout=10) == 128 + number
