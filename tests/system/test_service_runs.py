"""The service on a machine run by the real systemd, sandbox and all, with a simulated rig: from install to uninstall.

One machine for all tests, which build upon each other in their order.
"""

import json
import math
from collections.abc import Iterator

import pytest
from booted import Booted, booted

pytestmark = [pytest.mark.system, pytest.mark.timeout(1500)]

RIG = "/opt/skyfix/bin/rig"
CONFIG = "/etc/skyfix/vehicle.toml"
TARGET = """
[Unit]
DefaultDependencies=no
Wants=systemd-journald.service
"""
# The rig's devices, as the service's user: their pseudo-terminals belong to it like a vehicle's ports.
SIMULATION = """
[Unit]
DefaultDependencies=no
[Service]
Type=notify
NotifyAccess=all
TimeoutStartSec=10min
User=skyfix
StateDirectory=sim
WorkingDirectory=/var/lib/sim
CacheDirectory=skyfix
Environment=TMPDIR=/var/lib/sim NUMBA_CACHE_DIR=/var/cache/skyfix/numba
ExecStart=/opt/skyfix/bin/sim run --seed 3 -- sh -ec '\\
    cp $SKYFIX_CONFIG /var/lib/sim/rig.toml; cp $SKYFIX_TRUTH /var/lib/sim/truth.json; \\
    systemd-notify --ready; exec sleep infinity'
"""
# A loop hangs while there is a file.
HANGING = """
import pathlib, time
from rig.commands import cli
from rig.daemon import device_monitor, runtime
def probe(self, name, device, probe=device_monitor.DeviceMonitor._probe):
    while pathlib.Path("/run/skyfix/hang").exists():
        time.sleep(0.1)
    probe(self, name, device)
device_monitor.DeviceMonitor._probe = probe
runtime.SLOW_BEAT_S = 10.0
cli.main()
"""


@pytest.fixture(scope="module")
def machine(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Booted]:
    units = tmp_path_factory.mktemp("units")
    (units / "test.target").write_text(TARGET)
    (units / "sim.service").write_text(SIMULATION)
    with booted(units) as machine:
        yield machine


def test_it_is_installed_as_the_readme_says(machine: Booted) -> None:
    assert "would be written" in machine.says(RIG, "service", "install", "--dry-run")
    out = machine.says(RIG, "service", "install")
    assert "systemd-sysusers skyfix.conf: done" in out
    assert "systemctl daemon-reload: done" in out
    assert machine.says("id", "-Gn", "skyfix").split() == ["skyfix", "dialout", "video", "i2c"]
    # Without a configuration it is not started, and that is no failure.
    machine.run("systemctl", "start", "skyfix")
    assert machine.says("systemctl", "show", "skyfix", "-P", "ConditionResult") == "no"
    # The example is one: nothing in it has to be known beforehand.
    machine.run("cp", "/etc/skyfix/vehicle.example.toml", CONFIG)
    assert machine.run(RIG, "check", "--config", CONFIG, check=False).returncode == 1


def test_it_comes_up_and_finds_the_place(machine: Booted) -> None:
    machine.run("systemctl", "start", "sim")
    text = machine.says("cat", "/var/lib/sim/rig.toml").replace("/var/lib/sim/spool", "/var/lib/skyfix/spool")
    machine.write(CONFIG, text)
    machine.run("systemctl", "enable", "--now", "skyfix")
    assert machine.says("systemctl", "is-active", "skyfix") == "active"

    machine.until('"degraded": false', RIG, "status", "--config", CONFIG, "--json")
    assert machine.says(RIG, "trigger", "--config", CONFIG) == "started"
    machine.until('"answers fix": 1', RIG, "status", "--config", CONFIG, "--json")
    fix = json.loads(machine.says(RIG, "status", "--config", CONFIG, "--json"))["last_fix"]["fix"]["position"]
    truth = json.loads(machine.says("cat", "/var/lib/sim/truth.json"))
    off_m = math.hypot(fix["easting_m"] - truth["easting_m"], fix["northing_m"] - truth["northing_m"])
    assert off_m < 50.0

    said = machine.until("says: idle; fix ", RIG, "service", "status")
    assert f"idle; fix {fix['lat_deg']:.5f}, {fix['lon_deg']:.5f} of 20" in said
    assert "service: enabled, active (running), 0 restarts" in said


def test_it_writes_nowhere_but_in_its_own_directories(machine: Booted) -> None:
    elsewhere = (
        "/etc",
        "/home",
        "/opt/skyfix/bin",
        "/root",
        "/srv",
        "/tmp",
        "/usr/local",
        "/var/log",
        "/var/tmp",
    )
    assert machine.says("find", *elsewhere, "-user", "skyfix") == ""
    assert "/var/cache/skyfix/numba" in machine.says("find", "/var/cache/skyfix", "-name", "numba")
    bundles = machine.says("find", "/var/lib/skyfix/spool", "-name", "bundle.json").splitlines()
    assert len(bundles) == 1
    assert machine.says("stat", "-c", "%A %U", "/var/lib/skyfix") == "drwxr-x--- skyfix"


def test_lines_have_their_priority_and_nothing_went_wrong(machine: Booted) -> None:
    lines = machine.says(
        "journalctl", "--unit=skyfix", "--output=json", "--no-pager", "-t", "rig"
    ).splitlines()
    by_priority: dict[str, list[str]] = {}
    for line in lines:
        entry = json.loads(line)
        by_priority.setdefault(entry["PRIORITY"], []).append(entry["MESSAGE"])
    assert any(message.startswith("ready seconds=") for message in by_priority["6"])
    assert not by_priority.keys() & {"0", "1", "2", "3"}
    assert not any(message.startswith("<") for messages in by_priority.values() for message in messages)


def test_reload_takes_a_good_configuration_and_refuses_a_bad_one(machine: Booted) -> None:
    good = machine.says("cat", CONFIG)
    machine.write(CONFIG, good.replace("mast_height_m", "mast_hight_m"))
    machine.run("systemctl", "reload", "skyfix")
    machine.until("configuration refused", "journalctl", "--unit=skyfix", "--no-pager")
    machine.write(CONFIG, good)
    machine.run("systemctl", "reload", "skyfix")
    machine.until("configuration read anew", "journalctl", "--unit=skyfix", "--no-pager")
    machine.until("active (running), 0 restarts", RIG, "service", "status")


def test_it_restarts_after_a_crash_and_keeps_its_state(machine: Booted) -> None:
    machine.run("systemctl", "kill", "--kill-whom=main", "--signal=SIGKILL", "skyfix")
    machine.until("active (running), 1 restarts", RIG, "service", "status")
    status = json.loads(machine.until('"degraded": false', RIG, "status", "--config", CONFIG, "--json"))
    assert status["waiting"] == 0
    assert len(machine.says("find", "/var/lib/skyfix/spool", "-name", "bundle.json").splitlines()) == 1


def test_a_loop_that_hangs_is_named_and_ended_by_the_watchdog(machine: Booted) -> None:
    machine.write("/opt/hanging.py", HANGING)
    machine.write(
        "/etc/systemd/system/skyfix.service.d/test.conf",
        "[Service]\nWatchdogSec=3s\nRestartSec=1s\nExecStart=\n"
        "ExecStart=/opt/skyfix/bin/python /opt/hanging.py run\n",
    )
    machine.run("systemctl", "daemon-reload")
    machine.run("systemctl", "restart", "skyfix")
    machine.until('"activity": "idle"', RIG, "status", "--config", CONFIG, "--json")
    machine.run("touch", "/run/skyfix/hang")
    # SIGABRT is the watchdog's.
    journal = machine.until("Fatal Python error: Aborted", "journalctl", "--unit=skyfix", "--no-pager")
    assert "error: devices hangs: nothing for" in journal
    assert "in probe" in journal  # the stack of the thread that hung
    # /run/skyfix goes with the service, and with it what made it hang.
    machine.until("active (running)", RIG, "service", "status")
    assert int(machine.says("systemctl", "show", "skyfix", "-P", "NRestarts")) >= 1
    machine.run("rm", "-r", "/etc/systemd/system/skyfix.service.d")
    machine.run("systemctl", "daemon-reload")


def test_it_stops_in_time_and_leaves_what_is_the_crews(machine: Booted) -> None:
    out = machine.says(RIG, "service", "uninstall")
    assert out.count(": removed\n") == 5
    assert machine.journal().splitlines()[-1] == 'ended reason="on request"'
    assert machine.run("systemctl", "cat", "skyfix", check=False).returncode != 0
    assert machine.says("ls", CONFIG) == CONFIG
    assert machine.says("find", "/var/lib/skyfix/spool", "-name", "bundle.json")
