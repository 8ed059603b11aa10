"""``sim evaluate --photos``: the evaluation on photographs."""

import json
from pathlib import Path

import click

from sim.evaluate.photos.run import evaluate_photos

WRONG_FIX_STATUS = 5
"""As of ``sim demo``."""


def photos_command(data_dir: Path, out_dir: Path | None, as_json: bool = False) -> int:
    """Evaluate and print the tables; the exit status tells whether a wrong place was called a fix."""
    evaluation = evaluate_photos(data_dir, out_dir, lambda line: click.echo(line, err=True))
    click.echo(json.dumps(evaluation.fields()) if as_json else evaluation.markdown())
    return WRONG_FIX_STATUS if evaluation.wrong_fixes else 0
