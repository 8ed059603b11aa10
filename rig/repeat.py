"""Bundle after bundle: one that fails does not end the series."""

import time
from collections.abc import Callable
from pathlib import Path

import click

from rig.errors import RigError


def repeated(take: Callable[[], Path], count: int, every_s: float) -> int:
    """Call ``take`` ``count`` times, its beginnings ``every_s`` apart (or as soon as the one before has ended).

    Prints each bundle's directory; a failure, and at the end how many there were, on standard error. Returns 0, or 2
    where one failed.
    """
    failed = 0
    due_s = time.monotonic()
    for number in range(1, count + 1):
        time.sleep(max(0.0, due_s - time.monotonic()))
        due_s = max(due_s + every_s, time.monotonic())
        try:
            click.echo(take())
        except RigError as error:
            failed += 1
            click.echo(f"rig: {number} of {count}: {error}", err=True)
    click.echo(f"{count - failed} of {count} bundles taken", err=True)
    return 2 if failed else 0
