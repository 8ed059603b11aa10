"""Resources of the daemon: seconds from its start to READY, processor and memory when idle. Printed, not checked.

``pytest tests/rig/daemon/test_figures.py -m long -s``; on a computer that does nothing else, for the simulated rig beside it
and whatever else runs are in the figures. ``--starts`` and ``--idle-s`` say how often and how long it is looked at.
"""

import os
import re
import statistics
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from fakes.daemon import LONG_PATIENCE_S, Daemon, add_keys, running_daemon

from sim.commands.options import EMBEDDED_DEM
from sim.launch.launcher import SimulatedRig, simulated_rig
from sim.world.scenario import Scenario
from sim.world.truth import World

TICKS_A_SECOND = os.sysconf("SC_CLK_TCK")
SETTLED_S = 5.0
"""After an answer there is a little left to do: clients are told, what was used is given back."""


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[SimulatedRig]:
    world = World.create([EMBEDDED_DEM], Scenario(), 3)
    with simulated_rig(world, bundle_dir=tmp_path / "bundles", dem_paths=[EMBEDDED_DEM]) as rig:
        add_keys(rig.config_path, "run.rest", still_s=1e6)  # it watches for rest, and there is none
        add_keys(rig.config_path, "run.search", time_s=LONG_PATIENCE_S)
        yield rig


def processes_of(daemon: Daemon) -> dict[str, int]:
    """The pids of the daemon and of its search process."""
    pid = daemon.process.pid
    children = [
        int(child)
        for task in Path(f"/proc/{pid}/task").iterdir()
        for child in (task / "children").read_text().split()
    ]
    search = [child for child in children if b"search_worker" in Path(f"/proc/{child}/cmdline").read_bytes()]
    assert len(search) == 1
    return {"daemon": pid, "search process": search[0]}


def processor_s(pid: int) -> float:
    """Seconds of processor that a process has used."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS_A_SECOND


def memory_mb(pid: int) -> dict[str, float]:
    """Resident megabytes: all, what is its own, and its share of what several processes have in memory."""
    sizes: dict[str, float] = {}
    for line in Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()[1:]:
        name, size_kb = line.split()[:2]
        sizes[name.rstrip(":")] = int(size_kb) / 1000.0
    return {"resident": sizes["Rss"], "its own": sizes["Anonymous"], "proportional": sizes["Pss"]}


def say_memory(daemon: Daemon, when: str) -> None:
    of_each = {name: memory_mb(pid) for name, pid in processes_of(daemon).items()}
    for name, sizes in of_each.items():
        print(f"{when}, {name}: " + ", ".join(f"{size:.0f} MB {kind}" for kind, size in sizes.items()))
    print(f"{when}, both: {sum(sizes['proportional'] for sizes in of_each.values()):.0f} MB proportional")


def report(what: str, values: list[float]) -> None:
    listed = ", ".join(f"{value:.2f}" for value in values)
    print(f"{what}: median {statistics.median(values):.2f} of {listed}")


@pytest.mark.long
@pytest.mark.timeout(0)
def test_what_it_takes(request: pytest.FixtureRequest, rig: SimulatedRig, tmp_path: Path) -> None:
    starts, idle_s = request.config.getoption("--starts"), request.config.getoption("--idle-s")
    print(f"\n{os.cpu_count()} processors, load {os.getloadavg()[0]:.1f} before")
    ready_s, used_s = [], []
    for number in range(starts):
        log = tmp_path / f"log-{number}"
        with running_daemon(rig.config_path, log, patience_s=LONG_PATIENCE_S) as daemon:
            daemon.until(lambda status, log=log: "ready seconds=" in log.read_text(), "ready")  # type: ignore[misc]
            used_s.append(processor_s(daemon.process.pid))
            ready_s.append(float(re.findall(r"ready seconds=([\d.]+)", log.read_text())[0]))
            daemon.until_ready()
            if number < starts - 1:
                assert daemon.stop() == 0
                continue
            report("seconds from start to READY", ready_s)
            report("seconds of processor in the daemon until then", used_s)
            say_memory(daemon, "before the first capture")
            assert daemon.send_request("trigger") == {"answer": "started"}
            daemon.until_idle(answers=1)
            time.sleep(SETTLED_S)
            say_memory(daemon, "after a capture")
            before_s = {name: processor_s(pid) for name, pid in processes_of(daemon).items()}
            time.sleep(idle_s)
            for name, pid in processes_of(daemon).items():
                share = (processor_s(pid) - before_s[name]) / idle_s
                print(f"idle, {name}: {100.0 * share:.2f} % of one processor, over {idle_s:g} s")
            assert daemon.status()["activity"] == "idle"
            assert daemon.stop() == 0
    print(f"load {os.getloadavg()[0]:.1f} after")
