"""``rig run`` as a process, and its output."""

import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rig.config.load import load_config
from rig.daemon.control import ControlError, send_request
from sim.launch.child_command import find_command, search_path

PATIENCE_S, LONG_PATIENCE_S = 120.0, 900.0
"""For anything that a daemon does; only a defect takes so long, or a machine that is very busy. The second for long tests."""


@dataclass
class Daemon:
    """A daemon that runs."""

    process: "subprocess.Popen[str]"
    config_path: Path
    control: Path
    spool: Path
    log: Path
    patience_s: float = PATIENCE_S

    def send_request(self, wish: str) -> dict[str, Any]:
        """What it answers over its socket."""
        return send_request(self.control, wish, PATIENCE_S)

    def status(self) -> dict[str, Any]:
        return self.send_request("status")

    def until(self, true: Callable[[dict[str, Any]], object], what: str) -> dict[str, Any]:
        """Its status, once that is as expected."""
        deadline_s = time.monotonic() + self.patience_s
        while time.monotonic() < deadline_s:
            assert self.process.poll() is None, f"ended before {what}: {self.log.read_text()}"
            try:
                status = self.status()
            except ControlError:  # not up yet
                time.sleep(0.1)
                continue
            if true(status):
                return status
            time.sleep(0.1)
        raise AssertionError(f"never {what}: {self.status()}; {self.log.read_text()}")

    def until_ready(self) -> dict[str, Any]:
        """Its status, once all that a capture needs works."""
        return self.until(
            lambda status: (
                status["activity"] == "idle"
                and all(d["state"] in ("ok", "absent") for d in status["devices"])
            ),
            "ready",
        )

    def until_counted(self, what: str, number: int) -> None:
        """Wait until something has happened so often."""
        self.until(lambda status: status["counts"].get(what, 0) >= number, f"counted {number} {what}")

    def until_idle(self, answers: int) -> dict[str, Any]:
        """Its status, once so many bundles have been answered and nothing goes on."""

        def done(status: dict[str, Any]) -> bool:
            given = sum(n for name, n in status["counts"].items() if name.startswith("answers "))
            return bool(given >= answers and status["activity"] == "idle" and status["waiting"] == 0)

        return self.until(done, f"idle with {answers} answers")

    def stop(self, number: int = signal.SIGTERM) -> int:
        """End it; returns its exit status."""
        self.process.send_signal(number)
        return self.process.wait(PATIENCE_S)


@contextmanager
def running_daemon(
    config_path: Path,
    log: Path,
    environment: Mapping[str, str] | None = None,
    patience_s: float = PATIENCE_S,
) -> Iterator[Daemon]:
    """``rig run``, killed at the end of the context if it still runs. ``patience_s``: of all waiting for it."""
    run = load_config(config_path).run
    assert run
    assert run.control
    with log.open("a") as err:
        process = subprocess.Popen(
            [find_command("rig"), "run", "--config", str(config_path)],
            env={**os.environ, "PATH": search_path(), **(environment or {})},
            stderr=err,
            text=True,
        )
    try:
        yield Daemon(process, config_path, run.control, run.spool.dir, log, patience_s)
    finally:
        if process.poll() is None:
            process.kill()
        process.wait()


def add_keys(config_path: Path, section: str, **keys: object) -> None:
    """Put keys into a section of a configuration."""
    text = config_path.read_text()
    lines = "".join(f"{key} = {value}\n" for key, value in keys.items())
    if f"[{section}]\n" in text:
        text = text.replace(f"[{section}]\n", f"[{section}]\n{lines}", 1)
    else:
        text += f"\n[{section}]\n{lines}"
    config_path.write_text(text)
