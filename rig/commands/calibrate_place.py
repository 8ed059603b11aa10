"""``rig calibrate boresight`` at a known place, and ``rig calibrate sites``, which recommends such places."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import click

from localizer.commands.command_line import FiniteRange
from rig.commands.calibrate_options import (
    CommonOptions,
    at_option,
    calibration_run_options,
    dem_option,
    known_place_of,
    place_sigma_options,
)

if TYPE_CHECKING:
    from rig.calibrate.boresight.known_place import PlaceSigmas


@click.command()
@calibration_run_options
@at_option
@dem_option
@place_sigma_options
@click.option(
    "--directions", type=click.IntRange(4, 24), default=8, show_default=True, help="To look in, all round."
)
def boresight(
    common: CommonOptions,
    at: str | None,
    dem_paths: tuple[Path, ...],
    sigmas: "PlaceSigmas",
    directions: int,
) -> None:
    """Calibrate the camera's mounting in the head, and the heading offset, from the DEM's skyline at a known place.

    Example: rig calibrate boresight --at 37.2012,-122.1034 --dem terrain.tif
    """
    if at is None:
        raise click.UsageError(
            "Give --at LAT,LON and --dem FILE: the boresight is measured at a known place."
        )

    from rig.calibrate.boresight.procedure import calibrate_boresight

    with common.calibration_run() as calibration_run:
        calibrate_boresight(calibration_run, known_place_of(at, dem_paths), sigmas, directions)


@click.command()
@click.option(
    "--near", "near", metavar="LAT,LON", required=True, help="Where to look for places, WGS84 degrees."
)
@dem_option
@click.option(
    "--within", "within_km", type=FiniteRange(0.05), default=5.0, show_default=True, help="Kilometres."
)
@click.option(
    "--mast",
    "mast_m",
    type=FiniteRange(0.1),
    default=2.0,
    show_default=True,
    help="Camera above ground, metres.",
)
@place_sigma_options
@click.option("--count", type=click.IntRange(1, 50), default=5, show_default=True, help="How many to name.")
@click.option("--json", "as_json", is_flag=True, help="Print a JSON list instead of lines.")
def sites(
    near: str,
    dem_paths: tuple[Path, ...],
    within_km: float,
    mast_m: float,
    sigmas: "PlaceSigmas",
    count: int,
    as_json: bool,
) -> None:
    """Recommend places for the boresight calibration, with a far and rugged skyline, best first.

    \b
    Examples:
      rig calibrate sites --near 37.2012,-122.1034 --dem terrain.tif
      rig calibrate sites --near 37.2012,-122.1034 --dem terrain.tif --within 2 --json
    """
    from rig.calibrate.boresight.sites import best_sites

    place = known_place_of(near, dem_paths, "--near")
    found = best_sites(place, 1000.0 * within_km, mast_m, sigmas, count)
    if as_json:
        click.echo(json.dumps([asdict(site) for site in found], indent=2))
        return
    for site in found:
        click.echo(
            f"{site.lat_deg:.5f},{site.lon_deg:.5f}  ground {site.ground_m:.0f} m  tilt +- {site.tilt_sigma_deg:.3f} deg  "
            f"azimuth +- {site.azimuth_sigma_deg:.3f} deg  {site.far_share:.0%} of the ridges farther than 1 km"
        )
