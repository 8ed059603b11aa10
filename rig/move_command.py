"""The command ``rig move``."""

import json
from pathlib import Path

import click

from rig.cli_options import config_option
from rig.config import config_path, load_config
from rig.signals import stopping_cleanly


@click.command(context_settings={"ignore_unknown_options": True})
@config_option
@click.argument("pan_deg", metavar="PAN", type=float, required=False)
@click.argument("tilt_deg", metavar="TILT", type=float, required=False)
@click.option("--park", is_flag=True, help="Go to [pan_tilt] park_pan_deg and park_tilt_deg.")
@click.option("--relax", is_flag=True, help="Go nowhere: only switch the torque off.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def move(
    config_file: Path | None,
    pan_deg: float | None,
    tilt_deg: float | None,
    park: bool,
    relax: bool,
    as_json: bool,
) -> None:
    """Turn the head to joint angles PAN (clockwise) and TILT (up), degrees, and let go there.

    A goal beyond the limits or in a keep-out zone is refused before anything moves; a way through a zone is gone round.
    Prints where the head stands. The torque is off afterwards.

    \b
    Examples:
      rig move 45 -10
      rig move --park
      rig move --relax
    """
    angles = pan_deg is not None and tilt_deg is not None
    if [angles or pan_deg is not None, park, relax].count(True) != 1 or (pan_deg is not None and not angles):
        raise click.UsageError("Give PAN and TILT, or --park, or --relax.")
    section = load_config(config_path(config_file)).pan_tilt

    from rig.connect import open_pan_tilt

    with stopping_cleanly(), open_pan_tilt(section) as head:
        if pan_deg is not None and tilt_deg is not None:
            state = head.go_to(pan_deg, tilt_deg)
        elif park:
            state = head.go_to(section.park_pan_deg, section.park_tilt_deg)
        else:
            head.relax()
            state = head.state()
    if as_json:
        click.echo(
            json.dumps({"pan_deg": state.pan_deg, "tilt_deg": state.tilt_deg, "ticks": list(state.ticks)})
        )
    else:
        click.echo(f"pan {state.pan_deg:.2f}, tilt {state.tilt_deg:.2f} deg, torque off")
