"""The command ``rig record``."""

import os
from pathlib import Path

import click

from rig.commands.options import config_option
from rig.config.load import ENVIRONMENT_VARIABLE, config_path, load_config


@click.command(context_settings={"ignore_unknown_options": True, "allow_interspersed_args": False})
@config_option
@click.argument("log", metavar="LOG", type=click.Path(path_type=Path))
@click.argument("command", metavar="COMMAND...", nargs=-1, required=True, type=click.UNPROCESSED)
@click.pass_context
def record(context: click.Context, config_file: Path | None, log: Path, command: tuple[str, ...]) -> int:
    """Run another command of rig and log the raw bytes of every port and bus meanwhile.

    LOG is a new file; sim replay plays it back. --config precedes LOG and applies to COMMAND too; pictures are not
    logged. Ends with the status of COMMAND.

    Example: rig record --config vehicle.toml field.log capture --out bundles
    """
    root = context.find_root()
    program, words = root.command, list(command)
    assert isinstance(program, click.Group)
    if words[0] == root.info_name:
        words = words[1:]
    if not words or program.get_command(root, words[0]) is None:
        raise click.UsageError(f"{(words or command)[0]!r} is no command of rig to record.")
    path = config_path(config_file)
    config = load_config(path)

    from rig.devices.wire_log import recording_wire_log

    os.environ[ENVIRONMENT_VARIABLE] = str(path)
    with recording_wire_log(log, config):
        status = program.main(args=words, prog_name=root.info_name, standalone_mode=False)
    return status if isinstance(status, int) else 0
