"""``rig bundle list``, ``show`` and ``verify``: what bundles hold, and whether they are whole."""

import json
from pathlib import Path
from typing import Any

import click

from localizer.bundle import FILE_NAME, Bundle, BundleError, load_bundle

directory_argument = click.argument("directory", metavar="DIR", type=click.Path(path_type=Path))
json_option = click.option("--json", "as_json", is_flag=True, help="Print JSON.")


def summary(bundle: Bundle) -> dict[str, Any]:
    """A bundle in a few JSON values."""
    raw = (bundle.model_extra or {}).get("raw", {})
    return {
        "id": bundle.id,
        "created": bundle.model_dump(mode="json")["created"],
        "directory": str(bundle.directory),
        "altitude_m": bundle.altitude.value_m if bundle.altitude else None,
        "azimuth_bias_sigma_deg": bundle.azimuth_bias_sigma_deg,
        "frames": [
            {
                "label": frame.label,
                "azimuth_deg": frame.azimuth_deg,
                "tilt_deg": frame.tilt_deg,
                "roll_deg": frame.roll_deg,
                "skyline_share": (frame.model_extra or {}).get("raw", {}).get("skyline", {}).get("share"),
            }
            for frame in bundle.frames
        ],
        "faults": raw.get("faults", []),
    }


def _bundles_in(folder: Path) -> list[Path]:
    return sorted(path.parent for path in folder.glob(f"[!.]*/{FILE_NAME}"))


@click.command("list")
@directory_argument
@json_option
def list_(directory: Path, as_json: bool) -> int:
    """The bundles in a folder, oldest first, numbered; status 2 where one of them is damaged.

    Example: rig bundle list bundles
    """
    if not directory.is_dir():
        raise BundleError(f"{directory}: is no folder; name the one that the bundles are in")
    found, damaged = [], 0
    for number, path in enumerate(_bundles_in(directory), 1):
        try:
            found.append({"number": number, **summary(load_bundle(path)), "problem": None})
        except BundleError as error:
            damaged += 1
            found.append({"number": number, "id": path.name, "problem": str(error)})
    if as_json:
        click.echo(json.dumps(found, indent=2))
        return 2 if damaged else 0
    for each in found:
        if each["problem"]:
            click.echo(f"{each['number']:4}  {each['id']}  DAMAGED: {each['problem']}")
            continue
        frames = " ".join(frame["label"] for frame in each["frames"])
        faults = f", {len(each['faults'])} kinds of faults overcome" if each["faults"] else ""
        click.echo(f"{each['number']:4}  {each['id']}  {each['created']}  {frames}{faults}")
    return 2 if damaged else 0


@click.command()
@directory_argument
@json_option
def show(directory: Path, as_json: bool) -> None:
    """What one bundle holds.

    Example: rig bundle show bundles/20261124T060000Z-3f9a
    """
    found = summary(load_bundle(directory))
    if as_json:
        click.echo(json.dumps(found, indent=2))
        return
    altitude = f"{found['altitude_m']:.1f} m" if found["altitude_m"] is not None else "not measured"
    click.echo(f"{found['id']}, {found['created']}, altitude {altitude}")
    for frame in found["frames"]:
        share = (
            ""
            if frame["skyline_share"] is None
            else f", skyline in {frame['skyline_share']:.0%} of the columns"
        )
        click.echo(
            f"  {frame['label']}: azimuth {frame['azimuth_deg']:.2f}, tilt {frame['tilt_deg']:.2f}, "
            f"roll {frame['roll_deg']:.2f} deg{share}"
        )
    for fault in found["faults"]:
        click.echo(
            f"  overcome: {fault['device']}: {fault['problem']}; {fault['action']} ({fault['count']} times)"
        )


@click.command()
@click.argument("directories", metavar="DIR...", nargs=-1, required=True, type=click.Path(path_type=Path))
def verify(directories: tuple[Path, ...]) -> int:
    """Read bundles to the last byte: sizes, ranges, checksums. Ends with status 2 where one is damaged.

    Example: rig bundle verify bundles/*
    """
    damaged = 0
    for directory in directories:
        try:
            load_bundle(directory)
            click.echo(f"{directory}: whole")
        except BundleError as error:
            damaged += 1
            click.echo(f"rig: {error}", err=True)
    return 2 if damaged else 0
