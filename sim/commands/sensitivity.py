"""``sim sensitivity``: what the tuned constants of the search do to its answers."""

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from localizer.commands.command_line import OutputFolder
from localizer.output_files import prepare_folder
from sim.commands.failures import one_line_failures
from sim.commands.options import EMBEDDED_DEM

if TYPE_CHECKING:
    from sim.evaluate.sensitivity.run import Measured


@click.command()
@click.option(
    "--dem",
    "dem_path",
    type=click.Path(path_type=Path),
    metavar="FILE",
    default=EMBEDDED_DEM,
    help="Elevation raster of the cases. Default: the terrain that comes with skyfix.",
)
@click.option(
    "--scenarios",
    "scenario_folder",
    type=click.Path(path_type=Path),
    metavar="FOLDER",
    default=Path("configs/scenarios/evaluate"),
    show_default=True,
    help="Folder with the scenarios that the cases are drawn from.",
)
@click.option(
    "--out",
    "folder",
    type=OutputFolder(),
    metavar="DIR",
    required=True,
    help="Where sensitivity.md and variants.jsonl go; variants that are there already are not run again.",
)
@click.option("--cases", type=click.IntRange(min=1), default=1, show_default=True, help="Of each scenario.")
@click.option(
    "--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Another seed, other cases."
)
@click.option(
    "--only",
    multiple=True,
    metavar="CONSTANT",
    help="Just this constant, as decide.FIX_EVIDENCE; may be repeated.",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object instead of the table.")
@one_line_failures
def sensitivity(
    dem_path: Path,
    scenario_folder: Path,
    folder: Path,
    cases: int,
    seed: int,
    only: tuple[str, ...],
    as_json: bool,
) -> None:
    """Halve and double each tuned constant of the search and locate the same cases again.

    Each variant is a copy of the localizer with one assignment changed, run in a process of its own. With one case of each
    scenario this takes about half an hour of CPU time. An interrupted run continues where it was.

    Example: sim sensitivity --out results --cases 4
    """
    from sim.errors import SimulationError
    from sim.evaluate.sensitivity.constants import TUNED
    from sim.evaluate.sensitivity.run import SCENARIOS, Plan, measure
    from sim.evaluate.sensitivity.table import as_fields, as_markdown, lines

    unknown = sorted({*only} - {tuned.label for tuned in TUNED})
    if unknown:
        raise click.UsageError(f"--only: {unknown[0]} is no tuned constant; name one as decide.FIX_EVIDENCE.")
    constants = [tuned for tuned in TUNED if not only or tuned.label in only]
    paths = tuple(scenario_folder / f"{name}.toml" for name in SCENARIOS)
    for path in (dem_path, *paths):
        if not path.is_file():
            raise SimulationError(f"{path}: no such file; see --dem and --scenarios")
    prepare_folder("--out", folder)
    plan = Plan(dem_path, paths, cases, seed)

    def written(measured: "dict[str, Measured]") -> str:
        text = as_markdown(
            lines(measured, constants),
            constants,
            plan,
            f"sim sensitivity --out DIR --cases {cases} --seed {seed}",
        )
        (folder / "sensitivity.md").write_text(text, encoding="utf-8")
        return text

    def report(line: str, done: "dict[str, Measured]") -> None:
        click.echo(line, err=True)
        written(done)

    measured = measure(plan, constants, folder / "variants.jsonl", report)
    text = written(measured)
    fields = {"cases": cases, "seed": seed, "variants": as_fields(lines(measured, constants))}
    click.echo(json.dumps(fields) if as_json else text)
