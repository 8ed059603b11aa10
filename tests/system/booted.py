"""A machine with the real systemd for the tests, see ``machine``; skyfix is in its /opt/skyfix."""

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

PROJECT = Path(__file__).parents[2]
NAMESPACES = [
    "--fork",
    "--pid",
    "--mount",
    "--cgroup",
    "--uts",
    "--ipc",
    "--net",
    "--mount-proc",
    "--kill-child",
]
BOOT_S, COMMAND_S, PATIENCE_S = 60.0, 600.0, 600.0


class Booted:
    """A machine that runs."""

    def __init__(self, systemd: int) -> None:
        self._systemd = systemd

    def run(self, *command: str, check: bool = True) -> "subprocess.CompletedProcess[str]":
        """Run a command in it, as root; a status other than 0 fails the test unless ``check`` is False."""
        enter = ["nsenter", f"--target={self._systemd}", "--all", "--wd=/"]
        done = subprocess.run(
            [*enter, *command], capture_output=True, text=True, timeout=COMMAND_S, check=False
        )
        if check and done.returncode:
            raise AssertionError(f"{command}: {done.stdout}{done.stderr}\n{self.journal()}")
        return done

    def says(self, *command: str) -> str:
        """Standard output of a command."""
        return self.run(*command).stdout.strip()

    def write(self, path: str, text: str) -> None:
        """Write a file in it."""
        self.run("sh", "-ec", 'mkdir -p "$(dirname "$0")"; printf %s "$1" >"$0"', path, text)

    def journal(self) -> str:
        """What the service has written."""
        return self.run("journalctl", "--unit=skyfix", "--output=cat", "--no-pager", check=False).stdout

    def until(self, expected: str, *command: str, within_s: float = PATIENCE_S) -> str:
        """Repeat a command until its output contains something."""
        deadline_s = time.monotonic() + within_s
        while time.monotonic() < deadline_s:
            done = self.run(*command, check=False)
            if expected in done.stdout:
                return done.stdout
            time.sleep(0.5)
        raise AssertionError(f"{command}: no {expected!r}: {done.stdout}{done.stderr}\n{self.journal()}")


@contextmanager
def booted(units: Path) -> Iterator[Booted]:
    """Boot it with more units; skips the test where this user or machine has no namespaces to do so."""
    tried = subprocess.run(
        ["unshare", *NAMESPACES, "mount", "-t", "tmpfs", "none", "/mnt"], capture_output=True, check=False
    )
    if tried.returncode:
        pytest.skip(f"no namespaces to boot systemd in: {tried.stderr.decode().strip()}")
    command = ["unshare", *NAMESPACES, Path(__file__).with_name("machine"), sys.executable, PROJECT, units]
    with (units / "boot.log").open("w") as log:
        process = subprocess.Popen(command, stdout=log, stderr=log, stdin=subprocess.DEVNULL)
    try:
        yield _up(process, units / "boot.log")
    finally:
        process.kill()  # its child goes with it, and all that runs in there
        process.wait()


def _up(process: "subprocess.Popen[bytes]", log: Path) -> Booted:
    deadline_s = time.monotonic() + BOOT_S
    while time.monotonic() < deadline_s and process.poll() is None:
        children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
        if children and Path(f"/proc/{children[0]}/comm").read_text().strip() == "systemd":
            machine = Booted(int(children[0]))
            if machine.run("systemctl", "is-active", "test.target", check=False).stdout.strip() == "active":
                return machine
        time.sleep(0.2)
    raise AssertionError(f"systemd did not come up: {log.read_text()}")
