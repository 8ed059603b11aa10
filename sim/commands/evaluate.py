"""``sim evaluate``: measures the localizer's accuracy and reliability on many cases."""

from pathlib import Path
from typing import Literal

import click
from click.core import ParameterSource

from localizer.commands.command_line import OutputFolder, dem_files_option
from localizer.output_files import prepare_folder
from sim.commands.failures import one_line_failures

# Modules that make and locate cases are slow to import; commands import them, so that --help is fast.


@click.command()
@dem_files_option("Elevation raster; the cases are spread evenly over those given.")
@click.option(
    "--scenario",
    "scenario_path",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="TOML file with the errors that are drawn, or one that comes with skyfix: evaluate/realistic, evaluate/cloud ...",
)
@click.option(
    "--out",
    "folder",
    type=OutputFolder(),
    metavar="DIR",
    help="Where table, summary and plots go; a table that is there already is continued.",
)
@click.option(
    "--cases",
    type=click.IntRange(min=1),
    default=100,
    show_default=True,
    metavar="N",
    help="How many cases to make.",
)
@click.option("--only", type=click.IntRange(min=0), multiple=True, metavar="CASE", help="Just this case.")
@click.option(
    "--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Another seed, other cases."
)
@click.option(
    "--level",
    type=click.Choice(["contour", "image"]),
    default="contour",
    show_default=True,
    help="Start from contours, or render pictures and let the localizer find them.",
)
@click.option(
    "--estimator-only",
    is_flag=True,
    help="Take the contours from the very surface that is searched, so that only the estimator errs, and tell it so.",
)
@click.option(
    "--jobs", type=click.IntRange(1, 256), default=1, show_default=True, help="Processes side by side."
)
@click.option(
    "--photos",
    "photos_dir",
    type=click.Path(path_type=Path, file_okay=False),
    metavar="DIR",
    help="Instead of simulated cases: the photographs and rendered pictures in this data folder.",
)
@click.option("--fresh", is_flag=True, help="Begin anew where there is a table already.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object instead of the tables.")
@one_line_failures
def evaluate(
    dem_paths: tuple[Path, ...],
    scenario_path: Path | None,
    folder: Path | None,
    cases: int,
    only: tuple[int, ...],
    seed: int,
    level: Literal["contour", "image"],
    estimator_only: bool,
    jobs: int,
    photos_dir: Path | None,
    fresh: bool,
    as_json: bool,
) -> int:
    """Make many cases, locate each, and compute summary statistics.

    Writes cases.csv, summary.json, summary.md and plots. The same seed makes the same cases for any number of jobs; an
    interrupted run can be resumed.

    With --photos: evaluates skylines in real photographs, and positions from them; --out is optional. Ends with 5 if a
    wrong place got a fix.

    Example: sim evaluate --dem dem.tif --scenario evaluate/realistic --cases 200 --out results
    """
    if photos_dir is not None:
        _refuse_what_is_of_cases()
        from sim.commands.photos import photos_command

        return photos_command(photos_dir, folder, as_json)
    if not dem_paths or scenario_path is None or folder is None:
        raise click.UsageError("give --dem, --scenario and --out, or --photos")

    from sim.evaluate.case import Experiment
    from sim.evaluate.image_level import refuse_contour_faults
    from sim.evaluate.progress import case_progress
    from sim.evaluate.run import run_cases
    from sim.evaluate.scenario import load_evaluation_scenario
    from sim.evaluate.summary_files import write_summary

    scenario = load_evaluation_scenario(scenario_path)
    if level == "image":
        if estimator_only:
            raise click.UsageError("--estimator-only has no pictures; leave --level image away.")
        refuse_contour_faults(scenario)
    experiment = Experiment(dem_paths, scenario, seed, level, estimator_only)
    prepare_folder("--out", folder)
    numbers = sorted(set(only)) or list(range(cases))
    with case_progress(len(numbers)) as report:
        rows = run_cases(experiment, numbers, folder / "cases.csv", jobs, fresh, report)
    text = write_summary(rows, scenario_path.stem, folder)
    click.echo((folder / "summary.json").read_text(encoding="utf-8").strip() if as_json else text)
    return 0


def _refuse_what_is_of_cases() -> None:
    """Reject options that do not apply to photographs."""
    context = click.get_current_context()
    for parameter in context.command.params:
        name = parameter.name or ""
        given = context.get_parameter_source(name) is ParameterSource.COMMANDLINE
        if given and name not in ("photos_dir", "folder", "as_json"):
            raise click.UsageError(
                f"--photos goes with --out and --json alone; leave {parameter.opts[0]} away."
            )
