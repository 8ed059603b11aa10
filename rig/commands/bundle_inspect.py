"""``rig bundle list``, ``show`` and ``verify``: content and integrity of bundles."""

import csv
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click

from localizer.bundle import Bundle, BundleError, load_bundle
from localizer.os_errors import meant_instead
from rig.bundle.archive import ArchiveError, bundles_of_archive, is_archive
from rig.bundle.summary import (
    TABLE_COLUMNS,
    bundle_summary,
    bundles_in,
    table_rows,
    times_text,
    to_the_second,
)
from rig.commands.options import folders_argument

json_option = click.option("--json", "as_json", is_flag=True, help="Print JSON.")


def loaded(paths: tuple[Path, ...]) -> Iterator[tuple[Path, Bundle | BundleError]]:
    """The bundles in some folders or bundle directories, valid or damaged. ``BundleError`` if there is none."""
    for folder in paths:
        if not folder.is_dir():
            what = "is no folder" if folder.exists() else "is no folder, and no file either"
            meant = "" if folder.exists() else meant_instead(folder)
            raise BundleError(f"{folder}: {what}; name a bundle, or the folder that bundles are in{meant}")
        found = bundles_in(folder)
        if not found:
            raise BundleError(f"{folder}: holds no bundle")
        for path in found:
            try:
                yield path, load_bundle(path)
            except BundleError as error:
                yield path, error


@click.command("list")
@folders_argument
@json_option
@click.option(
    "--csv", "as_csv", is_flag=True, help="Print a row for each frame of the bundles that are whole."
)
def list_(folders: tuple[Path, ...], as_json: bool, as_csv: bool) -> int:
    """The bundles in folders and in folders below them, oldest first, numbered; status 2 where one is damaged.

    With --json one object a line.

    \b
    Examples:
      rig bundle list bundles
      rig bundle list bundles --csv > readings.csv
    """
    if as_json and as_csv:
        raise click.UsageError("Give --json or --csv.")
    everything = list(loaded(folders))
    problems = [f"{result}" for _, result in everything if isinstance(result, BundleError)]
    if as_csv:
        table = csv.DictWriter(sys.stdout, TABLE_COLUMNS, lineterminator="\n")
        table.writeheader()
        for _, result in everything:
            if isinstance(result, Bundle):
                table.writerows(table_rows(result))
        for problem in problems:
            click.echo(f"rig: {problem}", err=True)
        return 2 if problems else 0
    found: list[dict[str, Any]] = []
    for number, (path, result) in enumerate(everything, 1):
        if isinstance(result, BundleError):
            found.append({"number": number, "id": path.name, "directory": str(path), "problem": str(result)})
        else:
            found.append({"number": number, **bundle_summary(result), "problem": None})
    for each in found:
        click.echo(json.dumps(each) if as_json else _row(each))
    return 2 if problems else 0


def _row(found: dict[str, Any]) -> str:
    start = f"{found['number']:4}  {found['id']}"
    if found["problem"]:
        return f"{start}  DAMAGED: {found['problem']}"
    parts = [found["created"], " ".join(frame["label"] for frame in found["frames"])]
    known = found["readings"]
    parts += [f"{known['altitude_m']:.0f} m"] if "altitude_m" in known else []
    parts += [f"heading {known['heading_deg']:.1f}"] if "heading_deg" in known else []
    parts += [f"{found['series']['number']} of {found['series']['id']}"] if found["series"] else []
    parts += [f"recalibrated from {found['recalibrated_from']}"] if found["recalibrated_from"] else []
    kinds = len(found["faults"])
    parts += [f"{kinds} kind{'s' if kinds > 1 else ''} of fault overcome"] if kinds else []
    return f"{start}  {'  '.join(parts)}"


@click.command()
@click.argument("directory", metavar="DIR", type=click.Path(path_type=Path, file_okay=False))
@json_option
@click.option(
    "--picture",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="Draw the frames with the skylines found, as .png or .jpg.",
)
def show(directory: Path, as_json: bool, picture: Path | None) -> None:
    """Show one bundle: attitudes of vehicle and camera with sigmas, and recovered faults.

    \b
    Examples:
      rig bundle show bundles/20261124T060000Z-3f9a
      rig bundle show bundles/20261124T060000Z-3f9a --picture look.png
    """
    bundle = load_bundle(directory)
    found = bundle_summary(bundle)
    if picture is not None:
        from rig.bundle.preview import write_preview  # it is slow to import

        write_preview(picture, bundle, "")
    click.echo(json.dumps(found) if as_json else _shown(found))


def _shown(found: dict[str, Any]) -> str:
    known = found["readings"]
    altitude = "altitude not measured"
    if "altitude_m" in known:
        altitude = f"altitude {known['altitude_m']:.1f} +- {known['altitude_sigma_m']:.1f} m"
    lines = [f"{found['id']}, {found['created']}, {altitude}"]
    if found["series"]:
        lines.append(f"  number {found['series']['number']} of {found['series']['id']}")
    if "heading_deg" in known:
        lines.append(
            f"  vehicle: heading {known['heading_deg']:.2f}, pitch {known.get('pitch_deg', 0.0):z.2f}, "
            f"roll {known.get('roll_deg', 0.0):z.2f} deg"
        )
    lines.append(
        f"  common to all frames: azimuth +- {known['azimuth_bias_sigma_deg']:.2f}, "
        f"tilt +- {known['tilt_bias_sigma_deg']:.3f} deg"
    )
    for frame in found["frames"]:
        share = frame["skyline_share"]
        seen = "" if share is None else f", skyline in {share:.0%} of the columns"
        lines.append(
            f"  {frame['label']}: azimuth {frame['azimuth_deg']:.2f}, tilt {frame['tilt_deg']:z.2f}, "
            f"roll {frame['roll_deg']:z.2f} deg{seen}"
        )
        if frame["servo_volts"] and frame["servo_temperatures_c"]:
            volts, temps = (
                "/".join(f"{value:g}" for value in frame[key])
                for key in ("servo_volts", "servo_temperatures_c")
            )
            lines.append(f"     at {to_the_second(frame['time'])}, servos {volts} V, {temps} °C")
    lines += [f"  calibration: {kind} {name}" for kind, name in found["calibrations"].items()]
    if found["recalibrated_from"]:
        lines.append(f"  recalibrated from {found['recalibrated_from']}")
    lines += [
        f"  overcome: {fault['device']}: {fault['problem']}; {fault['action']} ({times_text(fault['count'])})"
        for fault in found["faults"]
    ]
    return "\n".join(lines)


@click.command()
@click.argument("paths", metavar="DIR|ARCHIVE...", nargs=-1, required=True, type=click.Path(path_type=Path))
@json_option
def verify(paths: tuple[Path, ...], as_json: bool) -> int:
    """Check bundles to the last byte: sizes, ranges, checksums. Status 2 if one is damaged, or a folder has none.

    A folder stands for all bundles below it, an archive of rig bundle export for all in it. With --json one object a line.

    \b
    Examples:
      rig bundle verify bundles
      rig bundle verify field-trip.tar
    """
    damaged = 0
    for where, problem in _verified(paths):
        damaged += problem is not None
        if as_json:
            click.echo(json.dumps({"path": where, "whole": problem is None, "problem": problem}))
        elif problem is None:
            click.echo(f"{where}: whole")
        else:
            click.echo(f"rig: {problem}", err=True)
    return 2 if damaged else 0


def _verified(paths: tuple[Path, ...]) -> Iterator[tuple[str, str | None]]:
    """Each bundle's path, and its defect or None."""
    for path in paths:
        try:
            if is_archive(path):
                strays: list[str] = []
                for bundle in bundles_of_archive(path, on_unlisted=strays.append):
                    yield f"{path}: {bundle.id}", None
                if strays:
                    yield (
                        str(path),
                        f"{path}: holds {strays[0]!r}, which no bundle lists ({len(strays)} files)",
                    )
            else:
                for where, result in loaded((path,)):
                    yield str(where), str(result) if isinstance(result, BundleError) else None
        except (BundleError, ArchiveError) as error:
            yield str(path), str(error)
