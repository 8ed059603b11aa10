"""A drive on the simulated rig: every position of the daemon, as reported by gpsd, against the truth."""

import time
from dataclasses import dataclass
from functools import partial

import numpy as np
import pytest
from fakes.daemon import LONG_PATIENCE_S, add_keys, running_daemon
from fakes.driving import drive_to, next_stop
from fakes.gpsd import ellipse, position, reports_of, time_of
from pyproj import Geod

from rig.config.load import load_config
from sim.commands.options import EMBEDDED_DEM
from sim.launch.launcher import simulated_rig
from sim.world.scenario import Scenario
from sim.world.truth import World

pytestmark = [pytest.mark.system, pytest.mark.timeout(0)]

FEW_STOPS, STOPS = 2, 10
TURN_DEG = 25.0
DRIVE_S = 8.0
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


def off_m(report, truth):
    """East and north of the truth."""
    azimuth_deg, _, distance_m = GEOD.inv(truth["lon_deg"], truth["lat_deg"], report["lon"], report["lat"])
    azimuth = np.radians(azimuth_deg)
    return distance_m * np.array([np.sin(azimuth), np.cos(azimuth)])


@pytest.mark.parametrize("stops_wanted", [FEW_STOPS, pytest.param(STOPS, marks=pytest.mark.long)])
def test_gpsd_never_reports_a_place_where_the_vehicle_is_not(program, tmp_path, stops_wanted):
    world, rng = World.create([EMBEDDED_DEM], Scenario(), 3), np.random.default_rng(3)
    with simulated_rig(world, bundle_dir=tmp_path / "bundles", dem_paths=[EMBEDDED_DEM]) as rig:
        add_keys(rig.config_path, "run.rest", still_s=STILL_S)
        add_keys(rig.config_path, "run.nmea", valid_s=600.0)  # until it moves, however slow this machine
        tcp = load_config(rig.config_path).run.nmea.tcp
        add_keys(rig.config_path, "run.search", time_s=LONG_PATIENCE_S)
        with running_daemon(rig.config_path, tmp_path / "log", patience_s=LONG_PATIENCE_S) as daemon:
            daemon.until_ready()
            with reports_of(program, f"tcp://{tcp}") as reports:
                stops, answers = drive_on(rig, daemon, rng, reports, stops_wanted)
            assert daemon.stop() == 0
    told = [(at_s, report) for at_s, report in reports.all if position(report)]
    for at_s, report in told:
        stop = next(stop for stop in stops if stop.from_s <= at_s <= stop.until_s + UNTIL_NOTICED_S)
        assert np.hypot(*off_m(report, stop.truth)) < CELL_M
    fixes = [answer for answer in answers if answer["fix"]["status"] == "fix"]
    assert len(fixes) >= stops_wanted - 1
    times = {time_of(report).replace(microsecond=0) for _, report in told}
    assert len(times) == len(fixes)


def of_place(place, report):
    return position(report) and abs(report["lat"] - place["lat_deg"]) < 1e-6


def drive_on(rig, daemon, rng, reports, stops_wanted):
    """Stop after stop; what gpsd said of each fix is compared at once with the answer's own figures."""
    stops, answers, course_deg = [], [], 45.0
    for number in range(stops_wanted):
        if number:
            lat_deg, lon_deg, course_deg = next_stop(rig, course_deg + rng.normal(0.0, TURN_DEG))
            drive_to(rig, lat_deg, lon_deg, DRIVE_S)
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
