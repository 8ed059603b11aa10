"""A drive of ten stops on the simulated rig: the daemon's every position, as gpsd reports it, beside the truth."""

import os
import subprocess
import time
from dataclasses import dataclass
from functools import partial

import numpy as np
import pytest
from fakes.daemon import add_keys, running_daemon
from fakes.gpsd import ellipse, position, reports_of, time_of
from pyproj import Geod

from rig.config import load_config
from sim.cli import EMBEDDED_DEM
from sim.command import find_command, search_path
from sim.launcher import simulated_rig
from sim.scenario import Scenario
from sim.world import World

pytestmark = [pytest.mark.system, pytest.mark.timeout(0)]

STOPS = 10
LEG_M = 250.0
DRIVE_S = 8.0
MARGIN_CELLS = 100
STILL_S = 3.0
UNTIL_NOTICED_S = 4.0
"""From the first movement to the next epoch that gpsd has reported."""
CELL_M = 30.0
GEOD = Geod(ellps="WGS84")


@dataclass
class Stop:
    """Where the vehicle stood, and when, on the monotonic clock."""

    truth: dict
    from_s: float
    until_s: float


def next_stop(rig, rng):
    """Latitude and longitude of a place one leg away, well inside the terrain."""
    here, surface = rig.world.place, rig.world.surface
    for _ in range(100):
        lon_deg, lat_deg, _ = GEOD.fwd(here.lon_deg, here.lat_deg, rng.uniform(0.0, 360.0), LEG_M)
        inside = surface.terrain.row_col(lon_deg, lat_deg) / np.array(surface.height_m.shape)
        margin = MARGIN_CELLS / np.array(surface.height_m.shape)
        if (inside > margin).all() and (inside < 1.0 - margin).all():
            return float(lat_deg), float(lon_deg)
    return pytest.fail("nowhere to go")


def drive(rig, lat_deg, lon_deg):
    """As a user of the simulator drives it."""
    command = [find_command("sim"), "drive", "--seconds", str(DRIVE_S), "--"]
    environment = {**os.environ, "PATH": search_path(), **rig.environment}
    subprocess.run([*command, f"{lat_deg:.7f}", f"{lon_deg:.7f}"], env=environment, check=True, timeout=300)


def off_m(report, truth):
    """East and north of the truth."""
    azimuth_deg, _, distance_m = GEOD.inv(truth["lon_deg"], truth["lat_deg"], report["lon"], report["lat"])
    azimuth = np.radians(azimuth_deg)
    return distance_m * np.array([np.sin(azimuth), np.cos(azimuth)])


@pytest.mark.long
def test_gpsd_never_reports_a_place_where_the_vehicle_is_not(program, tmp_path):
    world, rng = World.create([EMBEDDED_DEM], Scenario(), 3), np.random.default_rng(3)
    with simulated_rig(world, bundle_dir=tmp_path / "bundles", dem_paths=[EMBEDDED_DEM]) as rig:
        add_keys(rig.config_path, "run.rest", still_s=STILL_S)
        add_keys(rig.config_path, "run.nmea", valid_s=600.0)  # until it moves, however slow this machine
        tcp = load_config(rig.config_path).run.nmea.tcp
        with running_daemon(rig.config_path, tmp_path / "log") as daemon:
            daemon.until_ready()
            with reports_of(program, f"tcp://{tcp}") as reports:
                stops, answers = drive_on(rig, daemon, rng, reports)
            assert daemon.stop() == 0
    told = [(at_s, report) for at_s, report in reports.all if position(report)]
    for at_s, report in told:
        stop = next(stop for stop in stops if stop.from_s <= at_s <= stop.until_s + UNTIL_NOTICED_S)
        assert np.hypot(*off_m(report, stop.truth)) < CELL_M
    fixes = [answer for answer in answers if answer["fix"]["status"] == "fix"]
    assert len(fixes) >= STOPS - 1
    times = {time_of(report).replace(microsecond=0) for _, report in told}
    assert len(times) == len(fixes)


def of_place(place, report):
    return position(report) and abs(report["lat"] - place["lat_deg"]) < 1e-6


def drive_on(rig, daemon, rng, reports):
    """Stop after stop; what gpsd said of each fix is compared at once with the answer's own figures."""
    stops, answers = [], []
    for number in range(STOPS):
        if number:
            drive(rig, *next_stop(rig, rng))
            stops[-1].until_s = time.monotonic() - DRIVE_S
        stops.append(Stop(rig.truth(), time.monotonic(), float("inf")))
        last = daemon.until_idle(answers=number + 1)["last"]
        answers.append(last)
        if last["fix"]["status"] != "fix":
            continue
        place = last["fix"]["position"]
        tpv = reports.until(partial(of_place, place))
        assert tpv["lon"] == pytest.approx(place["lon_deg"], abs=1e-6)
        assert tpv["altMSL"] == pytest.approx(last["altitude_m"], abs=0.06)
        gst = reports.until(ellipse)
        off = off_m(tpv, stops[-1].truth)
        turn = np.radians(gst["orient"])
        axes = np.array([[np.sin(turn), np.cos(turn)], [np.cos(turn), -np.sin(turn)]])
        sigmas = np.hypot(*(axes @ off / [gst["major"], gst["minor"]]))
        print(f"stop {number}: {np.hypot(*off):.2f} m off, {sigmas:.1f} sigma of GST's ellipse")
        assert sigmas < 6.0
    return stops, answers
