"""``localizer track``: several bundles one after the other."""

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import click

from localizer.bundle import Bundle, load_bundle
from localizer.dem.lattice import Dem
from localizer.errors import SkyfixError
from localizer.output_files import writing
from localizer.search.altitude_reference import altitude_note, reason_note
from localizer.show.output_parts import OutputParts
from localizer.show.text import fix_text
from localizer.truth import Truth


def run_track(
    bundle_paths: Sequence[Path],
    dem: Dem,
    odometry_path: Path | None,
    as_json: bool,
    plot_path: Path | None,
    truths: Sequence[Truth],
) -> int:
    """Follow the bundles, print what each comes to as soon as that is known, and the last fix; returns its exit status.

    Raises ``SkyfixError`` before any search where a bundle or the odometry is bad.
    """
    from localizer.dem.horizon import prepare_terrain  # slow to import: bad input should be told at once
    from localizer.search.locate import load_kernels
    from localizer.track.document import step_text, track_line
    from localizer.track.odometry import Odometry, load_odometry
    from localizer.track.tracker import Step, Tracker, follow_bundle

    if truths and len(truths) != len(bundle_paths):
        raise SkyfixError(
            f"--truth: {len(truths)} files for {len(bundle_paths)} bundles; give one for each, in order"
        )
    legs = len(bundle_paths) - 1
    odometry: Odometry = load_odometry(odometry_path, legs) if odometry_path else (None,) * legs
    bundles = [load_bundle(path) for path in bundle_paths]
    _check_sequence(bundles)
    terrain = prepare_terrain(dem)
    load_kernels(terrain)
    tracker = Tracker()
    steps: list[Step] = []
    for bundle, leg in zip(bundles, (None, *odometry), strict=True):
        step = follow_bundle(tracker, leg, terrain, bundle)
        tracker = step.tracker
        steps.append(step)
        for note in (altitude_note(step.fix, bundle, dem), reason_note(step.fix)):
            if note:
                click.echo(f"localizer: bundle {bundle.id}: {note}", err=True)
        click.echo(track_line(step, dem).to_json() if as_json else step_text(step))
    last = steps[-1].fix
    if not as_json:
        click.echo(f"\n{fix_text(last, dem, truths[-1] if truths else None)}")
    if plot_path is not None:
        from localizer.show.track_plot import draw_track

        parts = OutputParts()
        with parts.part(f"--plot: {plot_path}"), writing("--plot", plot_path):
            draw_track(plot_path, steps, odometry, dem, truths)
        parts.end()
    return last.exit_status


def _check_sequence(bundles: Sequence[Bundle]) -> None:
    """A bundle used twice would confirm itself: an error. A wrong order is only noted, since clocks can be set back."""
    ids = [bundle.id for bundle in bundles]
    twice = next((bundle_id for bundle_id in ids if ids.count(bundle_id) > 1), None)
    if twice is not None:
        raise SkyfixError(f"bundle {twice}: is named twice; name each once, in the order of the drive")
    for before, after in pairwise(bundles):
        if after.created < before.created:
            click.echo(
                f"localizer: bundle {after.id} was taken before {before.id}, which is named before it; "
                "the odometry is taken in the order of the names",
                err=True,
            )
