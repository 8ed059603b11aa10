"""``rig calibrate camera``, and ``rig calibrate board``, which draws its calibration target."""

import json
from pathlib import Path

import click

from rig.commands.calibrate_options import (
    CommonOptions,
    calibration_run_options,
    json_option,
    target_of,
    target_option,
)


@click.command()
@calibration_run_options
@target_option
@click.option(
    "--images", metavar="GLOB", help="Pictures of the board instead of the live camera; quote the pattern."
)
@click.option("--views", type=click.IntRange(10, 200), default=25, show_default=True, help="To take live.")
def camera(common: CommonOptions, board_text: str, images: str | None, views: int) -> None:
    """Calibrate intrinsics and distortion of the camera from views of a calibration target (see rig calibrate board).

    \b
    Examples:
      rig calibrate camera
      rig calibrate camera --images "shots/*.png" --board chessboard:9x6:25
    """
    from rig.calibrate.camera.procedure import calibrate_camera

    known_board = target_of(board_text)
    with common.calibration_run() as calibration_run:
        calibrate_camera(calibration_run, known_board, images, views)


@click.command()
@target_option
@click.option(
    "--out", "path", metavar="FILE", type=click.Path(path_type=Path), required=True, help="PNG to write."
)
@json_option
def board(board_text: str, path: Path, as_json: bool) -> None:
    """Draw the calibration target for printing: 300 dots per inch, true size. Glue it to something flat and measure a
    square.

    Example: rig calibrate board --out board.png
    """
    from rig.calibrate.camera.target import print_target

    target_of(board_text)
    print_target(board_text, path)
    click.echo(json.dumps({"file": str(path), "board": board_text}) if as_json else path)
