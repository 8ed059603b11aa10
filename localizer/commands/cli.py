"""The command ``localizer``."""

import datetime
import json
from pathlib import Path
from typing import NoReturn

import click

from localizer.bundle import frame_image, load_bundle
from localizer.commands import command_line
from localizer.commands.command_line import OutputFolder
from localizer.commands.completion import completion_command, folders
from localizer.commands.dem_options import dem_choice, dem_error_option, dem_files_argument, dem_option
from localizer.commands.predict import predict
from localizer.dem.choice import DemChoice
from localizer.dem.info import dem_info, info_fields, info_text
from localizer.output_files import check_picture_path, writing
from localizer.show.output_parts import OutputParts
from localizer.show.text import fix_text, notes
from localizer.truth import load_truth


def main() -> NoReturn:
    """Entry point of the program."""
    command_line.run(localizer, "localizer")


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@command_line.version_option("localizer")
def localizer() -> None:
    """Find out where pictures of the horizon were taken.

    Example: localizer locate bundles/20261123T043151Z-3f9a --dem terrain.tif
    """


@localizer.command()
@click.argument("bundle_path", metavar="BUNDLE", type=click.Path(path_type=Path), shell_complete=folders)
@dem_option
@click.option("--json", "as_json", is_flag=True, help="Print the fix as one JSON object (skyfix.fix/1).")
@click.option(
    "--plot",
    "plot_path",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="Draw the frames, the map and the fix (.png, .svg, .pdf).",
)
@click.option(
    "--report",
    "report_folder",
    metavar="DIR",
    type=OutputFolder(),
    help="Write a page with all about the result, a raster of probabilities and the places as GeoJSON, GPX and KML "
    "into this folder.",
)
@click.option(
    "--truth",
    "truth_path",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="JSON file with the true place, to compare with; the search does not see it.",
)
@dem_error_option
@dem_choice
def locate(
    bundle_path: Path,
    chosen_dem: DemChoice,
    as_json: bool,
    plot_path: Path | None,
    report_folder: Path | None,
    truth_path: Path | None,
) -> int:
    """Find the place in the DEM from which the frames of BUNDLE were taken.

    Ends with status 0 if one place stands out, 3 if several do, 4 if the frames fit no place, and 2 if the input
    is bad. With 1 where the result is printed but a file that was asked for could not be made: it is named, all
    others are written.

    Example: localizer locate bundles/20261123T043151Z-3f9a --dem terrain.tif --report report
    """
    if plot_path is not None:
        check_picture_path("--plot", plot_path)
    truth = load_truth(truth_path) if truth_path is not None else None
    bundle = load_bundle(bundle_path)
    dem = chosen_dem.load_to_search("localizer")

    if report_folder is not None:
        from localizer.show.report_folder import prepare_folder

        prepare_folder(report_folder)

    from localizer.search.locate import locate_bundle  # slow to import, and bad input should be told at once

    result = locate_bundle(bundle, dem)
    for note in notes(result, bundle, dem):
        click.echo(f"localizer: {note}", err=True)
    click.echo(result.fix.to_json() if as_json else fix_text(result.fix, dem, truth))
    if plot_path is not None or report_folder is not None:
        images = {frame.label: frame_image(bundle, frame) for frame in bundle.frames}
    parts = OutputParts()
    if plot_path is not None:
        from localizer.show.plot import draw_fix

        with parts.part(f"--plot: {plot_path}"), writing("--plot", plot_path):
            draw_fix(plot_path, images, result, dem, truth)
    if report_folder is not None:
        from localizer.show.report_folder import write_report

        with parts.part(f"--report: {report_folder}"):
            write_report(report_folder, bundle, images, result, dem, truth)
    parts.end()
    return result.fix.exit_status


@localizer.command()
@click.argument(
    "bundle_paths",
    metavar="BUNDLE...",
    nargs=-1,
    required=True,
    type=click.Path(path_type=Path),
    shell_complete=folders,
)
@dem_option
@click.option(
    "--odometry",
    "odometry_path",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="How the vehicle moved from each bundle to the next (JSON Lines, see above); unknown without it.",
)
@click.option("--json", "as_json", is_flag=True, help="Print a JSON object for each bundle (skyfix.track/1).")
@click.option(
    "--plot",
    "plot_path",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="Draw the hypotheses and the way (.png, .svg, .pdf).",
)
@click.option(
    "--truth",
    "truth_paths",
    metavar="FILE",
    type=click.Path(path_type=Path),
    multiple=True,
    help="JSON file with a true place, once for each bundle, to compare with; the search does not see it.",
)
@dem_error_option
@dem_choice
def track(
    bundle_paths: tuple[Path, ...],
    chosen_dem: DemChoice,
    odometry_path: Path | None,
    as_json: bool,
    plot_path: Path | None,
    truth_paths: tuple[Path, ...],
) -> int:
    """Follow a vehicle through bundles in the order given, and keep every place that is possible until one remains.

    Once that is known, the next bundle is searched for near there, and in the whole DEM if it does not fit there.
    Ends with the status of the last bundle's fix: 0 fix, 3 ambiguous, 4 none; 2 if the input is bad.

    The odometry has a line for each leg between two bundles, one of

    \b
      {"distance_m": 200, "distance_sigma_m": 4, "heading_deg": 90, "heading_sigma_deg": 2}
      {"east_m": 200, "north_m": 0, "sigma_m": 5}
      {"east_m": 200, "north_m": 0, "covariance_m2": [[25, 0], [0, 16]]}
      {"unknown": true}

    where headings, east and north are true, distances horizontal, and sigmas one standard deviation.

    Example: localizer track bundles/* --dem terrain.tif --odometry legs.jsonl --plot track.png
    """
    if plot_path is not None:
        check_picture_path("--plot", plot_path)
    truths = [load_truth(path) for path in truth_paths]

    from localizer.commands.track import run_track

    dem = chosen_dem.load_to_search("localizer")
    return run_track(bundle_paths, dem, odometry_path, as_json, plot_path, truths)


localizer.add_command(predict)
localizer.add_command(completion_command("localizer"))


@localizer.group()
def dem() -> None:
    """Look at elevation models.

    Example: localizer dem info N44W072.hgt
    """


@dem.command()
@dem_files_argument
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
@click.option(
    "--date",
    type=click.DateTime(["%Y-%m-%d"]),
    help="Date of the magnetic declination; today unless given.",
)
@dem_choice
def info(
    chosen_dem: DemChoice,
    as_json: bool,
    date: datetime.datetime | None,
) -> None:
    """Say what is in an elevation model: grid, CRS, extent, elevations, voids, units and norths.

    Several files are taken as one.

    Example: localizer dem info N44W072.hgt N44W073.hgt
    """
    model = chosen_dem.load()
    facts = dem_info(model, date.date() if date else datetime.datetime.now(datetime.UTC).date())
    click.echo(json.dumps(info_fields(model, facts)) if as_json else info_text(model, facts))
