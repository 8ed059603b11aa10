"""``rig run`` under a service manager: a real process and socket, and its notifications from start to end."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from fakes.service_manager import SOON_S, Manager

from sim.commands.options import EMBEDDED_DEM

WATCHDOG_S = 1.5
NO_DEVICES = f"""
[rig]
name = "test"
mast_height_m = 2.0
[pan_tilt]
port = "/absent/usb"
[pan_tilt.pan]
id = 1
model = "XM430-W350"
zero_tick = 2048
direction = 1
min_deg = -178.0
max_deg = 178.0
[pan_tilt.tilt]
id = 2
model = "XM430-W350"
zero_tick = 2048
direction = 1
min_deg = -40.0
max_deg = 60.0
[inclinometer]
chip = "adxl355"
bus = "/dev/i2c-99"
address = 0x1D
axes = ["+x", "+y", "+z"]
[camera]
source = "/absent/video"
width_px = 640
height_px = 480
fx_px = 492.8
fy_px = 492.8
cx_px = 319.5
cy_px = 239.5
[run]
retry_most_s = 1.0
dem = ["{EMBEDDED_DEM}"]
"""

# As the program rig, but on a faster clock, and with a way to have one of its loops hang: while there is the file, a probe
# of a device does.
HANGING = """
import pathlib, time
from fakes.timebases import FastClock, on
from rig.commands import cli
from rig.daemon import device_monitor, runtime

def probe(self, name, device, probe=device_monitor.DeviceMonitor._probe):
    while pathlib.Path("hang").exists():
        time.sleep(0.01)
    probe(self, name, device)

device_monitor.DeviceMonitor._probe = probe
runtime.SLOW_BEAT_S = 2.0
with on(FastClock(4.0)):
    cli.main()
"""


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[Manager]:
    opened = Manager(str(tmp_path / "notify"))
    yield opened
    opened.socket.close()


@pytest.fixture
def daemon(tmp_path: Path, manager: Manager) -> Iterator[subprocess.Popen[str]]:
    (tmp_path / "vehicle.toml").write_text(NO_DEVICES)
    environment = {
        **os.environ,
        "PYTHONPATH": str(Path(__file__).parents[1]),
        "NOTIFY_SOCKET": manager.address,
        "WATCHDOG_USEC": str(round(WATCHDOG_S * 1e6)),
    }
    with (tmp_path / "log").open("w") as log:
        process = subprocess.Popen(
            [sys.executable, "-c", HANGING, "run", "--config", "vehicle.toml"],
            env=environment,
            cwd=tmp_path,
            stderr=log,
            text=True,
        )
    yield process
    if process.poll() is None:
        process.kill()
    process.wait()
    print((tmp_path / "log").read_text())  # shown where the test fails


def test_the_messages_to_the_service_manager(
    tmp_path: Path, manager: Manager, daemon: subprocess.Popen[str]
) -> None:
    ready = manager.hears(r"READY=1\nSTATUS=.*")
    assert ready == "READY=1\nSTATUS=idle; head, inclinometer, camera failing; no fix yet"
    manager.hears("WATCHDOG=1")

    # A configuration that is bad, then one that is good.
    config = tmp_path / "vehicle.toml"
    config.write_text(NO_DEVICES.replace("mast_height_m", "mast_hight_m"))
    daemon.send_signal(signal.SIGHUP)
    manager.hears(r"RELOADING=1\nMONOTONIC_USEC=\d+\nSTATUS=.*")
    manager.hears(r"READY=1\nSTATUS=.*")
    config.write_text(NO_DEVICES.replace("name =", "bundle_dir = 'other'\nname ="))
    daemon.send_signal(signal.SIGHUP)
    manager.hears(r"RELOADING=1\nMONOTONIC_USEC=\d+\nSTATUS=.*")
    manager.hears(r"READY=1\nSTATUS=.*")
    manager.hears("WATCHDOG=1")

    # A loop that hangs: whatever else lives, the watchdog is left alone, until the loop gets on.
    (tmp_path / "hang").touch()
    hangs = r"STATUS=devices hangs: nothing for \d+ s, at .*"
    manager.hears(hangs)
    assert [manager.heard().partition(":")[0] for _ in range(3)] == ["STATUS=devices hangs"] * 3
    (tmp_path / "hang").unlink()
    manager.hears(r"STATUS=idle; head, inclinometer, camera failing; no fix yet")
    manager.hears("WATCHDOG=1")

    daemon.send_signal(signal.SIGTERM)
    manager.hears(r"STOPPING=1\nSTATUS=ending on request")
    assert daemon.wait(SOON_S) == 0
    assert manager.read_all() == []
    log = (tmp_path / "log").read_text()
    assert "error: configuration refused" in log
    assert "error: devices hangs: nothing for" in log
    assert "warning: devices gets on again" in log
    assert "Traceback" not in log
