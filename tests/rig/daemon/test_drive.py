"""The daemon on a vehicle that drives: ten stops in simulated terrain, with odometry; every place is held against the truth."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fakes.daemon import LONG_PATIENCE_S, Daemon, add_keys, running_daemon
from fakes.driving import drive_to, next_stop

from localizer.fix import Fix
from sim.commands.demo import judge
from sim.commands.options import EMBEDDED_DEM
from sim.launch.launcher import SimulatedRig, simulated_rig
from sim.world.scenario import Scenario
from sim.world.truth import World

STOPS = 10
TURN_DEG = 25.0
DRIVE_S = 6.0
CELL_M = 30.0
STILL_S = 3.0


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[SimulatedRig]:
    world = World.create([EMBEDDED_DEM], Scenario(), 3)
    with simulated_rig(world, bundle_dir=tmp_path / "bundles", dem_paths=[EMBEDDED_DEM]) as rig:
        add_keys(rig.config_path, "run.rest", still_s=STILL_S)
        add_keys(
            rig.config_path, "run.search", time_s=LONG_PATIENCE_S
        )  # how long it takes is not the question here
        yield rig


@pytest.fixture
def daemon(rig: SimulatedRig, tmp_path: Path) -> Iterator[Daemon]:
    with running_daemon(rig.config_path, tmp_path / "log", patience_s=LONG_PATIENCE_S) as daemon:
        yield daemon


@pytest.mark.long
@pytest.mark.timeout(0)
def test_a_drive_with_a_capture_at_each_stop(rig: SimulatedRig, daemon: Daemon) -> None:
    daemon.until_ready()
    rng, course_deg = np.random.default_rng(3), 45.0
    answers: list[dict[str, Any]] = []
    for stop in range(STOPS):
        if stop:
            lat_deg, lon_deg, course_deg = next_stop(rig, course_deg + float(rng.normal(0.0, TURN_DEG)))
            drive_to(rig, lat_deg, lon_deg, DRIVE_S)
        status = daemon.until_idle(answers=stop + 1)  # it looks by itself when the vehicle has come to rest
        last = status["last"]
        fix, truth = Fix.model_validate(last["fix"]), rig.truth()
        outcome = judge(fix, truth)
        assert not outcome.wrong
        if fix.status == "none":  # a far ridge in the haze that was not found, say: no place is named then
            print(f"stop {stop}: none, {last['mode']}")
            answers.append(last)
            continue
        heading_off_deg = (
            last["vehicle_heading_deg"] - truth["base_attitude"]["heading_deg"] + 180
        ) % 360 - 180
        print(
            f"stop {stop}: {fix.status}, {last['mode']}, {outcome.error_m:.1f} m, {outcome.error_sigmas:.1f} sigma, "
            f"heading {heading_off_deg:+.2f} deg, altitude {last['altitude_m'] - truth['altitude_m']:+.1f} m"
        )
        assert abs(heading_off_deg) < 1.0
        answers.append({**last, "error_m": outcome.error_m})
    assert status["counts"]["triggers started"] == status["counts"]["captures done"] == STOPS
    assert {answer["trigger"] for answer in answers} == {"rest"}
    fixes = [answer for answer in answers if answer["fix"]["status"] == "fix"]
    assert len(fixes) >= STOPS - 1
    assert max(answer["error_m"] for answer in fixes) < CELL_M
    # Once a place is known, the odometry leads to the next, even where the search then asks the whole DEM.
    assert all(answer["mode"] != "whole DEM" for answer in answers[1:])
    assert daemon.stop() == 0
