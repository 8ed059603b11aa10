"""The daemon on a vehicle that drives: ten stops in simulated terrain, with odometry; every place is held against the truth."""

import os
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fakes.daemon import LONG_PATIENCE_S, Daemon, add_keys, running_daemon

from localizer.fix import Fix
from sim.cli import EMBEDDED_DEM
from sim.command import find_command, search_path
from sim.demo import judge
from sim.launcher import SimulatedRig, simulated_rig
from sim.scenario import Scenario
from sim.world import World

STOPS = 10
LEG_M, TURN_DEG = 250.0, 25.0
CELL_M = 30.0
STILL_S = 3.0


def next_stop(rig: SimulatedRig, course_deg: float) -> tuple[float, float, float]:
    """Latitude, longitude and course of a stop that is well inside the terrain, near the course."""
    here = rig.world.place
    for turn_deg in (0.0, 40.0, -40.0, 80.0, -80.0, 120.0, 180.0):
        course = np.radians(course_deg + turn_deg)
        lat_deg = here.lat_deg + LEG_M * np.cos(course) / 111_000.0
        lon_deg = here.lon_deg + LEG_M * np.sin(course) / (111_000.0 * np.cos(np.radians(here.lat_deg)))
        row, col = rig.world.surface.terrain.row_col(lon_deg, lat_deg)
        rows, cols = rig.world.surface.height_m.shape
        if 100 < float(row) < rows - 100 and 100 < float(col) < cols - 100:
            return float(lat_deg), float(lon_deg), course_deg + turn_deg
    raise AssertionError("nowhere to go")


def drive_to(rig: SimulatedRig, lat_deg: float, lon_deg: float) -> None:
    """As a user of the simulator drives it."""
    command = [find_command("sim"), "drive", "--seconds", "6", "--"]
    environment = {**os.environ, "PATH": search_path(), **rig.environment}
    subprocess.run([*command, f"{lat_deg:.7f}", f"{lon_deg:.7f}"], env=environment, check=True, timeout=300)


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
def test_a_drive_with_a_look_at_each_stop(rig: SimulatedRig, daemon: Daemon) -> None:
    daemon.until_ready()
    rng, course_deg = np.random.default_rng(3), 45.0
    answers: list[dict[str, Any]] = []
    for stop in range(STOPS):
        if stop:
            lat_deg, lon_deg, course_deg = next_stop(rig, course_deg + float(rng.normal(0.0, TURN_DEG)))
            drive_to(rig, lat_deg, lon_deg)
        status = daemon.until_idle(answers=stop + 1)  # it looks by itself when the vehicle has come to rest
        last = status["last"]
        fix, truth = Fix.model_validate(last["fix"]), rig.truth()
        outcome = judge(fix, truth)
        heading_off_deg = (
            last["vehicle_heading_deg"] - truth["base_attitude"]["heading_deg"] + 180
        ) % 360 - 180
        print(
            f"stop {stop}: {fix.status}, {last['mode']}, {outcome.error_m:.1f} m, {outcome.error_sigmas:.1f} sigma, "
            f"heading {heading_off_deg:+.2f} deg, altitude {last['altitude_m'] - truth['altitude_m']:+.1f} m"
        )
        assert not outcome.wrong
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
