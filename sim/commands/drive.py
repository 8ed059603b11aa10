"""``sim drive``: moves the vehicle of a running simulated rig."""

import json
import os
import time
from pathlib import Path

import click
from pyproj import Geod

from localizer.commands.command_line import FiniteRange, NumbersCommand
from sim.commands.failures import one_line_failures
from sim.errors import SimulationError
from sim.launch.steering import SOCKET_NAME, steer

_WGS84 = Geod(ellps="WGS84")


@click.command(cls=NumbersCommand)
@click.argument("lat_deg", type=FiniteRange(-90.0, 90.0))
@click.argument("lon_deg", type=FiniteRange(-360.0, 360.0))
@click.option(
    "--heading",
    "heading_deg",
    type=float,
    help="Where the vehicle looks then; the way it drove unless given.",
)
@click.option(
    "--seconds", type=FiniteRange(min=0.5), default=5.0, show_default=True, help="How long it drives."
)
@click.option("--json", "as_json", is_flag=True, help="Print the truth there as one JSON object.")
@one_line_failures
def drive(lat_deg: float, lon_deg: float, heading_deg: float | None, seconds: float, as_json: bool) -> None:
    """Drive the simulated vehicle straight to LAT LON and stop there, level.

    Run it while the rig runs, within a command of sim run. The vehicle vibrates while driving, and its odometer sends
    speed and course to [run.odometry] listen. Prints the truth's latitude, longitude and altitude there.

    Example: sim run --seed 3 -- sh -c 'rig run & sleep 60; sim drive 37.31 -122.21; sleep 60'
    """
    config = os.environ.get("SKYFIX_CONFIG")
    if not config:
        raise SimulationError("SKYFIX_CONFIG is not set: run this as a command of sim run")
    rig = Path(config).with_name(SOCKET_NAME)
    here = steer(rig, {"do": "truth"})
    course_deg, _, distance_m = _WGS84.inv(here["lon_deg"], here["lat_deg"], lon_deg, lat_deg)
    steer(rig, {"do": "go", "speed_m_s": distance_m / seconds, "course_deg": course_deg})
    time.sleep(seconds)
    heading = course_deg if heading_deg is None else heading_deg
    there = steer(
        rig,
        {"do": "stand", "lat_deg": lat_deg, "lon_deg": lon_deg, "heading_deg": heading % 360.0},
    )
    if as_json:
        click.echo(json.dumps(there))
        return
    click.echo(f"{there['lat_deg']:.7f} {there['lon_deg']:.7f} {there['altitude_m']:.1f}")
