"""``rig run`` as the vehicle's computer has it: a process, devices at wire level, signals."""

import json
import signal
import socket
import sqlite3
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from fakes.daemon import Daemon, add_keys, running_daemon
from fakes.simulated import Quick, quick_rig, world

from localizer.bundle import load_bundle
from rig.config.load import load_config
from rig.daemon.control import ControlError, send_request
from rig.daemon.spool.store import ODOMETER
from sim.commands.options import EMBEDDED_DEM

ENDS_WITHIN_S = 10.0
ON_A_BUSY_COMPUTER = {
    "bus_watchdog_ms = 400": "bus_watchdog_ms = 2400",
    "settle_timeout_s = 4.0": "settle_timeout_s = 60.0",
    "read_timeout_s = 0.6": "read_timeout_s = 30.0",
}
"""Nothing fails here; a simulated device that gets no time for a second is none of this file's matters."""


@pytest.fixture
def quick(tmp_path: Path) -> Iterator[Quick]:
    with quick_rig(world(), tmp_path, dem_paths=[EMBEDDED_DEM]) as quick:
        ahead_deg = round(quick.world.mechanics.base.heading_deg)
        add_keys(quick.rig.config_path, "capture", directions=[ahead_deg, (ahead_deg + 25) % 360])
        add_keys(quick.rig.config_path, "run", retry_most_s=1.0, check_every_s=1.0)
        text = quick.rig.config_path.read_text()
        for hasty, patient in ON_A_BUSY_COMPUTER.items():
            assert hasty in text
            text = text.replace(hasty, patient)
        quick.rig.config_path.write_text(text)
        yield quick


@pytest.fixture
def daemon(quick: Quick, tmp_path: Path) -> Iterator[Daemon]:
    with running_daemon(quick.rig.config_path, tmp_path / "log") as daemon:
        yield daemon


def test_bad_configurations_are_refused_a_trigger_is_answered_and_a_stop_in_the_next_is_safe(
    quick: Quick, daemon: Daemon
) -> None:
    daemon.until_ready()
    good = daemon.config_path.read_text()
    bad = (
        good.replace("[pan_tilt]", "[pan_tlit]"),
        good.replace(str(EMBEDDED_DEM), "nowhere.tif"),
        "a = " + "[" * 20_000,
    )
    with socket.socket(socket.AF_UNIX) as client:
        client.connect(str(daemon.control))
        client.sendall(b"[" * 4096)
        assert b"error" in client.recv(4096)
    for number, text in enumerate(bad, 1):
        daemon.config_path.write_text(text)
        daemon.process.send_signal(signal.SIGHUP)
        daemon.until_counted("configurations refused", number)
    daemon.config_path.write_text(good.replace("mast_height_m = 2.0", "mast_height_m = 2.5"))
    daemon.process.send_signal(signal.SIGHUP)
    daemon.until(lambda status: "configuration read anew" in daemon.log.read_text(), "read anew")

    daemon.until_ready()
    assert daemon.send_request("trigger") == {"answer": "started"}
    assert daemon.send_request("trigger") == {"answer": "busy"}
    status = daemon.until_idle(answers=1)
    (folder,) = (daemon.spool / "bundles").iterdir()
    assert status["last"]["bundle"] == load_bundle(folder).id
    assert load_bundle(folder).mast_height_m == 2.5  # the configuration that was read anew
    assert status["last"]["fix"]["status"] == "none"  # these hills are nowhere
    assert status["last"]["trigger"] == "command"
    assert 0.0 < status["last"]["age_s"] < 3600.0
    assert quick.torques == [0, 0]

    daemon.process.send_signal(signal.SIGUSR1)
    daemon.until(lambda status: any(quick.torques), "moving")
    begun_s = time.monotonic()
    assert daemon.stop() == 0
    assert time.monotonic() - begun_s < ENDS_WITHIN_S
    assert quick.torques == [0, 0]
    assert [path.name for path in (daemon.spool / "bundles").iterdir()] == [folder.name]
    with pytest.raises(ControlError, match="no rig run listens there"):
        send_request(daemon.control, "status")


@pytest.mark.long
def test_legs_that_were_heard_before_the_power_failed_count_after_it(quick: Quick, tmp_path: Path) -> None:
    config = quick.rig.config_path
    run = load_config(config).run
    assert run
    assert run.odometry
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]  # not where the simulated odometer talks
    config.write_text(config.read_text().replace(run.odometry.listen, f"127.0.0.1:{port}"))

    def drive_east() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
            out.sendto(b'{"east_m": 30, "north_m": 0, "sigma_m": 1}', ("127.0.0.1", port))

    with running_daemon(config, tmp_path / "log") as daemon:
        daemon.until_ready()
        daemon.send_request("trigger")
        daemon.until_counted("captures done", 1)
        drive_east()
        heard_s = time.monotonic()
        index = sqlite3.connect(daemon.spool / "index.sqlite")

        def kept(_: object) -> bool:
            (state,) = index.execute("SELECT value FROM memory WHERE name = ?", (ODOMETER,)).fetchone()
            return bool(json.loads(state)["legs_step_m"][0] == 30.0)

        daemon.until(kept, "kept")
        daemon.stop(signal.SIGKILL)
    with running_daemon(config, tmp_path / "log") as daemon:
        daemon.until_ready()
        missed_s = time.monotonic() - heard_s
        drive_east()
        daemon.send_request("trigger")
        daemon.until_counted("captures done", 1)
    ((leg,),) = index.execute("SELECT leg FROM bundles ORDER BY number DESC LIMIT 1").fetchall()
    index.close()
    leg = json.loads(leg)
    assert leg["step_m"] == [60.0, 0.0]
    assert 5.0**2 < leg["covariance_m2"][0][0] < (16.0 * missed_s) ** 2
