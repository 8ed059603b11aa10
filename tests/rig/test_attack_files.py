"""Files from anybody, through every command and reader that takes one: one line, status 2, little time and memory."""

import hashlib
import json
import os
import subprocess
import sys
import time
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import click
import lz4.frame
import numpy as np
import pytest
from click.testing import CliRunner
from fakes.attacks import BOM, JSON_ATTACKS, TOML_ATTACKS
from fakes.bundle import write_one
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType, Writer
from PIL import Image

from localizer.bundle import BundleError, Camera, load_bundle
from localizer.errors import SkyfixError
from localizer.track.tracker import TrackerError
from rig.bundle.writer import BundleWriteError, FrameRecord, Measurement, write_bundle
from rig.calibrate.camera.procedure import views_from_files
from rig.calibrate.camera.target import parse_target
from rig.calibrate.config_edit import name_in_config
from rig.calibrate.inclinometer.temperature import read_drift
from rig.clock import utc_now
from rig.commands.cli import rig
from rig.config.calibration_files import CalibrationError, read_calibration
from rig.config.load import load_config
from rig.config.run import control_socket_of_invalid_config
from rig.daemon.http.access_control import read_token
from rig.daemon.spool.index import stored_leg
from rig.daemon.spool.store import Spool
from rig.errors import ConfigError
from rig.series.journal import SeriesError, load_series, locked_series
from rig.telemetry import reader
from rig.telemetry.reader import TelemetryFile, TelemetryReadError, mend
from sim.commands.cli import sim
from sim.commands.options import EMBEDDED_DEM
from sim.errors import SimulationError
from sim.evaluate.photos.source import read_json
from sim.evaluate.scenario import load_evaluation_scenario
from sim.faults.script import load_faults
from sim.replay.log_file import load_log
from sim.world.scenario import load_scenario

EXAMPLE = Path(__file__).parents[2] / "configs" / "vehicle.toml"
LOG = next((Path(__file__).parents[1] / "logs").glob("*.log"))

TOML_READERS: dict[str, Callable[[Path], object]] = {
    "configuration": load_config,
    "faults": load_faults,
    "scenario": load_scenario,
    "evaluation scenario": load_evaluation_scenario,
    "naming of a calibration": lambda file: name_in_config(file, "camera", file.parent / "camera.json"),
}


def as_series(file: Path) -> object:
    (file.parent / "series.jsonl").write_bytes(file.read_bytes().replace(b"\n", b" ") + b"\n")
    return load_series(file.parent)


def as_faults(file: Path) -> object:
    (file.parent / "faults.json").write_bytes(file.read_bytes())
    return load_faults(file.parent / "faults.json")


JSON_READERS: dict[str, Callable[[Path], object]] = {
    "calibration": read_calibration,
    "series": as_series,
    "faults": as_faults,
    "log": load_log,
    "research data": read_json,
}


@pytest.mark.parametrize("reader", TOML_READERS)
@pytest.mark.parametrize("attack", TOML_ATTACKS)
def test_every_reader_of_toml_refuses_it_in_one_line(tmp_path: Path, reader: str, attack: str) -> None:
    file = tmp_path / "x.toml"
    file.write_bytes(TOML_ATTACKS[attack])
    begun = time.thread_time()
    with pytest.raises((SkyfixError, SimulationError)) as refusal:
        TOML_READERS[reader](file)
    assert time.thread_time() - begun < 1.0
    assert str(file) in str(refusal.value)
    assert len(str(refusal.value)) < 600
    assert control_socket_of_invalid_config(file) is None


@pytest.mark.parametrize("reader", JSON_READERS)
@pytest.mark.parametrize("attack", JSON_ATTACKS)
def test_every_reader_of_json_refuses_it_in_one_line(tmp_path: Path, reader: str, attack: str) -> None:
    file = tmp_path / "x.json"
    file.write_bytes(JSON_ATTACKS[attack])
    begun = time.thread_time()
    with pytest.raises((SkyfixError, SimulationError)) as refusal:
        JSON_READERS[reader](file)
    assert time.thread_time() - begun < 1.0
    assert str(tmp_path) in str(refusal.value)
    assert len(str(refusal.value)) < 600


COMMANDS = {
    "check": (rig, ["check", "--config"]),
    "move": (rig, ["move", "0", "0", "--config"]),
    "watch": (rig, ["watch", "--once", "--config"]),
    "capture": (rig, ["capture", "--out", "{folder}", "--config"]),
    "run": (rig, ["run", "--config"]),
    "status": (rig, ["status", "--config"]),
    "trigger": (rig, ["trigger", "--config"]),
    "faults": (sim, ["run", "{file}", "--", "true"]),
    "scenario": (sim, ["run", "{file}", "--", "true"]),
    "render": (sim, ["render", "--out", "{folder}", "--scenario"]),
    "evaluate": (sim, ["evaluate", "--dem", str(EMBEDDED_DEM), "--out", "{folder}", "--scenario"]),
    "replay": (sim, ["replay", "{file}", "--", "true"]),
}


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_that_reads_one_says_so_in_one_line(tmp_path: Path, command: str) -> None:
    file = tmp_path / "nested.toml"
    file.write_bytes(TOML_ATTACKS["arrays"])
    group, words = COMMANDS[command]
    option = f"--{command}={file}" if command in ("faults", "scenario") else str(file)
    arguments = [word.format(folder=tmp_path / "out", file=option) for word in words]
    arguments += [] if "{file}" in words else [str(file)]
    told = CliRunner().invoke(group, arguments, standalone_mode=False)
    assert isinstance(told.exception, SkyfixError), told.output
    assert told.exception.exit_status == 2
    assert str(file) in str(told.exception)
    assert "\n" not in str(told.exception)


def test_a_byte_order_mark_before_each_toml(tmp_path: Path) -> None:
    """As Windows' editors put it there."""
    file = tmp_path / "vehicle.toml"
    file.write_bytes(BOM + EXAMPLE.read_bytes())
    assert load_config(file).pan_tilt == load_config(EXAMPLE).pan_tilt
    assert control_socket_of_invalid_config(file) == tmp_path / "spool" / "control.sock"
    name_in_config(file, "camera", tmp_path / "calibration" / "camera.json")
    assert 'camera = "calibration/camera.json"' in file.read_text(encoding="utf-8")
    (tmp_path / "x.toml").write_bytes(BOM + b'[[fault]]\nat = 1\ndevice = "compass"\nfault = "nack"\n')
    assert len(load_faults(tmp_path / "x.toml")) == 1
    (tmp_path / "y.toml").write_bytes(BOM + b"[place]\nlat_deg = 37.2\nlon_deg = -122.1\n")
    assert load_scenario(tmp_path / "y.toml").place.lat_deg == 37.2


# ---- logs, series, tokens, spools


@pytest.mark.parametrize(
    ("line", "problem"),
    [
        ('{"t": 0.1}', "neither a port nor a bus"),
        ("[]", "no JSON object"),
        ('{"t": "x", "port": "a", "sent": "00"}', "number of seconds"),
        ('{"t": 0.1, "port": "a", "sent": "0g"}', "hexadecimal"),
        ('{"t": 0.1, "port": 5, "sent": "00"}', "no name"),
        ('{"t": 0.1, "bus": "a", "address": 1e9, "write": "", "length": 1, "read": "00"}', "address"),
        ('{"t": 0.1, "bus": "a", "address": 29, "write": "", "length": 1000000000, "read": "00"}', "length"),
        ('{"t": 0.1, "bus": "a", "address": 29, "write": "", "length": 1}', "read is no bytes"),
    ],
)
def test_a_log_whose_lines_are_none_is_refused_before_a_device_is_played(
    tmp_path: Path, line: str, problem: str
) -> None:
    header, first = LOG.read_text().splitlines()[:2]
    (tmp_path / "x.log").write_text(f"{header}\n{line}\n{first}\n")
    with pytest.raises(SimulationError, match=problem):
        load_log(tmp_path / "x.log")


@pytest.mark.parametrize(
    "config", ["5", "[]", "{}", '{"camera": 5}', '{"camera": {"width_px": 30000, "height_px": 30000}}']
)
def test_a_log_without_a_configuration_is_refused(tmp_path: Path, config: str) -> None:
    first = LOG.read_text().splitlines()[1]
    (tmp_path / "x.log").write_text(f'{{"skyfix_log": 1, "config": {config}}}\n{first}\n{first}\n')
    with pytest.raises(SimulationError, match="is no log of rig record"):
        load_log(tmp_path / "x.log")


@pytest.mark.parametrize("bundle", ["../../evil", "/etc/evil", "", ".hidden", "a/b"])
def test_a_series_names_no_bundle_that_leads_elsewhere(tmp_path: Path, bundle: str) -> None:
    plan = {"repeat": 2, "every_s": 0.0, "directions": ["N"], "rig": "x"}
    taken = {"taken": 1, "time": "2026-11-24T15:00:00Z", "took_s": 1.0, "bundle": bundle, "readings": {}}
    lines = [{"schema": "skyfix.series/1", "plan": plan}, taken]
    (tmp_path / "series.jsonl").write_text("".join(f"{json.dumps(line)}\n" for line in lines))
    with pytest.raises(SeriesError, match="line 2 is damaged"):
        load_series(tmp_path)


@pytest.mark.parametrize(
    "line",
    [
        b"t,nan,0,0,1",
        b"t,20,inf,0,1",
        b"t,1e999,0,0,1",
        b"t,20,0,0",
        b"t,20,0,0,1\0",
        b"t,20,0,0," + b"1" * 200_000,
        b'"' + b"x" * 200_000,
        b"\xff",
    ],
    ids=lambda line: line[:20],
)
def test_a_temperature_log_that_makes_no_sense_is_refused_in_one_line(tmp_path: Path, line: bytes) -> None:
    log = tmp_path / "log.csv"
    good = b"".join(b"t,%d,0,0,1\n" % warm for warm in range(20))
    log.write_bytes(b"time,temperature_c,x_g,y_g,z_g\n" + good + line + b"\n")
    with pytest.raises(CalibrationError) as refusal:
        read_drift(log)
    assert str(refusal.value).isprintable()


TAKEN = {"taken": 1, "time": "2026-11-24T15:00:00Z", "took_s": 1.0, "bundle": "a", "readings": {}}


@pytest.mark.parametrize(
    "entry",
    [
        *({**TAKEN, "taken": number} for number in ("../../../x", -1, 0, 1.5, True, None, 10**30, [1])),
        {**TAKEN, "took_s": "x"},
        {**TAKEN, "readings": [1]},
        {**TAKEN, "time": "2026-11-24T15:00:00"},
        {"begun": "../x", "time": "2026-11-24T15:00:00Z"},
        {"begun": None, "time": "2026-11-24T15:00:00Z"},
        {"failed": 1, "time": "2026-11-24T15:00:00Z", "took_s": 1.0, "reason": {"a": 1}},
    ],
    ids=str,
)
def test_a_series_whose_record_makes_no_sense_is_refused_with_its_line(
    tmp_path: Path, entry: dict[str, object]
) -> None:
    """The number, too, becomes part of a file's name; the rest is reckoned with and printed."""
    plan = {"repeat": 2, "every_s": 0.0, "directions": ["N"], "rig": "x"}
    lines = [{"schema": "skyfix.series/1", "plan": plan}, entry]
    (tmp_path / "series.jsonl").write_text("".join(f"{json.dumps(line)}\n" for line in lines))
    with pytest.raises(SeriesError, match="line 2 is damaged"):
        load_series(tmp_path)


def test_links_among_what_a_series_left_half_written_are_taken_away_and_not_followed(tmp_path: Path) -> None:
    folder = tmp_path / "series-1"
    for name in ("bundles", "previews"):
        (folder / name).mkdir(parents=True)
    (tmp_path / "kept").mkdir()
    (tmp_path / "kept" / "file").touch()
    (folder / "bundles" / ".a.partial").symlink_to(tmp_path / "kept")
    (folder / "bundles" / ".b.partial").touch()
    (folder / "previews" / ".c.partial").mkdir()
    plan = {"repeat": 2, "every_s": 0.0, "directions": ["N"], "rig": "x"}
    (folder / "series.jsonl").write_text(json.dumps({"schema": "skyfix.series/1", "plan": plan}) + "\n")
    with locked_series(folder):
        pass
    assert not list(folder.glob("*/.*.partial"))
    assert (tmp_path / "kept" / "file").exists()


def test_a_token_file_without_end_is_refused() -> None:
    with pytest.raises(ConfigError, match="larger than"):
        read_token(Path("/dev/zero"))


def test_a_spool_with_rows_and_folders_that_make_no_sense_is_used_as_far_as_it_goes(tmp_path: Path) -> None:
    with Spool(tmp_path, 100) as spool:
        write_one(spool.bundles_dir)
        (spool.bundles_dir / ".left.partial").symlink_to(tmp_path)
        (spool.bundles_dir / ".left.file").touch()
        os.makedirs(os.fsencode(spool.bundles_dir) + b"/\xff\xfe")  # noqa: PTH103 - a name that is no text
        (spool.bundles_dir / os.fsdecode(b"\xff\xfe") / "bundle.json").touch()
        assert len(spool.reconcile()) == 1
        spool._db.execute(
            "UPDATE bundles SET trigger = 'x', captured = 'never', answer = '[[[' || ?", ("[" * 9999,)
        )
        (entry,) = spool.entries(5)
        assert (entry.trigger, entry.answer) == ("found", None)
        assert spool.answer_of(entry.bundle) is None
    assert tmp_path.is_dir()


def test_a_spool_whose_notes_make_no_sense_begins_a_new_track_and_goes_on(tmp_path: Path) -> None:
    for leg in (
        "[" * 5000,
        "5",
        '{"step_m": 5, "covariance_m2": 5}',
        '{"step_m": [1], "covariance_m2": [[1]]}',
        "{}",
    ):
        assert stored_leg(leg) is None
    with Spool(tmp_path, 100) as spool:
        write_one(spool.bundles_dir)
        spool.remember("capturing", "[" * 5000)
        assert len(spool.reconcile()) == 1
        spool.remember("tracker", "[" * 5000)
        for tracked in ("0", "x"):
            spool.remember("tracked", tracked)
            with pytest.raises(TrackerError):
                spool.tracker_for(spool.entries(1)[0])


# ---- telemetry


def telemetry(path: Path, compression: CompressionType, size: int) -> Path:
    with path.open("wb") as file:
        writer = Writer(file, compression=compression, chunk_size=1 << 30)
        writer.start(profile="", library="x")
        channel = writer.register_channel("/log", "json", writer.register_schema("x", "jsonschema", b"{}"))
        writer.add_message(channel, log_time=1, data=bytes(size), publish_time=1)
        writer.finish()
    return path


@pytest.mark.parametrize("compression", [CompressionType.LZ4, CompressionType.ZSTD])
def test_a_chunk_of_telemetry_that_unpacks_to_too_much_is_not_unpacked(
    tmp_path: Path, compression: CompressionType, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = telemetry(tmp_path / "x.mcap", compression, 30_000_000)
    assert path.stat().st_size < 500_000
    assert [len(logged.message.data) for logged in TelemetryFile(path)] == [30_000_000]
    monkeypatch.setattr(reader, "MAX_RECORD_BYTES", 10_000_000)
    with pytest.raises(TelemetryReadError, match="no MCAP file"):
        list(TelemetryFile(path))


@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data(), compression=st.sampled_from(list(CompressionType)))
def test_telemetry_of_other_bytes_is_read_as_far_as_it_goes(
    tmp_path: Path, data: st.DataObject, compression: CompressionType
) -> None:
    content = bytearray(telemetry(tmp_path / "x.mcap", compression, 50).read_bytes())
    for _ in range(data.draw(st.integers(1, 5))):
        at = data.draw(st.integers(0, len(content)))
        content[at : at + data.draw(st.integers(0, 9))] = data.draw(st.binary(max_size=9))
    (tmp_path / "x.mcap").write_bytes(content)
    (tmp_path / "mended.mcap").unlink(missing_ok=True)
    try:
        mend(tmp_path / "x.mcap", tmp_path / "mended.mcap")
        list(TelemetryFile(tmp_path / "mended.mcap"))
    except TelemetryReadError as refusal:
        assert str(refusal).isprintable()  # noqa: PT017
        assert not (tmp_path / "mended.mcap").exists()


def test_lz4_that_never_ends_is_cut_off() -> None:
    with pytest.raises(ValueError, match="a chunk of more than"):
        reader._unpacked("lz4", lz4.frame.compress(bytes(70_000_000)))


# ---- pictures


def png_of(width: int, height: int) -> bytes:
    """A picture of one colour that claims any size; its rows are made as they are packed."""

    def chunk(kind: bytes, content: bytes) -> bytes:
        return (
            len(content).to_bytes(4, "big") + kind + content + zlib.crc32(kind + content).to_bytes(4, "big")
        )

    header = width.to_bytes(4, "big") + height.to_bytes(4, "big") + bytes([8, 0, 0, 0, 0])
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", header)
        + chunk(b"IDAT", zlib.compress(bytes(1000)))
        + chunk(b"IEND", b"")
    )


def replace_frame(bundle: Path, content: bytes, camera: dict[str, int]) -> None:
    fields = json.loads((bundle / "bundle.json").read_text())
    (bundle / fields["frames"][0]["file"]).write_bytes(content)
    fields["frames"][0]["sha256"] = hashlib.sha256(content).hexdigest()
    fields["camera"] |= camera
    (bundle / "bundle.json").write_text(json.dumps(fields))


@pytest.mark.parametrize(
    ("width", "height"), [(60_000, 60_000), (2**31 - 1, 2**31 - 1), (20_000, 20_000), (100_000, 1)]
)
@pytest.mark.parametrize("agrees", [False, True])
def test_a_frame_that_claims_more_pixels_than_any_camera_has_is_not_unpacked(
    tmp_path: Path, width: int, height: int, agrees: bool
) -> None:
    bundle = write_one(tmp_path)
    camera = {"width_px": width, "height_px": height, "fx_px": width, "fy_px": height} if agrees else {}
    replace_frame(bundle, png_of(width, height), camera)
    begun = time.monotonic()
    with pytest.raises(BundleError):
        load_bundle(bundle)
    assert time.monotonic() - begun < 1.0


def test_a_jpeg_that_claims_more_than_it_has_is_refused(tmp_path: Path) -> None:
    Image.fromarray(np.zeros((48, 64, 3), np.uint8)).save(tmp_path / "x.jpg")
    content = bytearray((tmp_path / "x.jpg").read_bytes())
    at = content.index(b"\xff\xc0") + 5
    content[at : at + 4] = (60_000).to_bytes(2, "big") * 2
    bundle = write_one(tmp_path)
    replace_frame(bundle, bytes(content), {})
    with pytest.raises(BundleError, match="frames"):
        load_bundle(bundle)


def test_texts_in_a_picture_that_unpack_to_gigabytes_are_not_kept(tmp_path: Path) -> None:
    picture = png_of(64, 48)
    text = b"Comment\0\0" + zlib.compress(bytes(200_000_000), 9)
    at = picture.index(b"IDAT") - 4
    bomb = len(text).to_bytes(4, "big") + b"zTXt" + text + zlib.crc32(b"zTXt" + text).to_bytes(4, "big")
    bundle = write_one(tmp_path)
    replace_frame(bundle, picture[:at] + bomb + picture[at:], {})
    with pytest.raises(BundleError, match="picture that can be read"):
        load_bundle(bundle)


def test_a_picture_for_a_calibration_is_looked_at_before_it_is_unpacked(tmp_path: Path) -> None:
    (tmp_path / "x.png").write_bytes(png_of(30_000, 30_000))
    board = parse_target("chessboard:7x5:30")
    with pytest.raises(CalibrationError, match=r"x\.png"):
        views_from_files(board, str(tmp_path / "x.png"), (640, 480))


# ---- what a bundle's writer leaves to itself

LEAVES = (
    st.none()
    | st.booleans()
    | st.integers(-5, 5000)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(max_size=4)
)
VALUES = LEAVES | st.lists(LEAVES, max_size=3) | st.dictionaries(st.text(max_size=3), LEAVES, max_size=2)


def nodes(tree: object, at: tuple[object, ...] = ()) -> Iterator[tuple[object, ...]]:
    """The path to every node below a root."""
    for key, value in (
        tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    ):
        yield (*at, key)
        yield from nodes(value, (*at, key))


def other_extras(data: st.DataObject, document: dict[str, Any]) -> None:
    """Other values somewhere in ``raw`` and ``calibration``, which no reader checks."""
    extras = {
        "raw": document["raw"],
        "calibration": document["calibration"],
        "frame": document["frames"][0]["raw"],
    }
    for _ in range(data.draw(st.integers(1, 3))):
        *above, key = data.draw(st.sampled_from(sorted(nodes(extras), key=repr)))
        parent: Any = extras
        for step in above:
            parent = parent[step]
        parent[key] = data.draw(VALUES)
    document["raw"], document["calibration"] = extras["raw"], extras["calibration"]
    document["frames"][0]["raw"] = extras["frame"]


@settings(max_examples=25, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_bundles_whose_extra_fields_make_no_sense_are_listed_and_shown(
    tmp_path: Path, data: st.DataObject
) -> None:
    folder = tmp_path / "bundles"
    if not folder.exists():
        (tmp_path / "sound.json").write_bytes((write_one(folder) / "bundle.json").read_bytes())
    (bundle,) = folder.iterdir()
    document = json.loads((tmp_path / "sound.json").read_text())
    other_extras(data, document)
    (bundle / "bundle.json").write_text(json.dumps(document))
    for words in (
        ["show", str(bundle)],
        ["list", str(folder)],
        ["list", "--csv", str(folder)],
        ["list", "--json", str(folder)],
    ):
        told = CliRunner().invoke(rig, ["bundle", *words], standalone_mode=False)
        assert told.exception is None, told.exception
        assert "\x1b" not in told.output
    told = CliRunner().invoke(
        rig, ["bundle", "recalibrate", str(bundle), "--out", str(tmp_path / "anew")], standalone_mode=False
    )
    assert told.exception is None or isinstance(told.exception, SkyfixError | click.UsageError)


@pytest.mark.parametrize("label", ["../../../evil", "/evil", "a/b", "..", ".hidden", "C:x", "N"])
def test_a_recalibrated_bundle_puts_no_picture_elsewhere_whatever_its_label(
    tmp_path: Path, label: str
) -> None:
    image, out = np.zeros((48, 64, 3), np.uint8), tmp_path / "field" / "bundles"
    camera = Camera(width_px=64, height_px=48, fx_px=50.0, fy_px=50.0, cx_px=31.5, cy_px=23.5)
    frame = FrameRecord(label, image, utc_now(), 0.1, 0.1, 5.0, 0.01, -0.3, 0.02, {})
    written = write_bundle(out, Measurement(utc_now(), camera, 2.0, None, 1.0, 0.02, [frame], {}, {}))
    assert load_bundle(written).frames[0].label == label
    assert [path.name for path in tmp_path.iterdir()] == ["field"]
    assert list((tmp_path / "field").iterdir()) == [out]
    assert list(out.iterdir()) == [written]
    wrong = FrameRecord(label, image, utc_now(), 0.1, 0.1, 1e6, 0.01, -0.3, 0.02, {})
    with pytest.raises(BundleWriteError, match="no valid bundle: tilt_deg"):
        write_bundle(out, Measurement(utc_now(), camera, 2.0, None, 1.0, 0.02, [wrong], {}, {}))
    assert list(out.iterdir()) == [written]


# ---- any configuration


@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_a_configuration_of_other_bytes_is_taken_or_refused_in_one_line(
    tmp_path: Path, data: st.DataObject
) -> None:
    content = bytearray(EXAMPLE.read_bytes())
    for _ in range(data.draw(st.integers(1, 5))):
        at = data.draw(st.integers(0, len(content)))
        new = data.draw(
            st.binary(max_size=5)
            | st.sampled_from(
                [b"nan", b"-inf", b"1e400", b'""', b"[]", b"{}", b"[[a]]", b"0x7fffffffffffffffff", b"\n"]
            )
        )
        content[at : at + data.draw(st.integers(0, 5))] = new
    (tmp_path / "x.toml").write_bytes(content)
    try:
        load_config(tmp_path / "x.toml")
    except SkyfixError as refusal:
        assert str(refusal).startswith(str(tmp_path / "x.toml"))  # noqa: PT017
        assert str(refusal).isprintable()  # noqa: PT017


def test_a_whole_program_says_it_in_one_line_on_standard_error(tmp_path: Path) -> None:
    (tmp_path / "x.toml").write_bytes(TOML_ATTACKS["tables"])
    done = subprocess.run(
        [
            sys.executable,
            "-c",
            "from rig.commands.cli import main; main()",
            "check",
            "--config",
            str(tmp_path / "x.toml"),
        ],
        check=False,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == f"rig: {tmp_path / 'x.toml'}: is nested more than 64 deep\n"
