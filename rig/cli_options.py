"""Options that several commands of ``rig`` share."""

from pathlib import Path

import click

config_option = click.option(
    "--config",
    "config_file",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="The rig's configuration; by default the file that SKYFIX_CONFIG names.",
)
