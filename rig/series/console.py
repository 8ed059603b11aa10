"""Console output of a series: results on standard output, everything else on standard error."""

import json

import click

from localizer.bundle import load_bundle
from localizer.errors import SkyfixError
from localizer.os_errors import why_not_written
from rig import timebase
from rig.atomic import write_atomically
from rig.bundle.preview import write_preview
from rig.capture.averaged_readings import utc_text
from rig.series.journal import Outcome, Series
from rig.series.summary import summary, summary_text


class SeriesConsole:
    """Console output of one series, as text or JSON lines."""

    def __init__(self, series: Series, as_json: bool) -> None:
        self._series = series
        self._as_json = as_json
        self._begun_s = timebase.monotonic_s()

    def say(self, text: str) -> None:
        """Show a message during the series."""
        click.echo(text, err=True)

    def begins(self, *, goes_on: bool) -> None:
        """Show the series' folder."""
        series = self._series
        if goes_on:
            done = series.plan.repeat - len(series.remaining())
            self.say(
                f"goes on with {series.folder}: {done} of {series.plan.repeat} done (--fresh begins another)"
            )
            for outcome in series.outcomes.values():
                self._draw(outcome)  # the stop may have come before it
        else:
            self.say(f"series of {series.plan.repeat} into {series.folder}")

    def outcome(self, outcome: Outcome) -> None:
        """Show one outcome: the bundle's directory, or why there is none; draws the bundle's picture."""
        series = self._series
        if outcome.reason is not None:
            self.say(f"rig: {outcome.number} of {series.plan.repeat}: {outcome.reason}")
        elif not self._as_json:
            click.echo(series.bundles / str(outcome.bundle))
        if self._as_json:
            click.echo(json.dumps(self._fields(outcome)))
        self._draw(outcome)

    def ends(self) -> None:
        """Print the summary, and write it into the folder."""
        found = {**summary(self._series), "lasted_s": round(timebase.monotonic_s() - self._begun_s, 1)}
        if self._as_json:
            click.echo(json.dumps({"summary": found}))
        else:
            self.say(summary_text(found))
        path = self._series.folder / "summary.json"
        try:
            write_atomically(path, json.dumps(found, indent=2).encode() + b"\n")
        except OSError as error:
            self.say(f"rig: {path}: {why_not_written(error)}")

    def _draw(self, outcome: Outcome) -> None:
        path = self._series.preview(outcome)
        if outcome.bundle is None or path.exists():
            return
        try:
            bundle = load_bundle(self._series.bundles / outcome.bundle)
            write_preview(path, bundle, f"{outcome.number} of {self._series.plan.repeat}")
        except SkyfixError as error:  # a missing picture does not end the series
            self.say(f"rig: {error}")

    def _fields(self, outcome: Outcome) -> dict[str, object]:
        there = outcome.bundle is not None
        return {
            "number": outcome.number,
            "time": utc_text(outcome.time),
            "took_s": outcome.took_s,
            "bundle": outcome.bundle,
            "directory": str(self._series.bundles / str(outcome.bundle)) if there else None,
            "preview": str(self._series.preview(outcome)) if there else None,
            "readings": dict(outcome.readings),
            "problem": outcome.reason,
        }
