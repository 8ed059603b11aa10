"""The commands ``rig service``."""

import json
from dataclasses import asdict
from pathlib import Path

import click

from localizer.commands.command_line import OutputFolder

root_option = click.option(
    "--root",
    metavar="DIR",
    default=Path("/"),
    type=OutputFolder(),
    help="Treat DIR as the root of the machine: files only, nothing is started or stopped.",
)
dry_run_option = click.option("--dry-run", is_flag=True, help="Only say what would be done.")


@click.group()
def service() -> None:
    """Install skyfix as a systemd service of the vehicle.

    Example: sudo /opt/skyfix/bin/rig service install
    """


@service.command()
@root_option
@dry_run_option
@click.option("--force", is_flag=True, help="Replace files that have been changed by hand too.")
def install(root: Path, dry_run: bool, force: bool) -> None:
    """Install unit, udev rules, user and folders for the installation that this program belongs to.

    Running it again updates the files if necessary. It starts nothing, and ends with the next steps.

    Example: sudo /opt/skyfix/bin/rig service install --dry-run
    """
    from rig.service.install import install as put

    put(root.absolute(), dry_run=dry_run, force=force, say=click.echo)


@service.command()
@root_option
@dry_run_option
def uninstall(root: Path, dry_run: bool) -> int:
    """Stop the service and remove the files of install; configuration, bundles and caches stay.

    Ends with status 1 if an edited file stays.

    Example: sudo /opt/skyfix/bin/rig service uninstall
    """
    from rig.service.install import uninstall as take_away

    return 0 if take_away(root.absolute(), dry_run=dry_run, say=click.echo) else 1


@service.command()
@root_option
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def status(root: Path, as_json: bool) -> int:
    """Show which files are installed, whether the service is enabled and active, and its last fix.

    Ends with status 1 if a file differs, or the service does not run.

    Example: rig service status
    """
    from rig.service.status import service_status, status_text

    root = root.absolute()
    found = service_status(root)
    click.echo(json.dumps(asdict(found)) if as_json else status_text(root, found))
    return 0 if found.good else 1
