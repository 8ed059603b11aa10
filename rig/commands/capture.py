"""The command ``rig capture``."""

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from localizer.commands.command_line import FiniteRange, OutputFolder, dem_files_option
from localizer.commands.dem_options import dem_choice, dem_error_option
from localizer.dem.choice import DemChoice
from rig import timebase
from rig.clock import wall_clock
from rig.commands.options import config_option
from rig.commands.signals import stopping_cleanly
from rig.config.directions import Direction, parse_directions
from rig.config.load import config_path, load_config
from rig.config.model import RigConfig

if TYPE_CHECKING:
    from localizer.dem.lattice import Dem

# Measuring and searching modules are slow to import; functions import them, so that bad input is reported at
# once.


@click.command()
@config_option
@click.option(
    "--out",
    "out_dir",
    metavar="DIR",
    type=OutputFolder(),
    help="Where the bundle goes; by default [rig] bundle_dir.",
)
@click.option(
    "--directions",
    "names",
    metavar="LIST",
    help="Where to look: letters (N, NE, ...) or degrees true, separated by commas; by default [capture] directions.",
)
@click.option("--locate", is_flag=True, help="Search for the place at once, in --dem, else in [run] dem.")
@dem_files_option("Elevation file for --locate; repeat it for files that adjoin.")
@dem_error_option
@dem_choice
@click.option(
    "--repeat",
    type=click.IntRange(min=1),
    default=1,
    metavar="N",
    help="Take a series of so many bundles, in a folder of its own.",
)
@click.option(
    "--every",
    "every_s",
    type=FiniteRange(min=0.0),
    default=0.0,
    metavar="SECONDS",
    help="From the beginning of one bundle of a series to the next; at once where a capture takes longer.",
)
@click.option(
    "--telemetry",
    "telemetry_file",
    metavar="FILE",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Record readings, states and small pictures for Foxglove (.mcap); by default into [rig] telemetry_dir, if any.",
)
@click.option("--fresh", is_flag=True, help="Begin another series although one like it is unfinished.")
@click.option(
    "--json", "as_json", is_flag=True, help="Print JSON: an object, or a line for each bundle of a series."
)
def capture(
    config_file: Path | None,
    out_dir: Path | None,
    names: str | None,
    locate: bool,
    chosen_dem: DemChoice,
    repeat: int,
    every_s: float,
    telemetry_file: Path | None,
    fresh: bool,
    as_json: bool,
) -> int:
    """Take a measurement bundle: level and heading of the vehicle, then a frame in each direction.

    Prints the bundle's directory, and with --locate the fix after it; the exit status is then that of localizer locate.
    Ctrl-C ends it with the torque off and no partial files.

    With --repeat a series: its folder holds the bundles, a picture of each with the skylines found, and the journal
    series.jsonl, so that the same command resumes after Ctrl-C, a crash or a power cut. Disk space for the whole series
    is checked beforehand. A failed capture does not end it; a summary at the end shows failures and their reasons, the
    spread of the readings and the duration, and the status is 2 if any failed.

    \b
    Examples:
      rig capture --config vehicle.toml
      rig capture --directions N,E,S,W --locate --dem terrain.tif
      rig capture --repeat 48 --every 1800
      rig capture --telemetry session.mcap
    """
    if repeat > 1 and locate:
        raise click.UsageError("--repeat takes bundles only; locate them afterwards.")
    if chosen_dem != DemChoice(()) and not locate:
        raise click.UsageError("--dem and what is said of it go with --locate.")
    if locate and not chosen_dem.paths and chosen_dem != DemChoice(()):
        raise click.UsageError("--dem FILE is missing, of which something is said.")
    if repeat == 1 and (fresh or every_s):
        raise click.UsageError("--every and --fresh go with --repeat N, N being 2 or more.")
    directions = _directions(names)
    config = load_config(config_path(config_file))
    directions = directions or config.capture.parsed_directions()
    out_dir = out_dir or config.rig.bundle_dir
    dem = None
    if locate:
        dem = (
            chosen_dem if chosen_dem.paths else _configured_dem(config, config_path(config_file))
        ).load_to_search("rig")
    with _telemetry(config, telemetry_file):
        if repeat > 1:
            return _take_series(config, directions, out_dir, repeat, every_s, fresh, as_json)
        return _take_one(config, directions, out_dir, dem, as_json)


@contextmanager
def _telemetry(config: RigConfig, file: Path | None) -> Iterator[None]:
    """Record telemetry into the file, else into one named by the time if the configuration has a folder for it."""
    if file is None and config.rig.telemetry_dir is not None:
        file = config.rig.telemetry_dir / f"{wall_clock():%Y%m%dT%H%M%SZ}.mcap"
    if file is None:
        yield
        return
    from rig.telemetry.writer import recording_telemetry

    with recording_telemetry(file, config) as path:
        click.echo(f"telemetry: {path}", err=True)
        yield


def _take_one(
    config: RigConfig, directions: list[Direction], out_dir: Path, dem: "Dem | None", as_json: bool
) -> int:
    from localizer.bundle import load_bundle
    from rig.bundle.summary import bundle_summary
    from rig.capture.progress import console_progress
    from rig.capture.sequence import capture as take

    begun_s = timebase.monotonic_s()
    with stopping_cleanly(), console_progress(1 + len(directions)) as report:
        bundle_dir = take(config, directions, out_dir, report, dem=dem)
    took_s = timebase.monotonic_s() - begun_s
    if not as_json:
        click.echo(bundle_dir)
    found = {**bundle_summary(load_bundle(bundle_dir)), "took_s": round(took_s, 2)} if as_json else {}
    status = 0
    if dem is not None:
        from localizer.search.locate import locate_bundle
        from localizer.show.text import fix_text, notes

        bundle = load_bundle(bundle_dir)
        located = locate_bundle(bundle, dem)
        fix = located.fix
        for note in notes(located, bundle, dem):
            click.echo(f"rig: {note}", err=True)
        found["fix"] = json.loads(fix.to_json()) if as_json else None
        if not as_json:
            click.echo(fix_text(fix, dem, None))
        status = fix.exit_status
    if as_json:
        click.echo(json.dumps(found))
    return status


def _take_series(
    config: RigConfig,
    directions: list[Direction],
    out_dir: Path,
    repeat: int,
    every_s: float,
    fresh: bool,
    as_json: bool,
) -> int:
    from rig.bundle.writer import require_writable
    from rig.capture.progress import console_progress
    from rig.capture.sequence import capture as take
    from rig.series.console import SeriesConsole
    from rig.series.journal import Plan, begin_series, locked_series, unfinished_series
    from rig.series.run import take_series
    from rig.series.space import require_space

    require_writable(out_dir)
    plan = Plan(repeat, every_s, tuple(direction.label for direction in directions), config.rig.name)
    unfinished = None if fresh else unfinished_series(out_dir, plan)
    require_space(out_dir, config, len(unfinished.remaining()) if unfinished else repeat, len(directions))
    folder = (unfinished or begin_series(out_dir, plan)).folder

    def once(into: Path, remarks: Mapping[str, Any]) -> Path:
        with console_progress(1 + len(directions)) as report:
            return take(config, directions, into, report, remarks)

    with locked_series(folder) as series:
        reports = SeriesConsole(series, as_json)
        reports.begins(goes_on=unfinished is not None)
        try:
            with stopping_cleanly():
                for outcome in take_series(series, once, reports.say):
                    reports.outcome(outcome)
        finally:
            reports.ends()
    return 2 if any(outcome.reason for outcome in series.outcomes.values()) else 0


def _configured_dem(config: RigConfig, path: Path) -> DemChoice:
    """The DEM that ``rig run`` searches."""
    if config.run is None:
        raise click.UsageError(
            "--locate: say where with --dem FILE; there is no [run] dem in the configuration."
        )
    from rig.daemon.named_files import check_dem

    check_dem(config.run, path)
    return config.run.chosen_dem


def _directions(names: str | None) -> list[Direction]:
    """The directions of the option; none where it is not given."""
    if names is None:
        return []
    try:
        return parse_directions(names.split(","))
    except ValueError as error:
        raise click.UsageError(f"--directions: {error}.") from error
