"""The daemon for a long time on a rig in which something breaks all the time: nothing grows, every trigger is accounted for.

``pytest tests/rig/daemon/test_soak.py -m long --soak-minutes 120 -s`` is the whole of it; a quarter of an hour by default.
"""

import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fakes.daemon import LONG_PATIENCE_S, Daemon, add_keys, running_daemon
from fakes.simulated import quick_rig, world

from sim.commands.options import EMBEDDED_DEM
from sim.faults.catalogue import CATALOGUE, DEVICES
from sim.faults.script import Fault, parse_faults

FAULT_EVERY_S = 12.0
FIRST_CAPTURES = 10
MAX_GROWTH = 0.05
SPARED = ("disk", "clock")
"""The clock's and the disk's faults act on the command that the simulator starts, which this daemon is not."""
FOR_GOOD = ("overheating", "voltage-low", "blocked")
"""These switch a servo off until somebody restarts it."""


def many_faults(rng: np.random.Generator, seconds: float) -> tuple[Fault, ...]:
    """One after the other, all of which pass by themselves."""
    entries: list[dict[str, Any]] = []
    at_s = FAULT_EVERY_S
    while at_s < seconds - FAULT_EVERY_S:
        device = str(rng.choice([name for name in DEVICES if name not in SPARED]))
        group = DEVICES[device][0]
        lasting = [name for name, kind in CATALOGUE[group].items() if kind.lasts and name not in FOR_GOOD]
        name = str(rng.choice(lasting))
        entry = {
            "at": round(at_s, 2),
            "device": device,
            "fault": name,
            "for": round(float(rng.uniform(0.1, 8.0)), 2),
        }
        if "share" in CATALOGUE[group][name].parameters:
            entry["share"] = round(float(rng.uniform(0.1, 1.0)), 2)
        entries.append(entry)
        at_s += float(rng.uniform(0.8, 1.2)) * FAULT_EVERY_S
    return parse_faults(entries)


def resources(pid: int) -> tuple[float, int, int]:
    """Resident megabytes, file descriptors and threads of a process."""
    process = Path(f"/proc/{pid}")
    fields = dict(line.split(":", 1) for line in (process / "status").read_text().splitlines())
    return (
        int(fields["VmRSS"].split()[0]) / 1000.0,
        len(list((process / "fd").iterdir())),
        int(fields["Threads"]),
    )


def captures_by_end(status: dict[str, Any]) -> dict[str, int]:
    """How many captures came to what."""
    ends = "done", "failed", "refused", "interrupted"
    return {end: status["counts"].get(f"captures {end}", 0) for end in ends}


@pytest.fixture
def daemon(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Daemon]:
    minutes = request.config.getoption("--soak-minutes")
    faults = many_faults(np.random.default_rng(request.config.getoption("--soak-seed")), 60.0 * minutes)
    with quick_rig(world(), tmp_path, faults, [EMBEDDED_DEM]) as quick:
        ahead_deg = round(quick.world.mechanics.base.heading_deg)
        add_keys(quick.rig.config_path, "capture", directions=[ahead_deg, (ahead_deg + 25) % 360])
        add_keys(quick.rig.config_path, "run", every_s=2.0, retry_most_s=4.0, check_every_s=5.0)
        add_keys(quick.rig.config_path, "run.spool", quota_mb=20)
        add_keys(quick.rig.config_path, "run.search", time_s=LONG_PATIENCE_S)
        with running_daemon(quick.rig.config_path, tmp_path / "log", patience_s=LONG_PATIENCE_S) as daemon:
            yield daemon
        assert quick.torques == [0, 0]


@pytest.mark.long
@pytest.mark.timeout(0)
def test_soak(request: pytest.FixtureRequest, daemon: Daemon) -> None:
    began_s = time.monotonic()
    end_s = began_s + 60.0 * request.config.getoption("--soak-minutes")
    measured: list[tuple[float, int, int]] = []
    captures = 0
    daemon.until(lambda status: status["activity"] != "starting", "up")
    while time.monotonic() < end_s:
        time.sleep(0.5)
        status = daemon.status()
        before, captures = captures, status["counts"].get("captures done", 0)
        if captures > before:
            measured.append(resources(daemon.process.pid))
            if captures % 5 == 0 or captures <= FIRST_CAPTURES:
                minutes = (time.monotonic() - began_s) / 60.0
                megabytes, descriptors, threads = measured[-1]
                print(
                    f"{minutes:.1f} min, {captures} captures: {megabytes:.0f} MB, {descriptors} descriptors, "
                    f"{threads} threads, {status['counts']}",
                    flush=True,
                )
    text = daemon.config_path.read_text()
    daemon.config_path.write_text(text.replace("every_s = 2.0", "every_s = 36000.0"))
    daemon.process.send_signal(signal.SIGHUP)
    daemon.until(lambda status: "configuration read anew" in daemon.log.read_text(), "read anew")
    # On a busy computer the searches are far behind the captures.
    while waiting := daemon.status()["waiting"]:
        daemon.until(lambda status, before=waiting: status["waiting"] < before, "another one located")  # type: ignore[misc]
    status = daemon.until(
        lambda status: (
            status["activity"] == "idle"
            and status["counts"]["triggers started"] == sum(captures_by_end(status).values())
            and not status["waiting"]
        ),
        "idle with every bundle located",
    )
    counts = status["counts"]
    print(
        f"{captures} captures, {measured[FIRST_CAPTURES : FIRST_CAPTURES + 1]} to {measured[-1:]}, {counts}"
    )
    assert counts["triggers"] == sum(
        number for name, number in counts.items() if name.startswith("triggers ")
    )
    answered = sum(number for name, number in counts.items() if name.startswith("answers "))
    assert answered == counts["captures done"]
    after = measured[FIRST_CAPTURES:]
    assert len(after) > FIRST_CAPTURES, "too few captures to tell: raise --soak-minutes"
    early_mb = float(np.median([mb for mb, _, _ in after[:FIRST_CAPTURES]]))
    late_mb = float(np.median([mb for mb, _, _ in after[-FIRST_CAPTURES:]]))
    assert late_mb < (1.0 + MAX_GROWTH) * early_mb
    for which in (1, 2):
        early = max(sample[which] for sample in after[:FIRST_CAPTURES])
        assert min(sample[which] for sample in after[-FIRST_CAPTURES:]) <= early, (
            "descriptors or threads are lost"
        )
    assert daemon.stop() == 0
