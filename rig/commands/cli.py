"""The command ``rig``: group of all commands for the head, its sensors and its camera."""

import json
import logging
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

import click

from localizer.commands import command_line
from localizer.commands.completion import completion_command
from rig.commands import daemon
from rig.commands.bundle import bundle
from rig.commands.calibrate import calibrate
from rig.commands.calibrate_options import at_option, dem_option, known_place_of, place_sigma_options
from rig.commands.capture import capture
from rig.commands.move import move
from rig.commands.options import config_option
from rig.commands.record import record
from rig.commands.service import service
from rig.commands.signals import stopping_cleanly
from rig.commands.telemetry import telemetry
from rig.commands.watch import watch
from rig.config.load import config_path, load_config

if TYPE_CHECKING:
    from rig.calibrate.boresight.known_place import PlaceSigmas


def main() -> NoReturn:
    """Entry point of the program."""
    command_line.run(rig, "rig")


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@command_line.version_option("rig")
@click.option("--verbose", is_flag=True, help="Say more about what happens, on standard error.")
def rig(verbose: bool) -> None:
    """Measure the horizon with a camera on a pan-tilt head.

    Example: rig capture --config vehicle.toml --out bundles
    """
    level = logging.INFO if verbose else logging.WARNING
    logging.basicConfig(level=level, format="rig: %(message)s")


rig.add_command(capture)
rig.add_command(calibrate)
rig.add_command(bundle)
rig.add_command(record)
rig.add_command(move)
for daemon_command in (daemon.run, daemon.trigger, daemon.status):
    rig.add_command(daemon_command)
rig.add_command(watch)
rig.add_command(telemetry)
rig.add_command(completion_command("rig"))
rig.add_command(service)


@rig.command()
@config_option
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object instead of the table.")
@at_option
@dem_option
@place_sigma_options
def check(
    config_file: Path | None,
    as_json: bool,
    at: str | None,
    dem_paths: tuple[Path, ...],
    sigmas: "PlaceSigmas",
) -> int:
    """Connect to every device and show its state; nothing moves. Ends with status 1 if any device fails.

    The altitude is compared with [place] and with the ground of the DEM, by default that of [run]. At a known place
    (--at, --dem) the head moves, and the DEM's skyline shows whether the calibration still holds; status 1 if it does
    not.

    \b
    Examples:
      rig check --config vehicle.toml
      rig check --at 37.2012,-122.1034 --dem terrain.tif
    """
    config = load_config(config_path(config_file))
    place = known_place_of(at, dem_paths) if at is not None else None

    from rig.check import text
    from rig.check.devices import check_all

    with stopping_cleanly():
        results = check_all(config, place.dem if place else None, dem_paths)
        offsets = []
        if place is not None and all(result.ok for result in results):
            from rig.calibrate.boresight.procedure import check_boresight

            offsets = check_boresight(config, place, sigmas)
    whole = all(result.ok for result in results) and all(offset.holds for offset in offsets)
    if as_json:
        found = text.as_json(results)
        if place is not None:
            found["ok"] = whole
            found["calibration"] = [asdict(offset) for offset in offsets]
        click.echo(json.dumps(found, indent=2))
    else:
        text.print_table(results, text.table_console())
        for offset in offsets:
            verdict = "holds" if offset.holds else "NO LONGER HOLDS: rig calibrate boresight"
            click.echo(f"{offset.name}: {offset.off_deg:+.3f} +- {offset.sigma_deg:.3f} deg off, {verdict}")
    if place is not None and not offsets:
        click.echo("rig: the calibration was not checked: a device failed; mend that first", err=True)
    return 0 if whole else 1
