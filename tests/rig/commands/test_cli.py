"""The command ``rig`` as an operator meets it: one clear line and status 2 for bad input, nothing half-written."""

import json
import os
import re
import signal
import threading
import time
from pathlib import Path
from typing import Any

import pytest
from fakes.chips import FakeI2cBus, RegisterChip
from fakes.command import Run, one_line, toml, written
from fakes.whole_rig import RunningRig

from localizer.bundle import load_bundle
from rig.attitude.kinematics import camera_pointing
from rig.config.load import EXAMPLE


def test_help_has_examples(run: Run) -> None:
    for command in ([], ["capture"], ["check"]):
        status, out, _ = run(*command, "--help")
        assert status == 0
        assert "Example" in out


def test_a_capture(run: Run, running: RunningRig, tmp_path: Path) -> None:
    config = written(running, tmp_path)
    status, out, err = run("capture", "--config", config, "--directions", "N,135")
    assert status == 0
    bundle = load_bundle(Path(out.strip()))
    assert bundle.directory.parent == tmp_path / "bundles"
    assert [frame.label for frame in bundle.frames] == ["N", "A135"]
    lines = err.splitlines()
    assert len(lines) == 3
    assert lines[0].startswith("vehicle: heading 30.")
    assert {line.split(":")[0] for line in lines[1:]} == {"N", "A135"}


def test_a_capture_as_json(run: Run, running: RunningRig, tmp_path: Path) -> None:
    status, out, _ = run("capture", "--config", written(running, tmp_path), "--directions", "E", "--json")
    assert status == 0
    found = json.loads(out)
    assert load_bundle(Path(found["directory"])).id == found["id"]
    assert found["readings"]["heading_deg"] == pytest.approx(30.0, abs=0.2)
    assert found["took_s"] > 0.0


def test_the_configuration_of_the_environment(
    run: Run, running: RunningRig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SKYFIX_CONFIG", str(written(running, tmp_path)))
    status, out, _ = run("capture", "--directions", "N", "--out", "elsewhere")
    assert status == 0
    assert Path(out.strip()).parent == Path("elsewhere")


def test_no_configuration(run: Run) -> None:
    assert one_line(run("capture")) == (
        f"rig: no configuration: give --config FILE or set SKYFIX_CONFIG (example: {EXAMPLE})"
    )
    assert "absent.toml: cannot be read" in one_line(run("check", "--config", "absent.toml"))


@pytest.mark.parametrize(
    ("section", "key", "value", "said"),
    [
        ("camera", "fx", 492.8, "[camera] fx: unknown key"),
        ("camera", "width_px", "wide", "[camera] width_px: input should be a valid integer (found 'wide')"),
        ("capture", "directions", ["N", "up"], "[capture] directions: 'up' is no direction"),
    ],
)
def test_wrong_keys(
    run: Run, running: RunningRig, tmp_path: Path, section: str, key: str, value: object, said: str
) -> None:
    config = written(running, tmp_path, **{section: {key: value}})
    assert f"rig: {config}: {said}" in one_line(run("capture", "--config", config))
    assert not (tmp_path / "bundles").exists()


@pytest.mark.parametrize(
    ("names", "said"),
    [
        ("N,Q", "'Q' is no direction; give letters"),
        ("", "'' is no direction"),
        ("N,E,90", "'90' is given twice (also as E)"),
        ("400", "'400' is no direction"),
    ],
)
def test_nonsense_as_directions(run: Run, running: RunningRig, tmp_path: Path, names: str, said: str) -> None:
    line = one_line(run("capture", "--config", written(running, tmp_path), "--directions", names))
    assert line.startswith("rig capture: --directions: ")
    assert said in line


def test_locate_needs_a_dem(run: Run, running: RunningRig, tmp_path: Path) -> None:
    config = written(running, tmp_path)
    line = one_line(run("capture", "--config", config, "--locate"))
    assert "--locate: say where with --dem FILE; there is no [run] dem" in line
    assert not running.servos.requests


def test_locate_searches_what_the_daemon_would(run: Run, running: RunningRig, tmp_path: Path) -> None:
    config = written(running, tmp_path, run={"dem": ["the_daemons.tif"]})
    assert "the_daemons.tif" in one_line(run("capture", "--config", config, "--locate"))
    assert "mine.tif" in one_line(run("capture", "--config", config, "--locate", "--dem", "mine.tif"))


def test_what_is_said_of_a_dem_needs_one(run: Run) -> None:
    assert "--dem and what is said of it go with --locate" in one_line(run("capture", "--dem", "x.tif"))
    assert "--dem and what is said of it go with --locate" in one_line(run("capture", "--dem-error", "3"))
    assert "--dem FILE is missing" in one_line(run("capture", "--locate", "--crs", "EPSG:4326"))


def test_an_unreadable_dem_is_reported_before_anything_moves(
    run: Run, running: RunningRig, tmp_path: Path
) -> None:
    config = written(running, tmp_path)
    assert "x.tif" in one_line(run("capture", "--config", config, "--locate", "--dem", "x.tif"))
    assert not running.servos.requests


def test_out_is_not_writable(run: Run, running: RunningRig, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    line = one_line(run("capture", "--config", written(running, tmp_path), "--out", "file/bundles"))
    assert line == "rig: file/bundles: file is not a directory; choose another with --out"
    assert not running.servos.requests


def test_the_servo_port_is_absent(run: Run, running: RunningRig, tmp_path: Path) -> None:
    config = written(running, tmp_path, pan_tilt={"port": "/dev/ttyUSB77"})
    line = one_line(run("capture", "--config", config))
    assert line.startswith("rig: serial port /dev/ttyUSB77: ")
    assert not (tmp_path / "bundles").exists()


def test_a_servo_of_another_model(run: Run, running: RunningRig, tmp_path: Path) -> None:
    running.rig.tilt.put(0, 2, 1060)
    line = one_line(run("capture", "--config", written(running, tmp_path)))
    assert "expected id 1: XM430-W350, id 2: XM430-W350, found id 1: XM430-W350, id 2: XL430-W250" in line
    assert not running.rig.torque_is_on
    assert not (tmp_path / "bundles").exists()


def test_a_chip_with_the_wrong_identity(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    adxl359 = RegisterChip(bytes([0xAD, 0x1D, 0xE9, 0x01]).ljust(256, b"\0"))
    monkeypatch.setattr("rig.devices.bus.i2c_chip.open_i2c", lambda url: FakeI2cBus({0x1D: adxl359}))
    config = tmp_path / "rig.toml"
    config.write_text((Path(__file__).parents[3] / "configs" / "vehicle.toml").read_text())
    line = one_line(run("capture", "--config", config))
    assert "ADXL355 at 0x1D" in line
    assert "holds 0xE9 instead of 0xED (0xE9 in 0x02 is an ADXL359)" in line


def test_the_camera_is_absent(run: Run, running: RunningRig, tmp_path: Path) -> None:
    config = written(running, tmp_path, camera={"source": "http://127.0.0.1:9/stream.mjpg"})
    line = one_line(run("capture", "--config", config))
    assert line.startswith(
        "rig: camera http://127.0.0.1:9/stream.mjpg: cannot be opened: the connection is refused"
    )
    assert not running.rig.torque_is_on


def test_no_way_from_magnetic_to_true_north(run: Run, running: RunningRig, tmp_path: Path) -> None:
    tables = running.settings()
    compass: Any = tables["compass"]
    del compass["declination_deg"]
    config = tmp_path / "rig.toml"
    config.write_text(toml(tables))
    line = one_line(run("capture", "--config", config))
    assert "[compass] declination_deg: needed to get from magnetic to true north" in line


@pytest.mark.parametrize(
    ("number", "status", "said"),
    [(signal.SIGINT, 130, "interrupted"), (signal.SIGTERM, 143, "ended by SIGTERM")],
)
def test_stopped_by_a_signal(
    run: Run, running: RunningRig, tmp_path: Path, number: signal.Signals, status: int, said: str
) -> None:
    def stop_twice() -> None:
        while not running.rig.torque_is_on or running.rig.readings_taken < 2:
            time.sleep(0.02)
        os.kill(os.getpid(), number)
        time.sleep(0.01)
        os.kill(os.getpid(), number)  # an impatient operator

    threading.Thread(target=stop_twice, daemon=True).start()
    ended, out, err = run("capture", "--config", written(running, tmp_path))
    assert (ended, out) == (status, "")
    assert err.splitlines()[-1] == f"rig: {said}"
    assert not running.rig.torque_is_on
    assert not (tmp_path / "bundles").exists()


def test_check_of_a_sound_rig(run: Run, running: RunningRig, tmp_path: Path) -> None:
    config = written(running, tmp_path)
    status, out, err = run("check", "--config", config)
    assert (status, err) == (0, "")
    for words in ("pan and tilt", "12.1 12.1", "inclinometer", "compass", "48.3 uT", "540.3 m", "frames/s"):
        assert words in out
    assert "FAILED" not in out
    assert not running.rig.torque_is_on
    assert not running.servos.written(116), "nothing moves"


def test_check_goes_on_after_a_failure(run: Run, running: RunningRig, tmp_path: Path) -> None:
    config = written(running, tmp_path, camera={"source": "http://127.0.0.1:9/"}, altimeter=None)
    running.rig.pan.put(70, 1, 0x20)
    status, out, _ = run("check", "--config", config, "--json")
    assert status == 1
    found = json.loads(out)
    devices = {device["device"]: device for device in found["devices"]}
    assert not found["ok"]
    assert list(devices) == ["pan and tilt", "inclinometer", "compass", "camera"]
    assert "overload" in devices["pan and tilt"]["problem"]
    assert devices["pan and tilt"]["volts"] == pytest.approx([12.1, 12.1])
    assert "cannot be opened" in devices["camera"]["problem"]
    assert devices["inclinometer"]["ok"]
    status, out, _ = run("check", "--config", config)
    assert status == 1
    assert (
        "camera: camera http://127.0.0.1:9/: cannot be opened: the connection is refused: nothing listens on port 9"
        in out
    )


def test_check_finds_what_only_measuring_shows(run: Run, running: RunningRig, tmp_path: Path) -> None:
    running.rig.swing_deg, running.rig.swing_until_s = 0.5, float("inf")
    running.rig.pressure_hpa = 250.0
    running.rig.horizon_deg = lambda azimuth_deg: azimuth_deg * 0.0 + 90.0
    hard_iron = {"hard_iron_ut": [90.0, 90.0, 0.0]}
    status, out, _ = run("check", "--config", written(running, tmp_path, compass=hard_iron), "--json")
    problems = {device["device"]: device["problem"] for device in json.loads(out)["devices"]}
    assert status == 1
    assert "deg is above 0.005 deg" in problems["inclinometer"]
    assert "uT is not the Earth's field" in problems["compass"]
    assert "would be an altitude of" in problems["altimeter"]


def test_move(run: Run, running: RunningRig, tmp_path: Path) -> None:
    config = written(running, tmp_path)
    status, out, err = run("move", "--config", config, "40", "-10")
    assert (status, err) == (0, "")
    assert re.fullmatch(r"pan (39\.9|40\.0)\d, tilt -(9\.9|10\.0)\d deg, torque off\n", out)
    assert not running.rig.torque_is_on
    status, out, _ = run("move", "--config", config, "--park", "--json")
    assert json.loads(out)["pan_deg"] == pytest.approx(0.0, abs=0.1)
    assert run("move", "--config", config, "--relax")[0] == 0
    assert run("move", "--config", config, "40", "-10")[0] == 0
    status, out, _ = run("move", "--config", config, "--park", "--relax", "--json")  # in this order
    assert (status, json.loads(out)["pan_deg"]) == (0, pytest.approx(0.0, abs=0.1))
    assert not running.rig.torque_is_on


@pytest.mark.parametrize(
    "arguments", [(), ("40",), ("1", "2", "--park"), ("--park", "--azimuth", "3"), ("40", "--relax")]
)
def test_move_wants_one_goal(
    run: Run, running: RunningRig, tmp_path: Path, arguments: tuple[str, ...]
) -> None:
    line = one_line(run("move", "--config", written(running, tmp_path), *arguments))
    assert "Give PAN and TILT, or --azimuth, or --park, or --relax." in line
    assert not running.servos.requests


def test_the_camera_is_turned_to_a_true_azimuth(run: Run, running: RunningRig, tmp_path: Path) -> None:
    options = "--config", written(running, tmp_path)
    status, out, err = run("move", *options, "--azimuth", "75", "--tilt", "4", "--json")
    assert (status, err) == (0, "")
    found = json.loads(out)
    assert found["azimuth_deg"] == pytest.approx(75.0, abs=0.1)
    assert found["camera_tilt_deg"] == pytest.approx(4.0, abs=0.1)
    looks = camera_pointing(running.rig.base, running.rig.joints(), running.rig.boresight)
    assert looks.azimuth_deg == pytest.approx(75.0, abs=0.2), "by the truth"
    assert not running.rig.torque_is_on
    assert "--tilt goes with --azimuth" in one_line(run("move", *options, "--park", "--tilt", "4"))
    without = "--config", written(running, tmp_path, compass=None)
    assert "has no [compass]" in one_line(run("move", *without, "--azimuth", "75"))


def test_a_goal_beyond_the_limits_moves_nothing(run: Run, running: RunningRig, tmp_path: Path) -> None:
    line = one_line(run("move", "--config", written(running, tmp_path), "179", "0"))
    assert "pan goal 179 deg is outside its limits -178 to 178 deg" in line
    assert not running.servos.written(116)
    assert not running.rig.torque_is_on


def test_a_session_is_recorded(run: Run, running: RunningRig, tmp_path: Path) -> None:
    config, log = written(running, tmp_path), tmp_path / "x.log"
    status, _, err = run("record", "--config", config, log, "move", "--relax")
    assert (status, err) == (0, "")
    header, *lines = map(json.loads, log.read_text().splitlines())
    assert header["config"]["pan_tilt"]["port"] == running.servos.path
    assert "source" not in header["config"]["camera"]
    assert lines[0]["port"] == running.servos.path
    assert bytes.fromhex(lines[0]["sent"]) == running.servos.requests[0]
    assert any("received" in line for line in lines)
    assert "x.log: cannot be written" in one_line(run("record", "--config", config, log, "move", "--relax"))


def test_a_command_to_record_is_looked_up_before_the_log_is_begun(
    run: Run, running: RunningRig, tmp_path: Path
) -> None:
    config, log = written(running, tmp_path), tmp_path / "y.log"
    assert "'mvoe' is no command of rig to record" in one_line(run("record", "--config", config, log, "mvoe"))
    assert not log.exists()
    status, _, _ = run("record", "--config", config, log, "rig", "move", "--relax")
    assert status == 0


def test_a_group_alone_names_its_commands_in_one_line(run: Run) -> None:
    status, out, err = run("calibrate")
    assert (status, out) == (2, "")
    assert err.count("\n") == 1
    assert "Name a command: altimeter, board, boresight" in err
