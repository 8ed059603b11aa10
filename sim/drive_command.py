"""``sim drive``: the vehicle of a simulated rig that runs goes elsewhere, and its odometry says how."""

import json
import os
import socket
import time
import tomllib
from functools import reduce
from operator import xor
from pathlib import Path
from typing import Any

import click
import numpy as np
from pyproj import Geod

from sim.errors import SimulationError
from sim.failures import one_line_failures
from sim.steering import CONTROL_VARIABLE, steer

SHAKING_MG = 40.0
RATE_HZ = 10.0
SPEED_SIGMA_SHARE, HEADING_SIGMA_DEG = 0.02, 1.5
_WGS84 = Geod(ellps="WGS84")


@click.command()
@click.argument("lat_deg", type=click.FloatRange(-90.0, 90.0))
@click.argument("lon_deg", type=click.FloatRange(-180.0, 180.0))
@click.option(
    "--heading",
    "heading_deg",
    type=float,
    help="Where the vehicle looks then; the way it drove unless given.",
)
@click.option(
    "--seconds", type=click.FloatRange(min=0.5), default=5.0, show_default=True, help="How long it drives."
)
@click.option(
    "--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Of the odometry's errors."
)
@click.option("--json", "as_json", is_flag=True, help="Print the truth there as one JSON object.")
@one_line_failures
def drive(
    lat_deg: float, lon_deg: float, heading_deg: float | None, seconds: float, seed: int, as_json: bool
) -> None:
    """Drive the simulated vehicle straight to LAT LON and have it stand there, level.

    To be run beside the rig, by a command of sim run. It shakes on the way, and says speed and course (VTG, with a few percent
    of error) to [run.odometry] listen of SKYFIX_CONFIG. Prints the truth's latitude, longitude and altitude there.

    Example: sim run --seed 3 -- sh -c 'rig run & sleep 60; sim drive -- 37.31 -122.21; sleep 60'
    """
    control = os.environ.get(CONTROL_VARIABLE)
    if not control:
        raise SimulationError(f"{CONTROL_VARIABLE} is not set: run this as a command of sim run")
    here = steer(Path(control), {"do": "truth"})
    course_deg, _, distance_m = _WGS84.inv(here["lon_deg"], here["lat_deg"], lon_deg, lat_deg)
    steer(Path(control), {"do": "shake", "mg": SHAKING_MG})
    _drive(float(course_deg) % 360.0, float(distance_m) / seconds, seconds, np.random.default_rng(seed))
    heading = course_deg if heading_deg is None else heading_deg
    there = steer(
        Path(control),
        {"do": "stand", "lat_deg": lat_deg, "lon_deg": lon_deg, "heading_deg": heading % 360.0},
    )
    if as_json:
        click.echo(json.dumps(there))
        return
    click.echo(f"{there['lat_deg']:.7f} {there['lon_deg']:.7f} {there['altitude_m']:.1f}")


def _drive(course_deg: float, speed_m_s: float, seconds: float, rng: np.random.Generator) -> None:
    """Say the movement in equal steps, with errors that are the same all the way; standing still before and after."""
    course_deg = (course_deg + rng.normal(0.0, HEADING_SIGMA_DEG)) % 360.0
    speed_m_s *= 1.0 + rng.normal(0.0, SPEED_SIGMA_SHARE)
    where = _odometry_address()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:

        def say(speed: float) -> None:
            if where:
                out.sendto(vtg(course_deg, speed), where)

        say(0.0)
        say(speed_m_s)
        begun_s = time.monotonic()
        while (left_s := begun_s + seconds - time.monotonic()) > 0.0:
            time.sleep(min(left_s, 1.0 / RATE_HZ))
            say(speed_m_s)
        say(0.0)


def vtg(course_deg: float, speed_m_s: float) -> bytes:
    """The sentence, as NMEA 0183 has it."""
    body = (
        f"IIVTG,{course_deg:.2f},T,,M,{speed_m_s * 3600.0 / 1852.0:.3f},N,{speed_m_s * 3.6:.3f},K,A".encode()
    )
    return b"$" + body + b"*%02X\r\n" % reduce(xor, body)


def _odometry_address() -> tuple[str, int] | None:
    """Of the configuration in force; None where it takes no odometry."""
    config: dict[str, Any] = tomllib.loads(Path(os.environ["SKYFIX_CONFIG"]).read_text(encoding="utf-8"))
    listen = config.get("run", {}).get("odometry", {}).get("listen")
    if listen is None:
        return None
    host, port = listen.rsplit(":", 1)
    return host, int(port)
