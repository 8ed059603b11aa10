"""Options shared by the commands of ``rig calibrate``, and their conversion."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from localizer.commands.command_line import FiniteRange, OutputFolder, dem_files_option
from rig.commands.options import config_option
from rig.commands.signals import stopping_cleanly

if TYPE_CHECKING:
    from rig.calibrate.boresight.known_place import KnownPlace
    from rig.calibrate.camera.target import CalibrationTarget
    from rig.calibrate.run import CalibrationRun

Command = Callable[..., Any]

# Fitting and plotting modules are slow to import: functions import them.

json_option = click.option("--json", "as_json", is_flag=True, help="Print the result as one JSON object.")
at_option = click.option(
    "--at", metavar="LAT,LON", help="The known place where the vehicle stands, WGS84 degrees."
)
dem_option = dem_files_option("Elevation file for --at; repeat it for files that adjoin.")
target_option = click.option(
    "--board",
    "board_text",
    default="charuco:9x7:30:22",
    show_default=True,
    metavar="TEXT",
    help="charuco:COLUMNSxROWS:SQUARE_MM:MARKER_MM or chessboard:COLUMNSxROWS:SQUARE_MM (inner corners).",
)


@dataclass(frozen=True)
class CommonOptions:
    """The options common to all calibrations."""

    config_file: Path | None
    out_dir: Path | None
    yes: bool
    as_json: bool

    @contextmanager
    def calibration_run(self) -> Iterator["CalibrationRun"]:
        """The calibration in progress; a signal ends it with clean-up."""
        from rig.calibrate.run import CalibrationRun

        calibration_run = CalibrationRun.open(self.config_file, self.out_dir, self.yes, self.as_json)
        with stopping_cleanly():
            yield calibration_run


def calibration_run_options(command: Command) -> Command:
    """Give a command the options of all calibrations, as one argument ``common``."""

    @config_option
    @click.option(
        "--out",
        "out_dir",
        metavar="DIR",
        type=OutputFolder(),
        help="Where the calibration goes; by default the folder calibration beside the configuration.",
    )
    @click.option("--yes", is_flag=True, help="Ask nothing: all is ready, and the result is used.")
    @json_option
    @wraps(command)
    def with_common_options(
        config_file: Path | None, out_dir: Path | None, yes: bool, as_json: bool, **others: Any
    ) -> Any:
        return command(common=CommonOptions(config_file, out_dir, yes, as_json), **others)

    return with_common_options


def place_sigma_options(command: Command) -> Command:
    """Give a command the options of how well a place is known, as one argument ``sigmas``, a ``PlaceSigmas``."""

    @click.option(
        "--place-sigma",
        "place_sigma_m",
        type=FiniteRange(0.1),
        default=4.0,
        show_default=True,
        help="How well the place is known, metres.",
    )
    @click.option(
        "--dem-sigma",
        "dem_sigma_m",
        type=FiniteRange(0.0),
        default=1.5,
        show_default=True,
        help="How far the DEM's ridges are off in height, metres.",
    )
    @wraps(command)
    def with_sigmas(place_sigma_m: float, dem_sigma_m: float, **others: Any) -> Any:
        from rig.calibrate.boresight.known_place import PlaceSigmas

        return command(sigmas=PlaceSigmas(place_sigma_m, dem_sigma_m, dem_sigma_m), **others)

    return with_sigmas


def known_place_of(at: str, dem_paths: tuple[Path, ...], option: str = "--at") -> "KnownPlace":
    """The place named by ``option``, on the elevation files; ``UsageError`` for an invalid one."""
    from rig.calibrate.boresight.known_place import known_place, parse_place

    if not dem_paths:
        raise click.UsageError(f"{option} needs --dem FILE.")
    try:
        lat_deg, lon_deg = parse_place(at)
    except ValueError as error:
        raise click.UsageError(f"{option}: {error}.") from error
    return known_place(lat_deg, lon_deg, dem_paths, option)


def target_of(text: str) -> "CalibrationTarget":
    """The calibration target named by ``--board``; ``UsageError`` for an invalid one."""
    from rig.calibrate.camera.target import parse_target

    try:
        return parse_target(text)
    except ValueError as error:
        raise click.UsageError(f"--board: {error}.") from error
