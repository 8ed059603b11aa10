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
    """Run COMMAND with the devices of a log of rig record; each repeats what it sent.

    COMMAND gets the recorded configuration, adapted to the played-back devices, in SKYFIX_CONFIG. The camera is grey,
    as pictures are not logged, and the clock is the recorded one. Requests that the log cannot answer are reported at
    the end. The exit status is COMMAND's.

    Example: sim replay field.log -- rig check
    """
    from sim.replay.playback import replaying

    find_command(command[0])
    with replaying(log) as played:
        status = run_command(command, played.environment)
        for line in played.notes.lines(failed=status != 0):
            click.echo(f"sim: {line}", err=True)
    return status
