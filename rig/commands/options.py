"""Options shared by commands of ``rig``."""

from pathlib import Path

import click

from localizer.commands.completion import folders as complete_folders

config_option = click.option(
    "--config",
    "config_file",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="The rig's configuration; by default the file that SKYFIX_CONFIG names.",
)

folders_argument = click.argument(
    "folders",
    metavar="DIR...",
    nargs=-1,
    required=True,
    type=click.Path(path_type=Path),
    shell_complete=complete_folders,
)
