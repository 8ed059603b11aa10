"""The options of every command that reads elevation files."""

from collections.abc import Callable

import click

from localizer.command_line import FiniteRange
from localizer.dem_file import VERTICAL_UNITS

LARGEST_ERROR_M = 1000.0

dem_error_option = click.option(
    "--dem-error",
    "dem_error_m",
    metavar="M",
    type=FiniteRange(0.0, LARGEST_ERROR_M),
    help="One standard deviation of the elevations, metres, where it is known; the search sets out from it. 0 takes them for "
    "the ground itself down to the stone, which only a simulation is.",
)
"""For commands that search."""


def dem_options(command: Callable[..., object]) -> Callable[..., object]:
    """What a person may have to say about elevation files that do not say it themselves."""
    for option in (
        click.option(
            "--nodata", type=float, metavar="VALUE", help="A further value that means void, as --nodata 0."
        ),
        click.option(
            "--crs", metavar="CRS", help="The grid's CRS, where the file does not say it, as EPSG:4326."
        ),
        click.option(
            "--vertical-unit", type=click.Choice(list(VERTICAL_UNITS)), help="The unit of the elevations."
        ),
    ):
        command = option(command)
    return command
