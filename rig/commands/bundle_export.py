"""``rig bundle export`` and ``import``: bundles into one archive file and back."""

import json
from pathlib import Path

import click

from localizer.bundle import BundleError
from localizer.commands.command_line import OutputFolder
from rig.bundle.archive import unpack_archive, write_archive
from rig.commands.bundle_inspect import json_option, loaded
from rig.commands.options import folders_argument
from rig.commands.signals import stopping_cleanly


@click.command()
@folders_argument
@click.option(
    "--out",
    "path",
    metavar="FILE",
    type=click.Path(path_type=Path),
    required=True,
    help="The new archive: .tar, .tar.gz or .zip.",
)
@json_option
def export(folders: tuple[Path, ...], path: Path, as_json: bool) -> None:
    """Write bundles, or all bundles in some folders, into one archive file, and read it back before it gets its name.

    The archive has a folder for each bundle, index.csv with a row for each frame, and SHA256SUMS. If a bundle is
    damaged nothing is written. rig bundle verify checks the archive, rig bundle import (or tar) unpacks it.

    \b
    Examples:
      rig bundle export bundles --out field-trip.tar
      rig bundle export bundles/20261124T0[67]* --out morning.zip
    """
    bundles = []
    for _, result in loaded(folders):
        if isinstance(result, BundleError):
            raise result
        bundles.append(result)
    with stopping_cleanly():
        write_archive(path, bundles)
    size = path.stat().st_size
    if as_json:
        ids = [bundle.id for bundle in bundles]
        click.echo(json.dumps({"archive": str(path), "bytes": size, "bundles": ids}))
    else:
        click.echo(path)
        click.echo(f"{len(bundles)} bundles, {size / 1e6:.1f} MB, read back and whole", err=True)


@click.command("import")
@click.argument("archive", metavar="ARCHIVE", type=click.Path(path_type=Path, dir_okay=False))
@click.option(
    "--out",
    "out_dir",
    metavar="DIR",
    type=OutputFolder(),
    required=True,
    help="The folder that the bundles go into.",
)
@json_option
def import_(archive: Path, out_dir: Path, as_json: bool) -> None:
    """Unpack the bundles of an archive, all or none, after checking every checksum; identical bundles that exist
    already stay.

    Only files that the bundles list are kept. An archive with more content, or a larger unpacked size, than its bundles
    explain is refused.

    Example: rig bundle import field-trip.tar --out bundles
    """
    strays: list[str] = []
    with stopping_cleanly():
        found = unpack_archive(archive, out_dir, strays.append)
    for place, is_new in found:
        if as_json:
            click.echo(json.dumps({"directory": str(place), "new": is_new}))
        else:
            click.echo(place)
            if not is_new:
                click.echo(f"{place} was there already", err=True)
    if strays:
        click.echo(f"{archive}: left out what no bundle lists: {first_names(strays)}", err=True)


def first_names(strays: list[str]) -> str:
    """The first few file names."""
    more = f" and {len(strays) - 3} more" if len(strays) > 3 else ""
    return f"{', '.join(map(repr, strays[:3]))}{more}"
