"""The ``sim`` command: a simulated rig over real terrain."""

import json
import signal
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn, ParamSpec, TypeVar

import click

from localizer.commands import command_line
from localizer.commands.command_line import FiniteRange, OutputFolder
from localizer.commands.completion import completion_command
from localizer.output_files import prepare_folder
from sim.commands.drive import drive
from sim.commands.evaluate import evaluate
from sim.commands.failures import one_line_failures
from sim.commands.options import EMBEDDED_DEM, dem_option
from sim.commands.replay import replay
from sim.commands.rigs import rigs
from sim.commands.sensitivity import sensitivity
from sim.errors import SimulationError
from sim.launch.child_command import find_command, run_command

if TYPE_CHECKING:
    from sim.world.truth import World


P = ParamSpec("P")
T = TypeVar("T")

# Rendering modules are slow to import; commands import them, so that --help and usage errors are fast.


def main() -> NoReturn:
    """Entry point of the ``sim`` script."""
    # SIGTERM shuts the fake devices down, as Ctrl-C does.
    signal.signal(signal.SIGTERM, lambda number, _frame: sys.exit(128 + number))
    command_line.run(sim, "sim")


_seed_option = click.option(
    "--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Another seed, another world."
)


def _world_options(function: Callable[P, T]) -> Callable[P, T]:
    """The options that select the simulated world."""
    for option in (
        click.option(
            "--scenario",
            "scenario_path",
            type=click.Path(path_type=Path),
            metavar="FILE",
            help="Sizes of the error sources and the devices that are fitted: a TOML file, or default, ideal or uncalibrated.",
        ),
        _seed_option,
        dem_option,
    ):
        function = option(function)
    return function


def _make_world(dem_paths: Sequence[Path], seed: int, scenario_path: Path | None) -> "World":
    from sim.world.scenario import load_scenario
    from sim.world.truth import World

    return World.create(_dems(dem_paths), load_scenario(scenario_path), seed)


def _dems(dem_paths: Sequence[Path]) -> list[Path]:
    return list(dem_paths) or [EMBEDDED_DEM]


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@command_line.version_option("sim")
def sim() -> None:
    """A simulated rig over real terrain.

    Example: sim run --seed 7 -- rig capture --out bundles
    """


@sim.command("run")
@_world_options
@click.option(
    "--faults",
    "faults_path",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="TOML or JSON script of what goes wrong when (docs/faults.md).",
)
@click.argument("command", metavar="-- COMMAND...", nargs=-1, required=True, type=click.UNPROCESSED)
@one_line_failures
def run_(
    dem_paths: tuple[Path, ...],
    seed: int,
    scenario_path: Path | None,
    faults_path: Path | None,
    command: tuple[str, ...],
) -> int:
    """Run COMMAND with a simulated rig.

    COMMAND gets the rig's configuration in SKYFIX_CONFIG and, for tests only, the truth in SKYFIX_TRUTH. The exit
    status is COMMAND's.

    \b
    Examples:
      sim run --seed 7 -- rig capture --out bundles
      sim run --faults faults.toml -- rig capture
    """
    find_command(command[0])
    from sim.faults.script import load_faults

    faults = load_faults(faults_path) if faults_path else ()
    world = _make_world(dem_paths, seed, scenario_path)

    from sim.launch.launcher import simulated_rig

    def say(what: str) -> None:
        click.echo(f"sim: {what}", err=True)

    with simulated_rig(world, faults=faults, say=say, dem_paths=_dems(dem_paths)) as rig:
        return run_command(command, rig.environment, rig.stage.command_started)


@sim.command()
@_world_options
@click.option(
    "--out",
    "folder",
    type=OutputFolder(),
    required=True,
    metavar="DIR",
    help="Where the pictures go.",
)
@click.option(
    "--azimuth",
    "azimuths_deg",
    type=FiniteRange(-360.0, 360.0),
    multiple=True,
    default=(0.0, 90.0, 180.0, 270.0),
    show_default=True,
    help="True azimuth to look at, degrees; may be repeated.",
)
@click.option(
    "--tilt",
    "tilt_deg",
    type=FiniteRange(-60.0, 60.0),
    default=4.0,
    show_default=True,
    help="How far to look up, degrees.",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object: the files and the truth.")
@one_line_failures
def render(
    dem_paths: tuple[Path, ...],
    seed: int,
    scenario_path: Path | None,
    folder: Path,
    azimuths_deg: tuple[float, ...],
    tilt_deg: float,
    as_json: bool,
) -> None:
    """Render the camera's view in some directions, the whole panorama on one sheet, and the truth.

    Example: sim render --seed 7 --azimuth 45 --out pictures
    """
    prepare_folder("--out", folder)
    world = _make_world(dem_paths, seed, scenario_path)

    import cv2

    from sim.render.contact_sheet import contact_sheet
    from sim.render.panorama import render_panorama
    from sim.render.renderer import Renderer
    from sim.world.mechanics import camera_in_world

    panorama = render_panorama(world)
    renderer = Renderer(world, panorama)
    pictures = {
        f"azimuth_{azimuth_deg % 360.0:g}.png": renderer.frame(
            camera_in_world(azimuth_deg, tilt_deg, 0.0), world.rng("camera")
        )
        for azimuth_deg in azimuths_deg
    }
    pictures["sheet.png"] = contact_sheet(world, panorama, renderer)
    for name, picture in pictures.items():
        path = folder / name
        if not cv2.imwrite(str(path), picture):
            raise SimulationError(f"{path}: cannot be written; choose another --out")
    truth_path = folder / "truth.json"
    truth_path.write_text(json.dumps(world.truth_json(), indent=2), encoding="utf-8")
    files = [*(str(folder / name) for name in pictures), str(truth_path)]
    click.echo(json.dumps({"files": files, "truth": world.truth_json()}) if as_json else "\n".join(files))


@sim.command()
@_world_options
@click.option(
    "--out",
    "folder",
    type=OutputFolder(),
    default=Path("demo"),
    show_default=True,
    metavar="DIR",
    help="Where bundle, fix and picture go.",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object: the fix, the truth, the error.")
@one_line_failures
def demo(
    dem_paths: tuple[Path, ...], seed: int, scenario_path: Path | None, folder: Path, as_json: bool
) -> int:
    """Capture with a simulated rig at a drawn place on the terrain, and locate it.

    Ends with 0 if the answer is consistent (a fix within its stated uncertainty, ambiguous, none) and 5 for a wrong
    fix.

    Example: sim demo --seed 7 --out demo
    """
    prepare_folder("--out", folder)
    world = _make_world(dem_paths, seed, scenario_path)

    from sim.commands.demo import demo

    return demo(world, _dems(dem_paths), folder, as_json)


@sim.command()
@dem_option
@_seed_option
@click.option(
    "--doubt",
    is_flag=True,
    help="Doubt the DEM as that of a real place, above all close by; the paper takes it for the terrain itself.",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
@one_line_failures
def paper(dem_paths: tuple[Path, ...], seed: int, doubt: bool, as_json: bool) -> None:
    """Repeat the paper's Table I at contour level: nine places, noise-free and with sigma = 5 px.

    Example: sim paper --json
    """
    from sim.paper.experiment import repeat_table_i
    from sim.paper.table import print_table, to_json

    rows = repeat_table_i(
        _dems(dem_paths),
        not dem_paths,
        seed,
        doubt,
        lambda number, row: click.echo(f"place {number + 1} of 9: {row.status_noise_free}", err=True),
    )
    if as_json:
        click.echo(to_json(rows))
    else:
        print_table(rows)


sim.add_command(evaluate)
sim.add_command(sensitivity)
sim.add_command(completion_command("sim"))
sim.add_command(rigs)
sim.add_command(replay)
sim.add_command(drive)
