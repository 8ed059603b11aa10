"""Takes the remaining captures of a series on schedule; a failed one does not end it."""

from collections.abc import Callable, Iterator, Mapping
from datetime import timedelta
from pathlib import Path
from typing import Any

from localizer.bundle import Bundle, BundleError, load_bundle
from rig import timebase
from rig.bundle.summary import bundles_in, extra_of, readings
from rig.clock import wall_clock
from rig.errors import RigError
from rig.series.journal import Outcome, Series

Take = Callable[[Path, Mapping[str, Any]], Path]
"""Takes a bundle into a folder, with remarks for its ``raw``, and returns its directory."""


def take_series(series: Series, take: Take, say: Callable[[str], None]) -> Iterator[Outcome]:
    """Take the remaining captures of a series, and yield each outcome once it is in the journal.

    Captures begin ``every_s`` apart, or at once if one takes longer. A resumed series keeps its schedule and repeats a
    capture that was interrupted. Raises ``SeriesError`` if the journal cannot be written.
    """
    due_s = timebase.monotonic_s() + _remaining_wait_s(series)
    for number in series.remaining():
        found = _bundle_of_interrupted_capture(series, number)
        if found is not None:
            say(f"bundle {number} of {series.plan.repeat} was there already: {found.id}")
            yield series.taken(number, None, found, readings(found))
            due_s = timebase.monotonic_s() + _remaining_wait_s(series)
            continue
        wait_s = due_s - timebase.monotonic_s()
        if wait_s > 1.0:
            at = wall_clock() + timedelta(seconds=wait_s)
            say(f"bundle {number} of {series.plan.repeat} at {at:%H:%M:%S}Z")
        timebase.sleep(max(0.0, wait_s))
        due_s = max(due_s, timebase.monotonic_s() - 1.0) + series.plan.every_s
        series.begin(number)
        begun_s = timebase.monotonic_s()
        try:
            path = take(series.bundles, {"series": {"id": series.id, "number": number}})
            bundle = load_bundle(path)
        except (RigError, BundleError) as error:
            yield series.failed(number, timebase.monotonic_s() - begun_s, str(error))
        else:
            yield series.taken(number, timebase.monotonic_s() - begun_s, bundle, readings(bundle))
    series.end()


def _remaining_wait_s(series: Series) -> float:
    """Remaining wait of the next capture after a restart; at most ``every_s``, whatever the clock says."""
    last = max(series.begun, default=0)
    if last not in series.outcomes:
        return 0.0
    gone_s = (wall_clock() - series.begun[last]).total_seconds()
    return min(max(series.plan.every_s - gone_s, 0.0), series.plan.every_s)


def _bundle_of_interrupted_capture(series: Series, number: int) -> Bundle | None:
    """The bundle of a capture that finished just before a crash, without a journal entry."""
    if number not in series.begun:
        return None
    known = {outcome.bundle for outcome in series.outcomes.values()}
    mark = {"id": series.id, "number": number}
    for path in bundles_in(series.bundles):
        if path.name not in known:
            bundle = load_bundle(path)
            raw = extra_of(bundle, "raw")
            if raw.get("series") == mark and "recalibrated_from" not in raw:
                return bundle
    return None
