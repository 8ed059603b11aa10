"""The command ``rig move``."""

import json
from pathlib import Path
from typing import Any

import click

from localizer.commands.command_line import FiniteRange, NumbersCommand
from rig.commands.options import config_option
from rig.commands.signals import stopping_cleanly
from rig.config.load import config_path, load_config
from rig.config.model import RigConfig
from rig.config.sections import PanTiltSection
from rig.errors import GoalError


@click.command(cls=NumbersCommand)
@config_option
@click.argument("pan_deg", metavar="PAN", type=float, required=False)
@click.argument("tilt_deg", metavar="TILT", type=float, required=False)
@click.option(
    "--azimuth", "azimuth_deg", metavar="A", type=float, help="Have the camera look there, degrees true."
)
@click.option(
    "--tilt",
    "camera_tilt_deg",
    metavar="T",
    type=FiniteRange(-90.0, 90.0),
    help="With --azimuth: how far above the horizon the camera looks; 0 unless given.",
)
@click.option("--park", is_flag=True, help="Go to [pan_tilt] park_pan_deg and park_tilt_deg.")
@click.option(
    "--relax",
    is_flag=True,
    help="Only switch the torque off; with a goal, as without --relax, once it is reached.",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def move(
    config_file: Path | None,
    pan_deg: float | None,
    tilt_deg: float | None,
    azimuth_deg: float | None,
    camera_tilt_deg: float | None,
    park: bool,
    relax: bool,
    as_json: bool,
) -> None:
    """Move the head to joint angles PAN (clockwise) and TILT (up), or the camera to a true azimuth, and switch the
    torque off there.

    With --azimuth the head first turns to measure level and heading, as for a capture. A goal beyond the limits or in a
    keep-out zone is refused before anything moves; a path through a zone is routed around it. Prints the head's
    position, and with --azimuth the camera's attitude. The torque is off afterwards.

    \b
    Examples:
      rig move 45 -10
      rig move --azimuth 45 --tilt 3
      rig move --park
      rig move --relax
    """
    joints = pan_deg is not None and tilt_deg is not None
    goals = [pan_deg is not None, azimuth_deg is not None, park]
    if goals.count(True) > 1 or not (any(goals) or relax) or (pan_deg is not None and not joints):
        raise click.UsageError("Give PAN and TILT, or --azimuth, or --park, or --relax.")
    if camera_tilt_deg is not None and azimuth_deg is None:
        raise click.UsageError("--tilt goes with --azimuth.")
    config = load_config(config_path(config_file))
    with stopping_cleanly():
        if azimuth_deg is not None:
            found = _look_at(config, azimuth_deg, camera_tilt_deg or 0.0)
        else:
            goal = (pan_deg, tilt_deg) if pan_deg is not None and tilt_deg is not None else None
            found = _turn(config.pan_tilt, goal, park)
    if as_json:
        click.echo(json.dumps(found))
        return
    looks = ""
    if azimuth_deg is not None:
        looks = (
            f"azimuth {found['azimuth_deg']:.2f} +- {found['azimuth_sigma_deg']:.2f}, "
            f"tilt {found['camera_tilt_deg']:z.2f}, roll {found['camera_roll_deg']:z.2f} deg; joints: "
        )
    click.echo(f"{looks}pan {found['pan_deg']:z.2f}, tilt {found['tilt_deg']:z.2f} deg, torque off")


def _turn(section: PanTiltSection, goal_deg: tuple[float, float] | None, park: bool) -> dict[str, Any]:
    """Head position after a move by joint angles, or after switching the torque off if there is no goal."""
    from rig.devices.connect import open_pan_tilt

    with open_pan_tilt(section) as head:
        if goal_deg is not None:
            state = head.go_to(*goal_deg)
        elif park:
            state = head.go_to(section.park_pan_deg, section.park_tilt_deg)
        else:
            head.relax()
            state = head.state()
    return {"pan_deg": state.pan_deg, "tilt_deg": state.tilt_deg, "ticks": list(state.ticks)}


def _look_at(config: RigConfig, azimuth_deg: float, tilt_deg: float) -> dict[str, Any]:
    """Head and camera attitude after turning the camera to a true azimuth and a tilt."""
    from rig.attitude.kinematics import Head, JointAngles, joints_for
    from rig.capture import derive
    from rig.capture.averaged_readings import still_level
    from rig.capture.base_attitude import measure_base
    from rig.devices.connect import connect

    if config.compass is None:
        raise GoalError("--azimuth: the configuration has no [compass]; give joint angles, PAN and TILT")
    head = Head.from_config(config)
    with connect(config) as rig:
        base_estimate = measure_base(rig)
        joints = joints_for(azimuth_deg, tilt_deg, base_estimate.attitude, head)
        state = rig.pan_tilt.go_to(joints.pan_deg, joints.tilt_deg)
        level, _ = still_level(rig, config.inclinometer.average_s)
    looks = derive.pointing(base_estimate, JointAngles(state.pan_deg, state.tilt_deg), level, head)
    return {
        "pan_deg": state.pan_deg,
        "tilt_deg": state.tilt_deg,
        "ticks": list(state.ticks),
        "azimuth_deg": looks.azimuth_deg,
        "azimuth_sigma_deg": derive.azimuth_bias_sigma_deg(config, base_estimate),
        "camera_tilt_deg": looks.tilt_deg,
        "camera_roll_deg": looks.roll_deg,
    }
