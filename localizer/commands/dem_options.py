"""The options of the localizer's commands that read elevation files."""

from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING

import click

from localizer.commands.command_line import FiniteRange, dem_files_option
from localizer.dem.choice import DemChoice
from localizer.dem.units import VERTICAL_UNITS

if TYPE_CHECKING:
    pass

LARGEST_ERROR_M = 1000.0
LARGEST_SCALE = 1e6
GEOID_RANGE_M = (-120.0, 120.0)
"""As ``heights`` has it, which is slow to import."""

Command = Callable[..., object]


dem_option = dem_files_option("Elevation file; repeat it for files that adjoin.", required=True)
dem_files_argument = click.argument(
    "dem_paths", metavar="FILE...", nargs=-1, required=True, type=click.Path(path_type=Path)
)
dem_error_option = click.option(
    "--dem-error",
    "dem_error_m",
    metavar="M",
    type=FiniteRange(0.0, LARGEST_ERROR_M),
    help="One standard deviation of the elevations, metres, where it is known; the search sets out from it. 0 takes them for "
    "the ground itself, as only those of a simulation are.",
)
"""For commands that search."""


def dem_choice(command: Command) -> Command:
    """Passes on ``chosen_dem``, a ``DemChoice``; goes beneath the options of the files and of the error, where there is one."""

    @wraps(command)
    def with_choice(
        *,
        dem_paths: tuple[Path, ...],
        vertical_unit: str | None,
        crs: str | None,
        nodata: float | None,
        band: int | None,
        scale: float | None,
        geoid_offset_m: float | None,
        dem_error_m: float | None = None,
        **others: object,
    ) -> object:
        return command(
            chosen_dem=DemChoice(
                dem_paths, vertical_unit, crs, nodata, dem_error_m, band, scale, geoid_offset_m
            ),
            **others,
        )

    decorated: Command = with_choice
    for option in (
        click.option(
            "--geoid-offset",
            "geoid_offset_m",
            type=FiniteRange(*GEOID_RANGE_M),
            metavar="M",
            help="Where the elevations count from the ellipsoid: the geoid's height above it there (-33 in California), "
            "which is taken off them.",
        ),
        click.option(
            "--scale",
            type=FiniteRange(-LARGEST_SCALE, LARGEST_SCALE),
            metavar="FACTOR",
            help="Of the stored numbers, where the file does not say it or says it wrong, as --scale 0.1.",
        ),
        click.option(
            "--band",
            type=click.IntRange(min=1),
            metavar="N",
            help="The band that holds the elevations, where there are several.",
        ),
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
        decorated = option(decorated)
    return decorated
