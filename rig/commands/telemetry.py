"""``rig telemetry``: inspection and repair of the MCAP files of rig capture --telemetry."""

import json
from collections import Counter
from datetime import UTC, datetime
from pathlib import Path

import click

from rig.capture.averaged_readings import utc_text

file_argument = click.argument("path", metavar="FILE", type=click.Path(path_type=Path, dir_okay=False))
json_option = click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")


@click.group()
def telemetry() -> None:
    """Inspect telemetry of rig capture --telemetry, and repair a file that a power cut truncated.

    Example: rig telemetry info session.mcap
    """


@telemetry.command()
@file_argument
@json_option
def info(path: Path, as_json: bool) -> int:
    """Show topics, counts, time span, and whether the file is complete; status 2 if it is not.

    Example: rig telemetry info session.mcap
    """
    from rig.telemetry.reader import TelemetryFile

    file = TelemetryFile(path)
    counts: Counter[str] = Counter()
    schemas: dict[str, str] = {}
    times_ns: list[int] = []
    for logged in file:
        counts[logged.topic] += 1
        schemas[logged.topic] = logged.schema.name if logged.schema else ""
        times_ns = [
            min([*times_ns[:1], logged.message.log_time]),
            max([*times_ns[1:], logged.message.log_time]),
        ]
    first, last = (
        (utc_text(datetime.fromtimestamp(ns / 1e9, UTC)) for ns in times_ns) if times_ns else ("", "")
    )
    lasted_s = (times_ns[1] - times_ns[0]) / 1e9 if times_ns else 0.0
    if as_json:
        topics = [{"topic": t, "schema": schemas[t], "messages": n} for t, n in sorted(counts.items())]
        found = {"file": str(path), "whole": file.problem is None, "problem": file.problem}
        click.echo(
            json.dumps({**found, "first": first, "last": last, "lasted_s": lasted_s, "topics": topics})
        )
    else:
        click.echo(f"{path}: {sum(counts.values())} messages in {lasted_s:.1f} s from {first or 'never'}")
        for topic, count in sorted(counts.items()):
            click.echo(f"  {topic:<20} {count:6}  {schemas[topic]}")
        if file.problem:
            click.echo(f"rig: {path}: {file.problem}; rig telemetry mend makes it whole", err=True)
    return 2 if file.problem else 0


@telemetry.command()
@file_argument
@click.option(
    "--out", "target", metavar="FILE", type=click.Path(path_type=Path), required=True, help="The new file."
)
@json_option
def mend(path: Path, target: Path, as_json: bool) -> None:
    """Copy the readable part of a truncated file into a complete one, which Foxglove opens at once.

    Example: rig telemetry mend session.mcap --out mended.mcap
    """
    from rig.telemetry.reader import mend as mended

    count = mended(path, target)
    click.echo(json.dumps({"file": str(target), "messages": count}) if as_json else target)
