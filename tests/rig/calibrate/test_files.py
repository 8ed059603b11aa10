"""Calibration files: what they replace, how they are named, what bundles keep of them, and old bundles made better."""

import json
import tomllib
from datetime import UTC, datetime
from pathlib import Path

import pytest
from click.testing import CliRunner
from fakes.whole_rig import FakeRig, running_rig

from localizer.bundle import load_bundle
from rig.attitude.kinematics import wrapped_deg
from rig.calibrate.config_edit import name_in_config, with_calibration
from rig.calibrate.recalibrate import recalibrate
from rig.capture.sequence import capture
from rig.commands.bundle import bundle
from rig.config.calibration_files import (
    AltimeterCalibration,
    BoresightCalibration,
    CalibrationError,
    CameraCalibration,
    read_calibration,
    write_calibration,
)
from rig.config.directions import parse_directions
from rig.config.load import load_config
from rig.config.model import with_calibrations

VEHICLE = Path(__file__).parents[3] / "configs" / "vehicle.toml"
NOW = datetime(2026, 11, 24, 6, tzinfo=UTC)
HEAD = {"created": NOW, "rig": "vehicle-1", "device": "made up"}
CAMERA = CameraCalibration(
    **HEAD, id="camera-1", width_px=640, height_px=480, fx_px=500.0, fy_px=501.0, cx_px=318.0, cy_px=241.0,
    distortion=(-0.1, 0.02, 0.0, 0.0, 0.0),
)  # fmt: skip
BORESIGHT = BoresightCalibration(
    **HEAD, id="boresight-1", azimuth_deg=1.5, tilt_deg=-0.8, roll_deg=0.4, heading_offset_deg=0.25,
    covariance_deg2=((0.04**2, 0.0, 0.0), (0.0, 0.03**2, 0.0), (0.0, 0.0, 0.02**2)),
)  # fmt: skip
ALTIMETER = AltimeterCalibration(
    **HEAD, id="altimeter-1", altimeter="bmp390", reference_pressure_hpa=940.0, reference_altitude_m=650.0,
    reference_temperature_c=12.0, reference_time=NOW, sigma_m=1.5, drift_m_h=0.0,
)  # fmt: skip


class Silent:
    def doing(self, what: str) -> None:
        pass

    def done(self, what: str) -> None:
        pass


def vehicle(folder: Path) -> Path:
    path = folder / "vehicle.toml"
    path.write_text(VEHICLE.read_text())
    return path


def test_a_named_calibration_replaces_keys(tmp_path: Path) -> None:
    config = vehicle(tmp_path)
    for document in (CAMERA, BORESIGHT, ALTIMETER):
        name_in_config(config, document.kind, write_calibration(document, tmp_path / "calibration"))
    loaded = load_config(config)
    assert (loaded.camera.fx_px, loaded.camera.distortion[0]) == (500.0, -0.1)
    assert loaded.camera.boresight_tilt_deg == -0.8
    assert loaded.camera.boresight_azimuth_sigma_deg == pytest.approx(0.04)
    assert loaded.compass is not None
    assert loaded.compass.heading_offset_deg == 0.25
    assert loaded.altimeter is not None
    assert loaded.altimeter.reference_time == NOW
    assert [c.document.id for c in loaded.calibrations] == ["camera-1", "altimeter-1", "boresight-1"]


def test_naming_changes_nothing_else(tmp_path: Path) -> None:
    config = vehicle(tmp_path)
    before = config.read_text()
    name_in_config(config, "camera", tmp_path / "calibration" / "a.json")
    name_in_config(config, "camera", tmp_path / "calibration" / "b.json")
    after = config.read_text()
    assert tomllib.loads(after)["calibration"] == {"camera": "calibration/b.json"}
    assert [line for line in after.splitlines() if not line.startswith("camera = ")] == before.splitlines()


@pytest.mark.parametrize(
    "text", ["[rig]\nname = 'a'", "[calibration]\n[camera]\nfx_px = 1.0\n", "[calibration]"]
)
def test_a_section_is_found_or_made(text: str) -> None:
    tables = tomllib.loads(with_calibration(text, "compass", "c.json"))
    assert tables["calibration"] == {"compass": "c.json"}
    assert set(tomllib.loads(text)) <= set(tables)


def test_a_calibration_of_another_device_is_refused(tmp_path: Path) -> None:
    config = vehicle(tmp_path)
    other = CAMERA.model_copy(update={"width_px": 1280, "height_px": 720})
    name_in_config(config, "camera", write_calibration(other, tmp_path))
    with pytest.raises(
        CalibrationError,
        match=r"camera-1\.json: is for width_px 1280, height_px 720, \[camera\] says width_px 640, height_px 480",
    ):
        load_config(config)


@pytest.mark.parametrize(
    ("content", "problem"),
    [("{", "Invalid JSON"), ('{"kind": "camera"}', "camera|id"), ('{"kind": "lens"}', "tag")],
)
def test_a_spoilt_file_is_refused(tmp_path: Path, content: str, problem: str) -> None:
    path = tmp_path / "spoilt.json"
    path.write_text(content)
    with pytest.raises(CalibrationError, match=rf"spoilt\.json: .*({problem})"):
        read_calibration(path)


def test_a_missing_or_misplaced_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match=r"nowhere\.json: cannot be read"):
        read_calibration(tmp_path / "nowhere.json")
    with pytest.raises(CalibrationError, match="calibrates the camera, not the compass"):
        read_calibration(write_calibration(CAMERA, tmp_path), "compass")


def test_an_old_bundle_is_recalibrated_and_stays_unchanged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = FakeRig()
    rig.compass_off_deg = lambda number: 0.6 if number > 3 else 0.0
    with running_rig(monkeypatch, rig) as running:
        old_dir = capture(running.config(), parse_directions(["N", "E"]), tmp_path / "old", Silent())
    before = (old_dir / "bundle.json").read_bytes()
    old = load_bundle(old_dir)
    files = [read_calibration(write_calibration(document, tmp_path)) for document in (BORESIGHT, ALTIMETER)]

    same = load_bundle(recalibrate(old_dir, [], tmp_path / "same"))
    for frame, again in zip(old.frames, same.frames, strict=True):
        assert wrapped_deg(again.azimuth_deg - frame.azimuth_deg) == pytest.approx(0.0, abs=0.0001)
        assert again.tilt_deg == pytest.approx(frame.tilt_deg, abs=0.0001)
        assert again.sha256 == frame.sha256
    assert same.azimuth_bias_sigma_deg == pytest.approx(old.azimuth_bias_sigma_deg, abs=1e-6)

    new_dir = recalibrate(old_dir, files, tmp_path / "new")
    new = load_bundle(new_dir)
    for frame, better in zip(old.frames, new.frames, strict=True):
        assert wrapped_deg(better.azimuth_deg - frame.azimuth_deg) == pytest.approx(1.75, abs=0.1)
        assert better.tilt_deg - frame.tilt_deg == pytest.approx(-0.8, abs=0.1)
        assert better.roll_sigma_deg > frame.roll_sigma_deg
    assert new.tilt_bias_sigma_deg > 0.03 > old.tilt_bias_sigma_deg
    assert new.altitude is not None
    assert new.altitude.sigma_m == pytest.approx(1.5, abs=0.01)
    content = json.loads((new_dir / "bundle.json").read_text())
    assert content["raw"]["recalibrated_from"] == old.id
    used = content["calibration"]["files"]
    assert {kind: used[kind]["sha256"] for kind in used} == {f.document.kind: f.sha256 for f in files}
    assert used["boresight"]["id"] == "boresight-1"
    assert (old_dir / "bundle.json").read_bytes() == before

    twice = load_bundle(recalibrate(new_dir, [], tmp_path / "twice"))
    assert twice.frames[0].azimuth_deg == pytest.approx(new.frames[0].azimuth_deg, abs=1e-6)

    named = [word for each in files for word in ("--calibration", str(tmp_path / Path(each.file).name))]
    said = CliRunner().invoke(bundle, ["recalibrate", str(old_dir), *named], standalone_mode=False)
    assert said.stderr == "with boresight-1, altimeter-1\n"
    assert Path(said.stdout.strip()).parent == old_dir.parent


def test_a_bundle_from_before_the_compass_was_read_at_pictures_has_its_heading_from_the_stops(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = FakeRig()
    rig.compass_off_deg = lambda number: 0.6 if number > 3 else 0.0
    with running_rig(monkeypatch, rig) as running:
        directory = capture(running.config(), parse_directions(["N", "E"]), tmp_path / "old", Silent())
    content = json.loads((directory / "bundle.json").read_text())
    assert content["calibration"]["heading"]["heading_deg"] > 30.1
    for frame in content["frames"]:
        for key in [key for key in frame["raw"] if key.startswith(("field_", "compass_"))]:
            del frame["raw"][key]
    (directory / "bundle.json").write_text(json.dumps(content))
    again = json.loads((recalibrate(directory, [], tmp_path / "new") / "bundle.json").read_text())
    assert again["calibration"]["heading"]["heading_deg"] == pytest.approx(30.0, abs=0.03)


def test_a_bundle_without_raw_readings_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with running_rig(monkeypatch, FakeRig()) as running:
        directory = capture(running.config(), parse_directions(["N"]), tmp_path / "old", Silent())
    content = json.loads((directory / "bundle.json").read_text())
    del content["raw"]["stops"]
    (directory / "bundle.json").write_text(json.dumps(content))
    with pytest.raises(CalibrationError, match="raw readings are not all there"):
        recalibrate(directory, [], tmp_path / "new")
    assert not (tmp_path / "new").exists() or not list((tmp_path / "new").iterdir())


def test_a_calibration_lists_those_it_is_based_on(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    config = load_config(vehicle(tmp_path))
    later = BORESIGHT.model_copy(update={"based_on": {"camera": "camera-0"}})
    files = [read_calibration(write_calibration(document, tmp_path)) for document in (CAMERA, later)]
    with_calibrations(config, files)
    assert "made with camera-0, not with camera-1" in caplog.text
