"""Telemetry of a session: an MCAP file that Foxglove understands, readable as far as it goes wherever it was cut."""

import base64
import json
import struct
from collections import defaultdict
from pathlib import Path

import cv2
import jsonschema_rs
import numpy as np
import pytest
from fakes.command import Run, one_line, written
from fakes.whole_rig import RunningRig
from mcap.exceptions import McapError
from mcap.reader import make_reader

from rig import event_bus
from rig.clock import Instant
from rig.devices.readings import PressureReading
from rig.telemetry.reader import TelemetryFile, TelemetryReadError
from rig.telemetry.writer import TelemetryError, recording_telemetry

# Some of Foxglove's schemas, as its documentation has them: what a panel relies on.
FOXGLOVE_FIELDS = {
    "foxglove.CompressedImage": {"timestamp", "frame_id", "data", "format"},
    "foxglove.CameraCalibration": {
        *("timestamp", "frame_id", "width", "height", "distortion_model"),
        *("D", "K", "R", "P"),
    },
    "foxglove.FrameTransform": {"timestamp", "parent_frame_id", "child_frame_id", "translation", "rotation"},
    "foxglove.Log": {"timestamp", "level", "message", "name", "file", "line"},
}


def pressures(count: int) -> list[PressureReading]:
    at = Instant.now()
    return [PressureReading(900.0 + i, None, at.monotonic_s + i, at.utc) for i in range(count)]


@pytest.fixture
def recorded(running: RunningRig, tmp_path: Path) -> Path:
    """A file with 2000 readings."""
    with recording_telemetry(tmp_path / "session.mcap", running.config()) as path:
        for reading in pressures(2000):
            event_bus.publish(reading)
    return path


def test_a_capture_as_foxglove_reads_it(run: Run, running: RunningRig, tmp_path: Path) -> None:
    config, path = written(running, tmp_path), tmp_path / "session.mcap"
    status, out, err = run("capture", "--config", config, "--directions", "N,E", "--telemetry", path)
    assert status == 0
    assert f"telemetry: {path}" in err
    found = defaultdict(list)
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            assert schema is not None
            assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
            value = json.loads(message.data)
            jsonschema_rs.validator_for(json.loads(schema.data)).validate(value)
            assert set(value) == FOXGLOVE_FIELDS.get(schema.name, set(value))
            assert value["timestamp"]["sec"] == message.log_time // 10**9
            found[channel.topic].append(value)
    readings = "/head", "/inclinometer", "/compass/field", "/altimeter", "/camera/image"
    for topic in (*readings, "/log", "/standing", "/altitude", "/view", "/bundle", "/vehicle/head"):
        assert found[topic], topic
    assert found["/bundle"][0]["id"] == Path(out.strip()).name
    assert found["/standing"][0]["heading_deg"] == pytest.approx(30.0, abs=0.2)
    assert [view["azimuth_deg"] for view in found["/view"]] == pytest.approx([0.0, 90.0], abs=0.3) or [
        view["azimuth_deg"] for view in found["/view"]
    ] == pytest.approx([90.0, 0.0], abs=0.3)
    jpeg = np.frombuffer(base64.b64decode(found["/camera/image"][0]["data"]), np.uint8)
    height, width = cv2.imdecode(jpeg, cv2.IMREAD_COLOR).shape[:2]
    lens = found["/camera/calibration"][0]
    assert (width, height) == (lens["width"], lens["height"]) == (320, 240)
    assert "looking N" in [line["message"] for line in found["/log"]]
    assert run("telemetry", "info", path)[0] == 0


def test_why_a_capture_failed_is_in_its_telemetry(run: Run, running: RunningRig, tmp_path: Path) -> None:
    running.rig.pan.put(70, 1, 0x20)
    path = tmp_path / "session.mcap"
    one_line_with_name = run("capture", "--config", written(running, tmp_path), "--telemetry", path)
    assert one_line_with_name[0] == 2
    errors = [m.value() for m in TelemetryFile(path) if m.topic == "/log" and m.value()["level"] == 4]
    assert "overload" in errors[-1]["message"]


def test_every_session_leaves_a_file_where_the_configuration_says_so(
    run: Run, running: RunningRig, tmp_path: Path
) -> None:
    config = written(running, tmp_path, rig={"telemetry_dir": "telemetry"})
    assert run("capture", "--config", config, "--directions", "E")[0] == 0
    (path,) = (tmp_path / "telemetry").glob("*.mcap")
    status, out, _ = run("telemetry", "info", path, "--json")
    assert status == 0
    found = json.loads(out)
    assert found["whole"]
    assert {"/head", "/camera/image"} <= {topic["topic"] for topic in found["topics"]}


@pytest.mark.parametrize("kept", [0.3, 0.6, 0.999])
def test_a_file_that_was_cut_off_is_read_as_far_as_it_goes(
    run: Run, recorded: Path, tmp_path: Path, kept: float
) -> None:
    everything = [m.message.data for m in TelemetryFile(recorded) if m.topic == "/altimeter"]
    assert len(everything) == 2000
    content = recorded.read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(content[: int(len(content) * kept)])
    with pytest.raises((McapError, ValueError, struct.error)), cut.open("rb") as file:
        make_reader(file).get_summary()
    read = TelemetryFile(cut)
    found = [m.message.data for m in read if m.topic == "/altimeter"]
    assert found == everything[: len(found)]
    assert len(found) > 2000 * kept * 0.5 - 400
    assert read.problem is not None
    status, _, err = run("telemetry", "info", cut)
    assert status == 2
    assert "rig telemetry mend makes it whole" in err

    mended = tmp_path / "mended.mcap"
    assert run("telemetry", "mend", cut, "--out", mended)[0] == 0
    with mended.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == sum(1 for _ in TelemetryFile(cut))


def test_a_name_that_is_taken_gets_a_number(running: RunningRig, tmp_path: Path) -> None:
    names = []
    for _ in range(3):
        with recording_telemetry(tmp_path / "s.mcap", running.config()) as path:
            names.append(path.name)
    assert names == ["s.mcap", "s-2.mcap", "s-3.mcap"]


def test_a_disk_that_refuses_ends_the_telemetry_and_not_the_session(
    running: RunningRig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(recorder: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("rig.telemetry.writer._Recorder._sync", full)
    monkeypatch.setattr("rig.telemetry.writer.SYNC_EVERY_S", 0.0)
    with recording_telemetry(tmp_path / "s.mcap", running.config()):
        for reading in pressures(5000):
            event_bus.publish(reading)
    assert capsys.readouterr().err == (
        f"rig: {tmp_path / 's.mcap'}: cannot be written: No space left on device; "
        "the session goes on without telemetry\n"
    )


def test_no_listener_is_left_afterwards(recorded: Path) -> None:
    size = recorded.stat().st_size
    event_bus.publish(pressures(1)[0])
    assert recorded.stat().st_size == size


def test_what_cannot_be_read_or_written(
    run: Run, running: RunningRig, tmp_path: Path, recorded: Path
) -> None:
    junk = tmp_path / "junk.mcap"
    junk.write_bytes(b"no telemetry at all")
    with pytest.raises(TelemetryReadError, match="is no MCAP file"):
        list(TelemetryFile(junk))
    assert "is no MCAP file" in one_line(run("telemetry", "mend", junk, "--out", tmp_path / "x.mcap"))
    assert not (tmp_path / "x.mcap").exists()
    assert "cannot be read" in one_line(run("telemetry", "info", tmp_path / "none.mcap"))
    with (
        pytest.raises(TelemetryError, match="is no folder"),
        recording_telemetry(junk / "x.mcap", running.config()),
    ):
        pass
    assert "File exists" in one_line(run("telemetry", "mend", recorded, "--out", junk))
