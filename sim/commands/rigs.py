"""The command ``sim rigs``: calibrates uncalibrated simulated rigs and reports the remaining errors of their bundles."""

import json
import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import click

from localizer.commands.command_line import OutputFolder
from sim.commands.failures import one_line_failures
from sim.commands.options import EMBEDDED_DEM, dem_option
from sim.shipped_files import SCENARIOS

if TYPE_CHECKING:
    from sim.rigs.calibration_trial import RigResult

UNCALIBRATED = SCENARIOS / "uncalibrated.toml"
OUTSIDE = 5


@click.command()
@click.option(
    "--rigs",
    "count",
    type=click.IntRange(1),
    default=20,
    show_default=True,
    help="How many rigs to calibrate.",
)
@click.option(
    "--seed", type=click.IntRange(0), default=1, show_default=True, help="Of the first; the others follow."
)
@click.option(
    "--jobs", type=click.IntRange(1), default=2, show_default=True, help="Rigs at a time; they mostly wait."
)
@click.option(
    "--scenario",
    "scenario_path",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Sizes of the errors: a file, or a scenario that comes with skyfix; by default uncalibrated.",
)
@dem_option
@click.option(
    "--csv",
    "csv_path",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Write a row for each rig as it is done.",
)
@click.option("--keep", type=OutputFolder(), metavar="DIR", help="Keep calibrations, pictures and bundles.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object instead of the table.")
@one_line_failures
def rigs(
    count: int,
    seed: int,
    jobs: int,
    scenario_path: Path | None,
    dem_paths: tuple[Path, ...],
    csv_path: Path | None,
    keep: Path | None,
    as_json: bool,
) -> int:
    """Calibrate simulated rigs with large unknown mounting errors, and judge the bundles that they then take.

    A scripted operator does what rig calibrate asks for. Ends with 0 if all errors are within their limits, else 5.

    Example: sim rigs --rigs 20 --csv rigs.csv
    """
    from sim.rigs.calibration_trial import calibrate_rigs, write_csv
    from sim.world.scenario import load_scenario

    so_far: list[RigResult] = []

    def on_result(result: "RigResult") -> None:
        so_far.append(result)
        click.echo(one_line(result), err=True)
        if csv_path is not None:
            write_csv(so_far, csv_path)

    results = calibrate_rigs(
        dem_paths or (EMBEDDED_DEM,),
        load_scenario(scenario_path or UNCALIBRATED),
        range(seed, seed + count),
        jobs,
        on_result,
        keep,
    )
    if as_json:
        click.echo(to_json(results))
    else:
        print_table(results)
    return 0 if all(result.within for result in results) else OUTSIDE


def one_line(result: "RigResult") -> str:
    """The remaining errors in the bundles of one rig, or why there are none."""
    from sim.rigs.calibration_trial import LIMITS

    errors = ", ".join(f"{name} {getattr(result, name):.3f}" for name in LIMITS)
    return f"rig {result.seed}: {result.refused or errors}"


def to_json(results: Sequence["RigResult"]) -> str:
    """All rigs, and the limits of their errors; null for what was not measured."""
    from sim.rigs.calibration_trial import LIMITS

    rows = [
        {
            **{
                name: None if isinstance(value, float) and math.isnan(value) else value
                for name, value in asdict(result).items()
            },
            "within": result.within,
        }
        for result in results
    ]
    return json.dumps({"limits": LIMITS, "rigs": rows})


def print_table(results: Sequence["RigResult"]) -> None:
    """One row per rig, and below the errors against their limits."""
    import numpy as np
    from rich.console import Console
    from rich.table import Table

    from sim.rigs.calibration_trial import LIMITS

    names = {
        "tilt_deg": "tilt",
        "roll_deg": "roll",
        "relative_azimuth_deg": "rel. azimuth",
        "azimuth_by_compass_deg": "az. by compass",
        "azimuth_by_boresight_deg": "by boresight",
        "altitude_m": "altitude, m",
    }
    table = Table(
        "rig", "mounted (azimuth, tilt, roll)", *names.values(), "", title="Errors of bundles, degrees"
    )
    for r in results:
        mounted = f"{r.boresight_azimuth_deg:.1f}, {r.boresight_tilt_deg:.1f}, {r.boresight_roll_deg:.1f}"
        errors = [f"{getattr(r, name):.3f}" for name in names]
        table.add_row(str(r.seed), mounted, *errors, "" if r.within else (r.refused[:40] or "outside"))
    kept = [r for r in results if not r.refused]
    if kept:
        errors_of = {name: np.array([getattr(r, name) for r in kept]) for name in names}
        table.add_row("rms", "", *(f"{np.sqrt(np.mean(e**2)):.3f}" for e in errors_of.values()), "")
        table.add_row("largest", "", *(f"{np.abs(e).max():.3f}" for e in errors_of.values()), "")
    table.add_row("limit", "", *(f"{LIMITS[name]:g}" for name in names), "")
    within = [f"{sum(abs(getattr(r, n)) <= LIMITS[n] for r in results)} of {len(results)}" for n in names]
    table.add_row("within", "", *within, "")
    console = Console()
    (console if console.is_terminal else Console(width=140)).print(table)
