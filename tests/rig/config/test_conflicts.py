"""Two keys that want the same thing for themselves are refused with the configuration, and both are named."""

import re
from pathlib import Path

import pytest

from rig.config.load import load_config
from rig.errors import ConfigError

EXAMPLE = (Path(__file__).parents[3] / "configs" / "vehicle.toml").read_text()
SERVO_PORT = "/dev/serial/by-id/usb-FTDI_USB__-__Serial_Converter_FT000000-if00-port0"
COMPASS_THAT_TALKS = (
    '[compass]\nkind = "nmea"\nport = "{port}"\ndeclination_deg = 13.0\n\n# Leave the section'
)
BAROMETER_THAT_TALKS = (
    '[altimeter]\nkind = "nmea"\nport = "{port}"\n'
    "reference_pressure_hpa = 1013.25\nreference_altitude_m = 0.0\n\n[camera]"
)


def loaded(tmp_path: Path, *changes: tuple[str, str]) -> str | None:
    """What is wrong with the example after ``changes``; None where nothing is."""
    text = EXAMPLE
    for pattern, replacement in changes:
        text, count = re.subn(pattern, replacement, text, count=1, flags=re.DOTALL | re.MULTILINE)
        assert count, pattern
    (tmp_path / "rig.toml").write_text(text)
    try:
        load_config(tmp_path / "rig.toml")
    except ConfigError as error:
        return str(error)
    return None


def talking_compass(port: str) -> tuple[str, str]:
    return r"^\[compass\].*?^# Leave the section", COMPASS_THAT_TALKS.replace("{port}", port)


def talking_barometer(port: str) -> tuple[str, str]:
    return r"^\[altimeter\].*?^\[camera\]", BAROMETER_THAT_TALKS.replace("{port}", port)


def run_section(text: str) -> tuple[str, str]:
    return r"^\[run.nmea\].*?(?=^# ArduPilot)", text + "\n"


@pytest.mark.parametrize(
    ("changes", "first", "second"),
    [
        ([talking_compass(SERVO_PORT)], "[pan_tilt] port", "[compass] port"),
        ([talking_barometer(SERVO_PORT)], "[pan_tilt] port", "[altimeter] port"),
        ([("^address = 0x30", "address = 0x1D")], "[inclinometer] address", "[compass] address"),
        ([("^address = 0x76", "address = 0x30")], "[compass] address", "[altimeter] address"),
        ([("^address = 0x76", "address = 0x1D")], "[inclinometer] address", "[altimeter] address"),
        (
            [('^bus = "/dev/i2c-1"\naddress = 0x30', 'bus = "i2c-1"\naddress = 0x1D')],
            "[inclinometer] address",
            "[compass] address",
        ),
        (
            [("^listen = .127.0.0.1:8080.", 'listen = "127.0.0.1:10110"')],
            "[run.http] listen",
            "[run.nmea] tcp",
        ),
        ([("^listen = .127.0.0.1:8080.", 'listen = "0.0.0.0:10110"')], "[run.http] listen", "[run.nmea] tcp"),
        (
            [("^listen = .127.0.0.1:8080.", 'listen = "localhost:10110"')],
            "[run.http] listen",
            "[run.nmea] tcp",
        ),
        (
            [run_section('[run.nmea]\nudp = ["127.0.0.1:10111"]\n[run.odometry]')],
            "[run.nmea] udp",
            "[run.odometry] listen",
        ),
        (
            [run_section('[run.odometry]\n[run.mavlink]\nconnection = "udpin:0.0.0.0:10111"')],
            "[run.odometry] listen",
            "[run.mavlink] connection",
        ),
        (
            [run_section('[run.odometry]\n[run.mavlink]\nconnection = "udpout:127.0.0.1:10111"')],
            "[run.mavlink] connection",
            "[run.odometry] listen",
        ),
        (
            [
                run_section(
                    '[run.nmea]\nudp = ["127.0.0.1:14550"]\n[run.mavlink]\nconnection = "udpout:127.0.0.1:14550"'
                )
            ],
            "[run.nmea] udp",
            "[run.mavlink] connection",
        ),
        (
            [run_section('[run.nmea]\n[run.mavlink]\nconnection = "tcp:127.0.0.1:10110"')],
            "[run.mavlink] connection",
            "[run.nmea] tcp",
        ),
        (
            [run_section(f'[run.mavlink]\nconnection = "{SERVO_PORT}"')],
            "[pan_tilt] port",
            "[run.mavlink] connection",
        ),
        ([('^dir = "spool"', 'dir = "bundles"')], "[rig] bundle_dir", "[run.spool] dir"),
        ([('^dir = "spool"', 'dir = "./bundles/"')], "[rig] bundle_dir", "[run.spool] dir"),
        ([('^# control = "control.sock"', 'control = "spool"')], "[run.spool] dir", "[run] control"),
        ([('^# control = "control.sock"', 'control = "terrain.tif"')], "[run] control", "[run] dem"),
        (
            [
                ('^# control = "control.sock"', 'control = "token"'),
                ('^# token_file = "token"', 'token_file = "token"'),
            ],
            "[run] control",
            "[run.http] token_file",
        ),
        (
            [('^# camera = "[^"]*"', 'camera = "a.json"'), ('^# compass = "[^"]*"', 'compass = "a.json"')],
            "[calibration] camera",
            "[calibration] compass",
        ),
    ],
)
def test_two_keys_that_cannot_both_be_are_named(
    tmp_path: Path, changes: list[tuple[str, str]], first: str, second: str
) -> None:
    told = loaded(tmp_path, *changes)
    assert told is not None
    assert f"{first} and {second}" in told or f"{first} sends to where {second}" in told
    assert "\n" not in told


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        ([("^dem = .*?$", 'dem = ["a.tif", "./a.tif"]')], "[run] dem: a.tif is there twice"),
        ([run_section('[run.nmea]\nudp = ["h:1", "h:1"]')], "[run.nmea] udp: h:1 is there twice"),
    ],
)
def test_what_is_there_twice_is_named(tmp_path: Path, changes: list[tuple[str, str]], what: str) -> None:
    assert what in (loaded(tmp_path, *changes) or "")


def test_one_port_under_two_names_is_one_port(tmp_path: Path) -> None:
    (tmp_path / "ttyUSB0").touch()
    (tmp_path / "by-id").symlink_to(tmp_path / "ttyUSB0")
    told = loaded(
        tmp_path,
        ('^port = "[^"]*"', f'port = "{tmp_path}/by-id"'),
        talking_compass(f"{tmp_path}/ttyUSB0"),
    )
    assert told
    assert "[pan_tilt] port and [compass] port are the same port" in told


@pytest.mark.parametrize(
    "changes",
    [
        [],
        [talking_compass("/dev/ttyS1"), talking_barometer("/dev/ttyS1")],  # one talker that says both
        [('^bus = "/dev/i2c-1"\naddress = 0x30', 'bus = "/dev/i2c-2"\naddress = 0x1D')],  # another bus
        [("^listen = .127.0.0.1:8080.", 'listen = "127.0.0.1:0"'), ("^tcp = [^#]*", 'tcp = "127.0.0.1:0" ')],
        [("^listen = .127.0.0.1:8080.", 'listen = "192.168.1.2:10110"')],  # another interface
        [run_section('[run.nmea]\nudp = ["127.0.0.1:10110"]')],  # UDP beside TCP
    ],
)
def test_what_can_be_is_left_alone(tmp_path: Path, changes: list[tuple[str, str]]) -> None:
    assert loaded(tmp_path, *changes) is None
