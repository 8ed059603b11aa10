"""The configuration file: what is accepted, and what an engineer reads when something in it is wrong."""

import re
from pathlib import Path

import pytest

from rig.config.load import config_path, load_config
from rig.config.model import RigConfig
from rig.config.sections import I2cAltimeterSection, NmeaCompassSection, SerialAltimeterSection
from rig.errors import ConfigError

VEHICLE = Path(__file__).parents[3] / "configs" / "vehicle.toml"


def load_changed(folder: Path, *changes: tuple[str, str]) -> RigConfig:
    """The example configuration with regular-expression changes, each of which must apply."""
    text = VEHICLE.read_text()
    for pattern, replacement in changes:
        text, count = re.subn(pattern, replacement, text, count=1, flags=re.MULTILINE | re.DOTALL)
        assert count, pattern
    path = folder / "x.toml"
    path.write_text(text)
    return load_config(path)


def problem(folder: Path, *changes: tuple[str, str]) -> str:
    with pytest.raises(ConfigError) as caught:
        load_changed(folder, *changes)
    message = str(caught.value)
    assert "\n" not in message
    assert caught.value.exit_status == 2
    start = f"{folder / 'x.toml'}: "
    assert message.startswith(start)
    return message.removeprefix(start)


def test_the_example_is_valid_and_shows_every_key() -> None:
    config = load_config(VEHICLE)
    assert config.pan_tilt.tilt.id == 2
    assert isinstance(config.altimeter, I2cAltimeterSection)
    text = VEHICLE.read_text()
    sections = [
        config.rig, config.place, config.pan_tilt, config.pan_tilt.pan, config.inclinometer, config.compass,
        config.altimeter, config.camera, config.capture, config.calibration,
    ]  # fmt: skip
    for section in sections:
        assert section is not None
        for key in type(section).model_fields:
            assert re.search(rf"^#? ?{key} = |^(# \[)?\[pan_tilt\.{key}\]", text, re.MULTILINE), key


def test_bundles_go_next_to_the_file(tmp_path: Path) -> None:
    assert load_changed(tmp_path).rig.bundle_dir == tmp_path / "bundles"
    elsewhere = load_changed(tmp_path, ('bundle_dir = "bundles"', 'bundle_dir = "/var/lib/skyfix"'))
    assert elsewhere.rig.bundle_dir == Path("/var/lib/skyfix")


def test_defaults(tmp_path: Path) -> None:
    config = load_changed(tmp_path, (r"^\[capture\].*", ""), (r"^velocity_deg_s.*?$", ""))
    assert config.pan_tilt.velocity_deg_s == 90.0
    assert [d.label for d in config.capture.parsed_directions()] == ["N", "E", "S", "W"]


def test_a_rig_without_compass_or_altimeter(tmp_path: Path) -> None:
    config = load_changed(tmp_path, (r"^\[compass\].*^\[camera\]", "[camera]"), (r"^\[place\].*?^\[", "["))
    assert config.compass is None
    assert config.altimeter is None


def test_serial_compass(tmp_path: Path) -> None:
    serial = '[compass]\nkind = "nmea"\nport = "/dev/ttyUSB1"\n[altimeter]'
    config = load_changed(tmp_path, (r"^\[compass\].*^\[altimeter\]", serial))
    assert isinstance(config.compass, NmeaCompassSection)
    assert config.compass.baud == 4800


TALKERS = """[compass]
kind = "nmea"
port = "{compass}"
require_checksum = false
sentence = "HDG"
[altimeter]
kind = "{kind}"
port = "{altimeter}"
baud = {baud}
{keys}
reference_pressure_hpa = 1013.25
reference_altitude_m = 0.0
[camera]"""


def talkers(
    compass: str = "/dev/a", altimeter: str = "/dev/a", baud: int = 4800, kind: str = "nmea", keys: str = ""
) -> tuple[str, str]:
    """The example configuration with two talkers."""
    text = TALKERS.format(compass=compass, altimeter=altimeter, baud=baud, kind=kind, keys=keys)
    return r"^\[compass\].*^\[camera\]", text


def test_two_talkers_may_share_a_port(tmp_path: Path) -> None:
    config = load_changed(tmp_path, talkers(keys='transducer = "Barometer"'))
    assert isinstance(config.altimeter, SerialAltimeterSection)
    assert config.altimeter.transducer == "Barometer"
    assert load_changed(tmp_path, talkers(altimeter="/dev/b", baud=9600)).altimeter


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            talkers(baud=9600),
            "[compass] and [altimeter] share a port and have another baud each; give both the same",
        ),
        (talkers(kind="vaisala-pa50", keys='transducer = "X"'), "are for kind nmea, not for vaisala-pa50"),
    ],
)
def test_unsuitable_talkers_are_reported(tmp_path: Path, change: tuple[str, str], said: str) -> None:
    assert said in problem(tmp_path, change)


def test_directions_may_be_degrees(tmp_path: Path) -> None:
    config = load_changed(tmp_path, (r"^directions = .*?\]", 'directions = [0, 90.5, "SW"]'))
    assert [d.label for d in config.capture.parsed_directions()] == ["A000", "A090.5", "SW"]


@pytest.mark.parametrize(
    ("pattern", "replacement", "message"),
    [
        ("^fx_px", "fx", "[camera] fx: unknown key; did you mean fx_px?"),
        ("^width_px", "widht_px", "[camera] widht_px: unknown key; did you mean width_px?"),
        ("^name", "colour = 1\nname", "[rig] colour: unknown key"),
        (r"^\[camera\]", "[camrea]", "[camrea]: unknown section; did you mean [camera]?"),
        (
            r"^\[pan_tilt.tilt\]",
            "[pan_tilt.titl]",
            "[pan_tilt.titl]: unknown section; did you mean [pan_tilt.tilt]?",
        ),
        ("^width_px.*?$", "", "[camera] width_px: missing key"),
        (r"^\[inclinometer\].*?^\[", "[", "[inclinometer]: missing section"),
        (
            "^width_px = 640",
            'width_px = "640"',
            "[camera] width_px: input should be a valid integer (found '640')",
        ),
        ("^fx_px = 492.8", "fx_px = -1.0", "[camera] fx_px: input should be greater than 0 (found -1.0)"),
        ("^fx_px = 492.8", "fx_px = inf", "[camera] fx_px: input should be a finite number (found inf)"),
        ("^cx_px = 319.5", "cx_px = 700.0", "[camera]: cx_px 700 lies outside the picture of 640 px"),
        (
            r"^distortion = \[0.0, ",
            "distortion = [",
            "[camera] distortion: wrong number of values (found [0.0, 0.0, 0.0, 0.0])",
        ),
        (
            '^source = "/dev/video0"',
            "source = true",
            "[camera] source: give a URL, a path (/dev/video0) or the number of a video device (0)",
        ),
        (
            '^kind = "bmp390"',
            'kind = "bmp"',
            "[altimeter] kind: 'bmp' is none of bmp390, bmp388, ms5611, ms5607, nmea, vaisala-pa50",
        ),
        ('^kind = "bmp390".*?$', "", "[altimeter] kind: missing key"),
        (
            '^kind = "bmp390"',
            'kind = "nmea"',
            "[altimeter] bus: unknown key; [altimeter] address: unknown key; [altimeter] port: missing key",
        ),
        ("^id = 2", "id = 1", "[pan_tilt]: pan and tilt have the same id 1; give each servo its own"),
        (
            "^zero_tick = 2048",
            "zero_tick = 1000",
            "[pan_tilt.pan]: min_deg -178 with zero_tick 1000 is tick -1025, not in 0 to 4095",
        ),
        ("^min_deg = -40.0", "min_deg = 70.0", "[pan_tilt.tilt]: min_deg 70 is not below max_deg 60"),
        (
            '^model = "XM430-W350"',
            'model = "AX-12A"',
            "[pan_tilt.pan] model: input should be 'XM430-W350' or 'XL430-W250' (found 'AX-12A')",
        ),
        (
            '^bus = "/dev/i2c-1"',
            'bus = "COM3"',
            "[inclinometer] bus: 'COM3' is no I2C bus; give /dev/i2c-N or tcp://HOST:PORT/BUS",
        ),
        (
            r'"\+y", "\+z"\]',
            '"-y", "+z"]',
            "[inclinometer] axes: ['+x', '-y', '+z'] mirrors the chip; "
            "a chip that is only turned has another sign on one axis",
        ),
        (
            r'"\+y", "\+z"\]',
            '"+y", "up"]',
            '[inclinometer] axes: each of x, y and z once, with its sign, for example ["+x", "+y", "+z"]',
        ),
        (
            r"\[-135.0, ",
            "[-179, ",
            "[capture] base_attitude_pan_angles_deg: -179 is beyond [pan_tilt.pan] min_deg -178 and "
            "max_deg 178",
        ),
        (
            r"\[-135.0, -45.0, 45.0, 135.0\]",
            "[0, 10, 20]",
            "[capture] base_attitude_pan_angles_deg: at least three different angles, "
            "90 degrees or more from the first to the last",
        ),
        (
            "^directions = .*?$",
            'directions = ["N", "Q"]',
            "[capture] directions: 'Q' is no direction; give letters (N, NE, ...) or degrees from 0 "
            "to below 360",
        ),
        (
            r"^\[place\].*?^\[",
            "[",
            "[compass] declination_deg: needed to get from magnetic to true north; "
            "give it, or the rough [place] to compute it from",
        ),
        (
            "^baud = 1000000",
            "baud = 12",
            "[pan_tilt] baud: input should be 9600, 57600, 115200, 1000000, 2000000, 3000000, 4000000 "
            "or 4500000 "
            "(found 12)",
        ),
        (r"^\[place\]", "compass = 3\n[place]", "[rig] compass: unknown key"),
    ],
)
def test_what_is_wrong_is_said_with_its_place(
    tmp_path: Path, pattern: str, replacement: str, message: str
) -> None:
    assert problem(tmp_path, (pattern, replacement)) == message


def test_several_problems_are_all_counted(tmp_path: Path) -> None:
    changes = [(f"^{key}", f"{key}_old") for key in ("fx_px", "fy_px", "cx_px", "cy_px", "width_px")]
    message = problem(tmp_path, *changes)
    assert message.startswith("[camera] ")
    assert message.endswith("; and 2 more")
    assert message.count("did you mean") == 3


def test_a_section_that_is_a_value(tmp_path: Path) -> None:
    message = problem(tmp_path, (r"^\[place\].*?^\[", "["), (r"^\[rig\]", "place = 1\n[rig]"))
    assert message == "place: must be a section, [place]"


def test_quarter_turns_of_the_chip_are_accepted(tmp_path: Path) -> None:
    for turned in ('["+y", "-x", "+z"]', '["-x", "-y", "+z"]', '["+y", "+z", "+x"]', '["-y", "-z", "+x"]'):
        load_changed(tmp_path, (r'^axes = \["\+x", "\+y", "\+z"\]', f"axes = {turned}"))


def test_two_axis_chip_must_lie_flat(tmp_path: Path) -> None:
    upright = problem(
        tmp_path,
        ('"adxl355"', '"iis2iclx"'),
        (r'^axes = \["\+x", "\+y", "\+z"\]', 'axes = ["+y", "+z", "+x"]'),
    )
    assert upright == "[inclinometer]: axes: iis2iclx measures x and y only, so its z must be the head's z"


def test_broken_toml_names_the_line(tmp_path: Path) -> None:
    assert re.search(r"is not valid TOML: .*line \d+", problem(tmp_path, ("^name = ", "name = = ")))


def test_absent_file(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"absent\.toml: cannot be read: No such file or directory"):
        load_config(tmp_path / "absent.toml")
    with pytest.raises(ConfigError, match="cannot be read: Is a directory"):
        load_config(tmp_path)


def test_which_file() -> None:
    assert config_path(Path("a.toml"), {"SKYFIX_CONFIG": "b.toml"}) == Path("a.toml")
    assert config_path(None, {"SKYFIX_CONFIG": "b.toml"}) == Path("b.toml")
    with pytest.raises(ConfigError, match="--config FILE or set SKYFIX_CONFIG"):
        config_path(None, {})


def test_keep_out_zones_are_checked(tmp_path: Path) -> None:
    def zone(keys: str) -> tuple[str, str]:
        return (r"^# \[\[pan_tilt.keep_out\]\]$", f"[[pan_tilt.keep_out]]\n{keys}\n")

    zones = load_changed(tmp_path, zone("pan_min_deg = 160.0\ntilt_max_deg = -10.0")).pan_tilt.keep_out
    assert [(z.pan_min_deg, z.pan_max_deg, z.tilt_max_deg) for z in zones] == [(160.0, 180.0, -10.0)]
    assert problem(tmp_path, zone("pan_mim_deg = 160.0")).startswith(
        "[pan_tilt.keep_out] pan_mim_deg: unknown key"
    )
    assert "needs each min_deg below its max_deg" in problem(tmp_path, zone("pan_max_deg = -180.0"))
    assert "pan 135, tilt 0 lies in the keep-out zone pan 100 to 180" in problem(
        tmp_path, zone("pan_min_deg = 100.0")
    )
