"""``rig calibrate``: the group of calibration commands."""

import click

from rig.commands.calibrate_camera import board, camera
from rig.commands.calibrate_place import boresight, sites
from rig.commands.calibrate_sensors import altimeter, compass, inclinometer, temperature_log_


@click.group()
def calibrate() -> None:
    """Calibrate the rig, in this order: camera, inclinometer, compass, altimeter, boresight.

    Each writes a dated file, which the configuration then names, and a plot of its residuals.

    Example: rig calibrate inclinometer --config vehicle.toml
    """


for command in (camera, board, inclinometer, temperature_log_, compass, altimeter, boresight, sites):
    calibrate.add_command(command)
