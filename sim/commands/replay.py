"""The command ``sim replay``."""

from pathlib import Path

import click

from sim.commands.failures import one_line_failures
from sim.launch.child_command import find_command, run_command


@click.command()
@click.argument("log", type=click.Path(path_type=Path))
@click.argument("command", metavar="-- COMMAND...", nargs=-1, required=True, type=click.UNPROCESSED)
@one_line_failures
def replay(log: Path, command: tuple[str, ...]) -> int:
    """Run COMMAND with the devices that rig record logged: each says again what it said then.

    COMMAND finds the configuration of then, pointed at the played-back devices, in SKYFIX_CONFIG. The camera, which no log
    holds, is grey, and the clock is that of then. What COMMAND asks and the log cannot answer is told at the end. The exit
    status is COMMAND's.

    Example: sim replay field.log -- rig check
    """
    from sim.replay.playback import replaying

    find_command(command[0])
    with replaying(log) as played:
        status = run_command(command, played.environment)
        for line in played.notes.lines(failed=status != 0):
            click.echo(f"sim: {line}", err=True)
    return status
