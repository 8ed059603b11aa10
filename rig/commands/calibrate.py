"""``rig calibrate``: the group of calibration commands."""

import click

from rig.commands.calibrate_camera import board, camera
from rig.commands.calibrate_place import boresight, sites
from rig.commands.calibrate_sensors import altimeter, compass, inclinometer, temperature_log_


@click.group()
def calibrate() -> None:
    """Find the rig's own errors, in this order: camera, inclinometer, compass, altimeter, boresight.

    Each writes a dated file that the configuration names from then on, and a picture of its residuals beside it.

    Example: rig calibrate inclinometer --config vehicle.toml
    """


for command in (camera, board, inclinometer, temperature_log_, compass, altimeter, boresight, sites):
    calibrate.add_command(command)
