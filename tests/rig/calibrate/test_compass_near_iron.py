"""``rig calibrate compass`` on a simulated rig: refused in a disturbed field; what the servos' torque adds is measured."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sim.commands.options import EMBEDDED_DEM
from sim.launch.launcher import simulated_rig
from sim.launch.operator import Done, operate, turn_asked_deg
from sim.world.scenario import Scenario
from sim.world.truth import MOTOR_FIELD_DIRECTION, World

pytestmark = [pytest.mark.long, pytest.mark.timeout(600)]
HELD_UT = 2.5


def calibrate(folder: Path, headings: int, **compass: Any) -> tuple[Done, World, list[str]]:
    """What a crew sees that turns the vehicle when asked; also the world, and all that was said."""
    scenario = Scenario.model_validate({"compass": {"holding_current_field_ut": HELD_UT, **compass}})
    world = World.create([EMBEDDED_DEM], scenario, 3)
    heard: list[str] = []

    def act(line: str) -> None:
        world.mechanics.turn_vehicle(turn_asked_deg(line) or 0.0)

    with simulated_rig(world) as rig:
        command = ["rig", "calibrate", "compass", "--headings", str(headings), "--angles", "4"]
        done = operate([*command, "--out", str(folder), "--json"], rig.environment, act, heard.append)
    return done, world, heard


def test_the_torques_field_and_the_headings_sigma_are_in_the_result(tmp_path: Path) -> None:
    done, world, heard = calibrate(tmp_path, 4)
    assert done.status == 0, done.last_line
    found = json.loads(done.out)
    assert found["fit"]["torque_field_ut"] == pytest.approx(MOTOR_FIELD_DIRECTION * HELD_UT, abs=0.15)
    assert any("holding current turns the compass by" in line for line in heard)
    assert found["fit"]["horizontal_ut"] == pytest.approx(
        float(np.hypot(*world.field.enu_ut[:2])), abs=3.0 * found["fit"]["horizontal_sigma_ut"]
    )
    assert 0.2 < found["azimuth_bias_sigma_deg"] < 1.0


def test_near_iron_it_is_refused_and_leaves_nothing(tmp_path: Path) -> None:
    world = World.create([EMBEDDED_DEM], Scenario(), 3)
    more = np.array([*world.field.enu_ut[:2], 0.0]) * 0.3
    done, _, _ = calibrate(tmp_path, 4, disturbance_enu_ut=more.tolist())
    assert done.status == 2
    assert "more than the World Magnetic Model's" in done.last_line
    assert "calibrate again on open ground" in done.last_line
    assert list(tmp_path.iterdir()) == []
