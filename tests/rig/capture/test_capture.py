"""A whole capture on a fake rig: content of the bundle, and what is left after failures."""

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fakes.servos import HARDWARE_ERROR, POSITION
from fakes.whole_rig import HEIGHT_PX, FakeRig, RunningRig, running_rig

from localizer.bundle import load_bundle
from localizer.skyline.find import ColumnState, Skyline, find_skyline
from rig import timebase
from rig.attitude.kinematics import Attitude, Head, JointAngles, camera_pointing, wrapped_deg
from rig.capture.sequence import CaptureError, capture
from rig.capture.view import in_sweep_order
from rig.config.directions import parse_directions
from rig.errors import DeviceError, GoalError, LostPortError

NOWHERE = Attitude(0.0, 0.0, 0.0)


class Said:
    """The messages to the operator."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def doing(self, what: str) -> None:
        pass

    def done(self, what: str) -> None:
        self.lines.append(what)


@pytest.fixture
def running(monkeypatch: pytest.MonkeyPatch) -> Iterator[RunningRig]:
    with running_rig(monkeypatch, FakeRig()) as rig:
        yield rig


def take(
    running: RunningRig, out: Path, directions: str = "N,E", **changes: dict[str, object] | None
) -> Path:
    return capture(running.config(**changes), parse_directions(directions.split(",")), out, Said())


def assert_safe_and_clean(running: RunningRig, out: Path) -> None:
    assert not running.rig.torque_is_on
    assert not out.exists() or list(out.iterdir()) == []
    assert all(sensor.closed for sensor in running.sensors)


def test_a_bundle_of_four_directions(running: RunningRig, tmp_path: Path) -> None:
    running.rig.roll_zero_deg = 0.02
    said = Said()
    written = capture(running.config(), parse_directions(["W", "N", "E", "S"]), tmp_path, said)
    bundle = load_bundle(written)
    assert [frame.label for frame in bundle.frames] == ["W", "N", "E", "S"], "as asked, however the head went"
    for frame, azimuth_deg in zip(bundle.frames, (270.0, 0.0, 90.0, 180.0), strict=True):
        assert wrapped_deg(frame.azimuth_deg - azimuth_deg) == pytest.approx(0.0, abs=0.1)
        raw = json.loads((written / "bundle.json").read_text())
        pan_tick, tilt_tick = next(f["raw"]["ticks"] for f in raw["frames"] if f["label"] == frame.label)
        joints = JointAngles((pan_tick - 2048) * 360 / 4096, (tilt_tick - 2048) * 360 / 4096)
        truth = camera_pointing(running.rig.base, joints, NOWHERE)
        assert wrapped_deg(frame.azimuth_deg - truth.azimuth_deg) == pytest.approx(0.0, abs=0.03)
        assert frame.tilt_deg == pytest.approx(truth.tilt_deg, abs=0.005)
        assert frame.roll_deg == pytest.approx(truth.roll_deg, abs=0.012)
        assert frame.azimuth_sigma_deg == 0.1
        assert frame.tilt_sigma_deg == pytest.approx(0.01, abs=0.001)
    assert bundle.azimuth_bias_sigma_deg == pytest.approx(1.0, abs=0.01)
    assert 0.0 < bundle.tilt_bias_sigma_deg <= 0.02
    assert bundle.altitude is not None
    assert bundle.altitude.value_m == pytest.approx(540.3, abs=0.5)
    assert (bundle.mast_height_m, bundle.camera.fx_px) == (2.0, 124.0)
    assert said.lines[0].startswith("vehicle: heading 30.")
    assert len(said.lines) == 5
    assert not running.rig.torque_is_on
    assert [path.name for path in tmp_path.iterdir()] == [written.name]


def test_what_it_was_derived_from_is_kept(running: RunningRig, tmp_path: Path) -> None:
    content = json.loads((take(running, tmp_path, "45") / "bundle.json").read_text())
    assert content["frames"][0]["file"] == "frames/A045.png"
    raw = content["frames"][0]["raw"]
    assert len(raw["frame_times"]) == 2
    assert raw["skyline"]["share"] > 0.9
    assert np.linalg.norm(raw["inclinometer"]["mean_g"]) == pytest.approx(1.0, abs=1e-6)
    stops = content["raw"]["stops"]
    assert [round((stop["ticks"][0] - 2048) * 360 / 4096) for stop in stops] in (
        [-120, 0, 120],
        [120, 0, -120],
    )
    assert np.linalg.norm(stops[0]["field_ut"]) == pytest.approx(math.hypot(22.0, 43.0), abs=1e-6)
    assert content["raw"]["altimeter"]["pressure_hpa"] == 950.0
    calibration = content["calibration"]
    assert calibration["heading"]["declination"] == {"declination_deg": 13.0, "source": "configuration"}
    assert calibration["configuration"]["pan_tilt"]["pan"]["zero_tick"] == 2048
    assert calibration["heading"]["heading_deg"] == pytest.approx(30.0, abs=0.2)
    assert calibration["compass"]["heading_deg"] == pytest.approx(17.0, abs=0.2)
    assert "bundle_dir" not in calibration["configuration"]["rig"]
    assert "source" not in calibration["configuration"]["camera"]


def test_the_heading_is_of_the_stops_and_of_the_pictures_together(
    running: RunningRig, tmp_path: Path
) -> None:
    """The compass turns after the three stops: as if the pan had been read wrongly at the four pictures."""
    running.rig.base = Attitude(20.0, 0.0, 0.0)
    running.rig.horizon_deg = lambda azimuth_deg: 3.0 + 2.0 * np.sin(np.radians(azimuth_deg * 7.0))
    running.rig.compass_off_deg = lambda number: 0.7 if number > 3 else 0.0
    content = json.loads((take(running, tmp_path, "N,E,S,W") / "bundle.json").read_text())
    heading_deg = content["calibration"]["heading"]["heading_deg"]
    assert heading_deg == pytest.approx(20.0 + 0.7 * 4 / 7, abs=0.05)
    for frame in content["frames"]:
        assert np.linalg.norm(frame["raw"]["field_ut"]) == pytest.approx(math.hypot(22.0, 43.0), abs=1e-6)
        pan_deg = (frame["raw"]["ticks"][0] - 2048) * 360 / 4096
        assert wrapped_deg(frame["azimuth_deg"] - pan_deg - heading_deg) == pytest.approx(0.0, abs=0.01)


def test_a_compass_that_fails_while_a_picture_is_taken_is_noted_and_the_capture_goes_on(
    running: RunningRig, tmp_path: Path
) -> None:
    def fail_at_the_second(number: int) -> float:
        if number == 5:
            raise DeviceError("compass", "has gone mad", "calm it")
        return 0.0

    running.rig.compass_off_deg = fail_at_the_second
    content = json.loads((take(running, tmp_path, "N,E,S") / "bundle.json").read_text())
    assert sorted("field_ut" in frame["raw"] for frame in content["frames"]) == [False, True, True]
    (note,) = content["raw"]["faults"]
    assert (note["problem"], note["action"]) == ("has gone mad", "heading from the stops before it")
    assert content["calibration"]["heading"]["heading_deg"] == pytest.approx(30.0, abs=0.1)


def test_pictures_do_not_wait_for_a_compass_that_is_gone(running: RunningRig, tmp_path: Path) -> None:
    def gone(number: int) -> float:
        if number > 3:
            raise LostPortError("compass", "was pulled out", "plug it in")
        return 0.0

    running.rig.compass_off_deg = gone
    content = json.loads((take(running, tmp_path, "N,E,S,W") / "bundle.json").read_text())
    assert running.rig.compass_readings == 3 + 4, "asked once at each picture, not until it comes back"
    assert not any("field_ut" in frame["raw"] for frame in content["frames"])
    assert {(note["problem"], note["count"]) for note in content["raw"]["faults"]} == {("was pulled out", 4)}
    assert content["calibration"]["heading"]["heading_deg"] == pytest.approx(30.0, abs=0.1)


def test_a_high_skyline_is_followed_upwards(running: RunningRig, tmp_path: Path) -> None:
    running.rig.horizon_deg = lambda azimuth_deg: 24.0 + 2.0 * np.sin(np.radians(azimuth_deg * 5))
    bundle = load_bundle(take(running, tmp_path, "E"))
    assert 12.0 < bundle.frames[0].tilt_deg < 32.0
    image = np.asarray(running.rig.picture())
    rows = find_skyline(image).row_px
    assert np.nanmin(rows) > 0.15 * HEIGHT_PX
    assert np.nanmax(rows) < 0.85 * HEIGHT_PX


def test_a_direction_beyond_the_pan_is_taken_at_the_nearest_angle(
    running: RunningRig, tmp_path: Path
) -> None:
    running.rig.base = Attitude(180.0, 0.0, 0.0)
    bundle = load_bundle(take(running, tmp_path, "N"))
    assert 2.0 <= abs(wrapped_deg(bundle.frames[0].azimuth_deg)) < 3.0


def test_a_direction_far_beyond_the_pan_is_refused(running: RunningRig, tmp_path: Path) -> None:
    pan_tilt: Any = running.settings()["pan_tilt"]
    pan_tilt["pan"] |= {"min_deg": -120.0, "max_deg": 120.0}
    with pytest.raises(
        GoalError, match=r"azimuth 180\.0, tilt 0\.0 deg: needs pan 1\d\d\.\d deg, beyond the limits"
    ):
        take(running, tmp_path / "out", "N,S", pan_tilt=pan_tilt)
    assert_safe_and_clean(running, tmp_path / "out")


def test_without_compass_and_altimeter(running: RunningRig, tmp_path: Path) -> None:
    bundle = load_bundle(take(running, tmp_path, "N", compass=None, altimeter=None))
    assert bundle.altitude is None
    assert bundle.azimuth_bias_sigma_deg == 180.0
    assert running.rig.joints().pan_deg == pytest.approx(0.0, abs=0.2), "azimuths count from the bow then"


def test_a_swinging_mast_is_waited_for(running: RunningRig, tmp_path: Path) -> None:
    running.rig.swing_deg = 3.0
    running.rig.swing_until_s = timebase.monotonic_s() + 2.5
    bundle = load_bundle(take(running, tmp_path, "E"))
    truth = camera_pointing(running.rig.base, running.rig.joints(), NOWHERE)
    assert bundle.frames[0].roll_deg == pytest.approx(truth.roll_deg, abs=0.02)
    assert running.rig.readings_taken > 4


def test_a_mast_that_never_rests(running: RunningRig, tmp_path: Path) -> None:
    running.rig.swing_deg = 3.0
    running.rig.swing_until_s = math.inf
    with pytest.raises(
        DeviceError, match=r"inclinometer: the head does not come to rest: it drifts by \d\.\d\d deg"
    ):
        take(running, tmp_path / "out", "E", pan_tilt={"settle_timeout_s": 3.0})
    assert_safe_and_clean(running, tmp_path / "out")


def test_interrupted_while_measuring(running: RunningRig, tmp_path: Path) -> None:
    def interrupt() -> None:
        if running.rig.readings_taken == 4:
            assert running.rig.torque_is_on
            raise KeyboardInterrupt

    running.rig.before_reading = interrupt
    with pytest.raises(KeyboardInterrupt):
        take(running, tmp_path / "out")
    assert_safe_and_clean(running, tmp_path / "out")


def test_the_camera_stalls(running: RunningRig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rig.capture.pictures.take.TIME_LIMIT_S", 1.5)

    def stall() -> None:
        if running.rig.readings_taken == 3:
            running.camera.stall.set()

    running.rig.before_reading = stall
    with pytest.raises(DeviceError, match=r"camera http://.*(stopped sending|has sent no frame)"):
        take(running, tmp_path / "out", camera={"read_timeout_s": 1.0})
    assert_safe_and_clean(running, tmp_path / "out")


def test_a_servo_reports_an_error(running: RunningRig, tmp_path: Path) -> None:
    def overload() -> None:
        if running.rig.readings_taken == 3:
            running.rig.tilt.registers[HARDWARE_ERROR] = 0x20

    running.rig.before_reading = overload
    with pytest.raises(DeviceError, match=r"tilt servo \(id 2\).*overload"):
        take(running, tmp_path / "out")
    assert_safe_and_clean(running, tmp_path / "out")


def test_somebody_pushes_the_head(running: RunningRig, tmp_path: Path) -> None:
    def push() -> None:
        if running.rig.readings_taken == 3:
            running.rig.pan.stuck = True
            running.rig.pan.put(POSITION, 4, running.rig.pan.get(POSITION, 4) + 9)

    running.rig.before_reading = push
    with pytest.raises(
        DeviceError, match=r"moved by \d+ ticks while a frame was taken; look for what pushes it"
    ):
        take(running, tmp_path / "out", "E")
    assert_safe_and_clean(running, tmp_path / "out")


def skyline_by_brightness(image: np.ndarray) -> Skyline:
    """Stands in for the real one, which is not the subject: sky is bright."""
    sky = image[..., 0] > 140
    rows = np.where(sky.any(axis=0), sky.sum(axis=0) - 0.5, np.nan)
    states = np.where(sky.any(axis=0), ColumnState.OK, ColumnState.NO_SKY).astype(np.uint8)
    return Skyline(rows, np.full(len(rows), 0.3), (states == ColumnState.OK).astype(float), states)


def test_no_sky_anywhere(running: RunningRig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rig.capture.sequence.find_skyline", skyline_by_brightness)
    running.rig.horizon_deg = lambda azimuth_deg: np.full(azimuth_deg.shape, 90.0)
    with pytest.raises(
        CaptureError, match="no skyline in any of 1 frames: look at the lens, the light and the"
    ):
        take(running, tmp_path / "out", "E")
    assert_safe_and_clean(running, tmp_path / "out")


def test_one_direction_without_sky_is_recorded_as_such(
    running: RunningRig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rig.capture.sequence.find_skyline", skyline_by_brightness)
    running.rig.horizon_deg = lambda azimuth_deg: np.where(np.abs(azimuth_deg - 90.0) < 120.0, 90.0, 3.0)
    content = json.loads((take(running, tmp_path, "W,E") / "bundle.json").read_text())
    west, east = (frame["raw"]["skyline"] for frame in content["frames"])
    assert west == {"share": 1.0, "columns": {"ok": 160, "no_sky": 0, "no_terrain": 0, "doubtful": 0}}
    assert east == {"share": 0.0, "columns": {"ok": 0, "no_sky": 160, "no_terrain": 0, "doubtful": 0}}


def test_the_head_sweeps_once() -> None:
    head = Head((-178.0, 178.0), (-40.0, 60.0), NOWHERE)
    directions = parse_directions(["N", "E", "S", "W"])
    base = Attitude(20.0, 0.0, 0.0)
    assert [d.label for d in in_sweep_order(directions, base, head, 150.0)] == ["S", "E", "N", "W"]
    assert [d.label for d in in_sweep_order(directions, base, head, -150.0)] == ["W", "N", "E", "S"]
