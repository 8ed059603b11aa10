"""The command ``rig``: what an operator does with the head, its sensors and its camera."""

import json
import logging
from dataclasses import asdict
from pathlib import Path
from typing import NoReturn

import click

from localizer import command_line
from rig.bundle_commands import bundle
from rig.calibrate.commands import (
    at_option,
    calibrate,
    dem_option,
    dem_sigma_option,
    known_place_of,
    place_sigma_option,
)
from rig.cli_options import config_option
from rig.config import config_path, load_config
from rig.daemon import command as daemon
from rig.directions import Direction, parse_directions
from rig.move_command import move
from rig.record_command import record
from rig.service.commands import service
from rig.signals import stopping_cleanly
from rig.watch.command import watch


def main() -> NoReturn:
    """Entry point of the program."""
    command_line.run(rig, "rig")


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.option("--verbose", is_flag=True, help="Say more about what happens, on standard error.")
def rig(verbose: bool) -> None:
    """Measure the horizon with a camera on a pan-tilt head.

    Example: rig capture --config vehicle.toml --out bundles
    """
    level = logging.INFO if verbose else logging.WARNING
    logging.basicConfig(level=level, format="rig: %(message)s")


@rig.command()
@config_option
@click.option(
    "--out",
    "out_dir",
    metavar="DIR",
    type=click.Path(path_type=Path),
    help="Where the bundle goes; by default [rig] bundle_dir.",
)
@click.option(
    "--directions",
    "names",
    metavar="LIST",
    help="Where to look: letters (N, NE, ...) or degrees true, separated by commas; by default [capture] directions.",
)
@click.option("--locate", is_flag=True, help="Search for the place at once; needs --dem.")
@click.option(
    "--dem",
    "dem_paths",
    metavar="FILE",
    type=click.Path(path_type=Path),
    multiple=True,
    help="Elevation file for --locate; repeat it for files that adjoin.",
)
@click.option(
    "--repeat", type=click.IntRange(min=1), default=1, help="How many bundles to take, one after the other."
)
@click.option(
    "--every",
    "every_s",
    type=click.FloatRange(min=0.0),
    default=0.0,
    help="From one beginning to the next, seconds.",
)
def capture(
    config_file: Path | None,
    out_dir: Path | None,
    names: str | None,
    locate: bool,
    dem_paths: tuple[Path, ...],
    repeat: int,
    every_s: float,
) -> int:
    """Take a measurement bundle: level and heading of the vehicle, then a frame in each direction.

    Prints the bundle's directory, and with --locate the fix after it; ends with the status of localizer locate
    then. Ctrl-C ends it with the head relaxed and nothing half-written. With --repeat a capture that fails is told on
    standard error and the next one is taken; the status is 2 where any failed.

    \b
    Examples:
      rig capture --config vehicle.toml
      rig capture --directions N,E,S,W --locate --dem terrain.tif
      rig capture --repeat 48 --every 1800
    """
    if repeat > 1 and locate:
        raise click.UsageError("--repeat takes bundles only; locate them afterwards.")
    if locate != bool(dem_paths):
        raise click.UsageError("--locate and --dem FILE go together.")
    directions = _directions(names)
    config = load_config(config_path(config_file))

    # Slow to import, and bad input should be told at once.
    from rig.capture import capture as take
    from rig.progress import reporting

    if locate:
        from localizer.dem import load_dem

        dem = load_dem(dem_paths)
    directions = directions or config.capture.parsed_directions()
    out_dir = out_dir or config.rig.bundle_dir
    if repeat > 1:
        from rig.repeat import repeated

        def once() -> Path:
            with reporting(1 + len(directions)) as report:
                return take(config, directions, out_dir, report)

        with stopping_cleanly():
            return repeated(once, repeat, every_s)
    with stopping_cleanly(), reporting(1 + len(directions)) as report:
        bundle_dir = take(config, directions, out_dir, report)
    click.echo(bundle_dir)
    if not locate:
        return 0

    from localizer.bundle import load_bundle
    from localizer.locate import locate_bundle
    from localizer.report import report as fix_report

    fix = locate_bundle(load_bundle(bundle_dir), dem).fix
    click.echo(fix_report(fix, dem, None))
    return fix.exit_status


rig.add_command(calibrate)
rig.add_command(bundle)
rig.add_command(record)
rig.add_command(move)
for daemon_command in (daemon.run, daemon.trigger, daemon.status):
    rig.add_command(daemon_command)
rig.add_command(watch)
rig.add_command(service)


@rig.command()
@config_option
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object instead of the table.")
@at_option
@dem_option
@place_sigma_option
@dem_sigma_option
def check(
    config_file: Path | None,
    as_json: bool,
    at: str | None,
    dem_paths: tuple[Path, ...],
    place_sigma_m: float,
    dem_sigma_m: float,
) -> int:
    """Connect to every device and say how it is; nothing moves. Ends with status 1 if any device fails.

    At a known place (--at, --dem) the head turns, and the DEM's skyline says whether the calibration still holds; status 1
    where it does not.

    \b
    Examples:
      rig check --config vehicle.toml
      rig check --at 37.2012,-122.1034 --dem terrain.tif
    """
    config = load_config(config_path(config_file))
    place = known_place_of(at, dem_paths) if at is not None else None

    from rig import check as checks

    with stopping_cleanly():
        results = checks.check_devices(config)
        offsets = []
        if place is not None and all(result.ok for result in results):
            from rig.calibrate.boresight import check_boresight
            from rig.calibrate.boresight_fit import PlaceSigmas

            sigmas = PlaceSigmas(place_sigma_m, dem_sigma_m, dem_sigma_m)
            offsets = check_boresight(config, place, sigmas)
    if as_json:
        found = checks.as_json(results)
        if place is not None:
            found["calibration"] = [asdict(offset) for offset in offsets]
        click.echo(json.dumps(found, indent=2))
    else:
        checks.print_table(results, checks.table_console())
        for offset in offsets:
            verdict = "holds" if offset.holds else "NO LONGER HOLDS: rig calibrate boresight"
            click.echo(f"{offset.name}: {offset.off_deg:+.3f} +- {offset.sigma_deg:.3f} deg off, {verdict}")
    return 0 if all(result.ok for result in results) and all(offset.holds for offset in offsets) else 1


def _directions(names: str | None) -> list[Direction]:
    """The directions of the option; none where it is not given."""
    if names is None:
        return []
    try:
        return parse_directions(names.split(","))
    except ValueError as error:
        raise click.UsageError(f"--directions: {error}.") from error
