"""``rig bundle``: commands on existing bundles."""

import json
from pathlib import Path

import click

from localizer.bundle import load_bundle
from localizer.commands.command_line import OutputFolder
from rig.bundle.summary import bundle_summary
from rig.commands.bundle_export import export, import_
from rig.commands.bundle_inspect import json_option, list_, show, verify
from rig.commands.options import config_option


@click.group()
def bundle() -> None:
    """Commands on existing bundles.

    Example: rig bundle recalibrate bundles/20261124T060000Z-3f9a
    """


@bundle.command()
@click.argument("directory", metavar="DIR", type=click.Path(path_type=Path, file_okay=False))
@config_option
@click.option(
    "--calibration",
    "files",
    metavar="FILE",
    type=click.Path(path_type=Path),
    multiple=True,
    help="A file of rig calibrate; by default all that the configuration names. Repeat it for several.",
)
@click.option(
    "--out",
    "out_dir",
    metavar="DIR",
    type=OutputFolder(),
    help="Where the new bundle goes; by default beside the old one.",
)
@json_option
def recalibrate(
    directory: Path, config_file: Path | None, files: tuple[Path, ...], out_dir: Path | None, as_json: bool
) -> None:
    """Recompute a bundle from the raw readings of an old one, with better calibrations; the old one stays.

    \b
    Examples:
      rig bundle recalibrate bundles/20261124T060000Z-3f9a
      rig bundle recalibrate bundles/20261124T060000Z-3f9a --calibration calibration/boresight-20261124T090000Z-77c1.json
    """
    from rig.calibrate.recalibrate import recalibrate as recalibrate_bundle
    from rig.config.calibration_files import read_calibration
    from rig.config.load import config_path, load_config

    if files:
        calibrations = [read_calibration(file) for file in files]
    else:
        file = config_path(config_file)
        calibrations = list(load_config(file).calibrations)
        if not calibrations:
            raise click.UsageError(f"{file} names no calibration; give --calibration FILE.")
    path = recalibrate_bundle(directory, calibrations, out_dir or directory.resolve().parent)
    click.echo(f"with {', '.join(each.document.id for each in calibrations)}", err=True)
    click.echo(json.dumps(bundle_summary(load_bundle(path))) if as_json else path)


for _command in (list_, show, verify, export, import_):
    bundle.add_command(_command)
