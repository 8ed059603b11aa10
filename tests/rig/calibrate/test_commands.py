"""``rig calibrate`` and ``rig bundle`` as a crew meets them."""

import json
from pathlib import Path

import pytest
from fakes.command import Run
from fakes.whole_rig import FakeRig, running_rig

from rig.config.load import load_config

VEHICLE = Path(__file__).parents[3] / "configs" / "vehicle.toml"


@pytest.mark.parametrize(
    "command", ["camera", "inclinometer", "compass", "altimeter", "boresight", "board", "sites"]
)
def test_help_has_an_example(run: Run, command: str) -> None:
    status, out, _ = run("calibrate", command, "--help")
    assert status == 0
    assert "Example" in out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["calibrate", "altimeter"], "either --altitude, or --at"),
        (["calibrate", "altimeter", "--at", "99,0", "--dem", "x.tif"], "no place on Earth"),
        (["calibrate", "altimeter", "--at", "37.2", "--dem", "x.tif"], "give LAT,LON"),
        (["calibrate", "boresight"], "--at LAT,LON"),
        (["calibrate", "compass", "--yes"], "--headings 1"),
        (["calibrate", "camera", "--board", "dots:3x3:1"], "is no board"),
        (["calibrate", "camera", "--images", "none/*.png"], "names no file"),
        (["calibrate", "inclinometer", "--temperature-log", "none.csv"], "none.csv: cannot be read"),
        (["bundle", "recalibrate", "nowhere"], "names no calibration"),
    ],
)
def test_bad_input_is_one_line(run: Run, arguments: list[str], words: str) -> None:
    status, out, err = run(*arguments, "--config", VEHICLE)
    assert status == 2
    assert out == ""
    assert err.count("\n") == 1
    assert words in err


def test_a_calibration_is_written_named_and_used(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rig.calibrate.altimeter.DURATION_S", 0.1)
    with running_rig(monkeypatch, FakeRig(pressure_hpa=950.0)) as running:
        sensor = running.sensors[2]
        monkeypatch.setattr("rig.calibrate.altimeter.open_altimeter", lambda section: sensor)
        config = tmp_path / "vehicle.toml"
        config.write_text(VEHICLE.read_text())
        status, out, err = run("calibrate", "altimeter", "--config", config, "--altitude", "560", "--yes")
    assert status == 0, err
    file = Path(out.splitlines()[-1])
    assert file.parent == tmp_path / "calibration"
    assert file.with_suffix(".png").stat().st_size > 5000
    assert json.loads(file.read_text())["reference_pressure_hpa"] == pytest.approx(950.0)
    used = load_config(config)
    assert used.altimeter is not None
    assert used.altimeter.reference_altitude_m == 560.0
    assert used.calibrations[0].document.id == file.stem


def test_a_refused_calibration_leaves_nothing(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rig.calibrate.altimeter.DURATION_S", 0.1)
    with running_rig(monkeypatch, FakeRig(pressure_hpa=950.0)) as running:
        sensor = running.sensors[2]
        monkeypatch.setattr("rig.calibrate.altimeter.open_altimeter", lambda section: sensor)
        config = tmp_path / "vehicle.toml"
        config.write_text(VEHICLE.read_text())
        status, _, err = run("calibrate", "altimeter", "--config", config, "--altitude", "4000", "--yes")
    assert status == 2
    assert "is not the air of 4000 m" in err.splitlines()[-1]
    assert not (tmp_path / "calibration").exists()
    assert config.read_text() == VEHICLE.read_text()
