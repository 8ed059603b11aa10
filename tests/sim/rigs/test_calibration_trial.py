"""An uncalibrated rig is calibrated by the real commands, and its bundles are accurate afterwards."""

from pathlib import Path

import numpy as np
import pytest

from sim.commands.options import EMBEDDED_DEM
from sim.launch.operator import turn_asked_deg
from sim.render.calibration_target import FRAMES_A_POSE, CalibrationTargetPictures
from sim.rigs.calibration_trial import LIMITS, RigResult, calibrate_rig, write_csv
from sim.world.mechanics import Attitude, Mechanics, body_attitude, body_in_world, turned_about_axes
from sim.world.scenario import CameraOptics, load_scenario

UNCALIBRATED = Path(__file__).parents[3] / "configs" / "scenarios" / "uncalibrated.toml"


@pytest.mark.parametrize("angles", [(10.0, 4.0, -3.0), (200.0, -6.0, 5.0), (359.0, 0.0, 0.0)])
def test_an_attitude_comes_back_from_its_rotation(angles: tuple[float, float, float]) -> None:
    found = body_attitude(body_in_world(*angles))
    assert (found.heading_deg, found.pitch_deg, found.roll_deg) == pytest.approx(angles)


def test_a_vehicle_turns_on_its_slope() -> None:
    mechanics = Mechanics(Attitude(30.0, 5.0, 0.0), Attitude(0.0, 0.0, 0.0))
    upright = mechanics.pan_stage_in_world(0.0)[:, 2]
    mechanics.turn_vehicle(90.0)
    assert mechanics.pan_stage_in_world(0.0)[:, 2] == pytest.approx(upright)
    assert mechanics.base.heading_deg == pytest.approx(120.0, abs=0.01)
    assert (mechanics.base.pitch_deg, mechanics.base.roll_deg) == pytest.approx((0.0, 5.0), abs=0.01), (
        "uphill is on the left now"
    )


def test_turns_about_axes_are_rotations() -> None:
    turn = turned_about_axes((2.0, -3.0, 1.0))
    assert turn @ turn.T == pytest.approx(np.eye(3))
    assert turned_about_axes((0.0, 0.0, 90.0))[:, 0] == pytest.approx([0.0, 1.0, 0.0])


def test_the_target_is_still_for_a_while_and_then_elsewhere() -> None:
    optics = CameraOptics(noise=0.0)
    board = CalibrationTargetPictures(optics, np.random.default_rng(1))
    pictures = [board.frame().astype(int) for _ in range(FRAMES_A_POSE + 1)]
    assert np.ptp([np.abs(p - pictures[0]).max() for p in pictures[:FRAMES_A_POSE]]) == 0
    assert np.abs(pictures[-1] - pictures[0]).mean() > 5.0


def test_the_operator_recognises_a_turn() -> None:
    asked = "Heading 2 of 8: turn the vehicle by about 45 deg to the right and stop. Then press Enter."
    assert turn_asked_deg(asked) == 45.0
    assert turn_asked_deg("Stand still. Then press Enter.") is None


def test_results_are_written(tmp_path: Path) -> None:
    write_csv([RigResult(3, "camera: no board")], tmp_path / "rigs.csv")
    assert "3,camera: no board" in (tmp_path / "rigs.csv").read_text()
    assert not RigResult(3, "refused").within


@pytest.mark.long
@pytest.mark.timeout(900)
def test_a_rig_with_degrees_of_error_is_right_after_calibration(tmp_path: Path) -> None:
    result = calibrate_rig([EMBEDDED_DEM], load_scenario(UNCALIBRATED), 5, tmp_path)
    assert not result.refused
    for name, limit in LIMITS.items():
        assert abs(getattr(result, name)) <= 1.5 * limit, name
