"""The command ``sim replay``."""

from pathlib import Path

import click

from sim.command import find_command, run_command
from sim.failures import one_line_failures


@click.command()
@click.argument("log", type=click.Path(path_type=Path))
@click.argument("command", metavar="-- COMMAND...", nargs=-1, required=True, type=click.UNPROCESSED)
@one_line_failures
def replay(log: Path, command: tuple[str, ...]) -> int:
    """Run COMMAND with the devices that rig record logged: each says again what it said then.

    COMMAND finds the configuration of then, pointed at the played-back devices, in SKYFIX_CONFIG. The camera, which no log
    holds, is grey. The exit status is COMMAND's.

    Example: sim replay field.log -- rig check
    """
    from sim.replay import replayed

    find_command(command[0])
    with replayed(log) as config_path:
        return run_command(command, {"SKYFIX_CONFIG": str(config_path)})
