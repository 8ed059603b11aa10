"""From a search result to the answer that is published, and answers restored from the spool after a restart."""

import math
from dataclasses import replace
from datetime import UTC, datetime

from localizer.fix import Fix
from rig.clock import Instant, utc_now
from rig.daemon.boot import boot_id
from rig.daemon.search.process import CaptureInfo, SearchResult
from rig.daemon.spool.store import Entry, Spool
from rig.daemon.state import Answer, DaemonState

LONG_AGO_S = 3600.0
"""Assumed age of a bundle of an earlier boot if the wall clock says that it lies in the future."""


def answer_of(entry: Entry, found: SearchResult, started: Instant | None = None) -> Answer:
    """The published answer for a bundle's search result; ``started`` is the start of the daemon."""
    heading = vehicle_heading_deg(found)
    captured = moment_of(found.capture_info, entry.boot)
    return Answer(
        bundle=entry.bundle,
        captured=captured,
        answered=Instant.now(),
        trigger=entry.trigger,
        fix=found.track.fix,
        mode=found.track.mode,
        hypotheses=found.track.hypotheses,
        elsewhere=found.track.elsewhere,
        altitude_m=found.altitude_m,
        vehicle_heading_deg=heading[0] if heading else None,
        vehicle_heading_sigma_deg=heading[1] if heading else None,
        before_start=entry.boot != boot_id()
        or (started is not None and captured.monotonic_s < started.monotonic_s),
        wgs84_accuracy_m=found.wgs84_accuracy_m,
    )


def restored(answer: Answer, boot: str | None) -> Answer:
    """A spool answer after a restart. ``boot``: the boot in which its bundle was captured."""
    if boot == boot_id():
        return replace(answer, before_start=True)
    now = Instant.now()
    captured = Instant(now.monotonic_s - _age_s(answer.captured.utc), answer.captured.utc)
    answered = Instant(now.monotonic_s - _age_s(answer.answered.utc), answer.answered.utc)
    return replace(answer, captured=captured, answered=answered, before_start=True)


def restore(daemon_state: DaemonState, spool: Spool) -> None:
    """Restore the latest answers from the spool into the daemon state, unless there are newer ones.

    Repeated after a step of the wall clock: ages of another boot depend on it.
    """
    known = daemon_state.snapshot().last
    if known is not None and not known.before_start:
        return
    last, last_fix = (answer and restored(*answer) for answer in spool.latest())
    newest = last or last_fix  # the newest bundle's answer may be unreadable
    if newest is not None:
        daemon_state.restore(newest, last_fix)


def vehicle_heading_deg(found: SearchResult) -> tuple[float, float] | None:
    """True heading of the vehicle's forward axis and its sigma: as measured, minus the solved bias."""
    nuisance, capture_info = found.track.fix.nuisance, found.capture_info
    if nuisance is None or found.azimuth_bias_sigma_deg is None or capture_info.heading_deg is None:
        return None
    sigma_deg = math.hypot(found.azimuth_bias_sigma_deg, *capture_info.mounting_sigmas_deg)
    return (capture_info.heading_deg - nuisance.azimuth_bias_deg) % 360.0, min(sigma_deg, 180.0)


def moment_of(capture_info: CaptureInfo, boot: str | None) -> Instant:
    """Time of a bundle's last frame. For another boot only the wall clock's time is known."""
    utc, now = datetime.fromisoformat(capture_info.utc), Instant.now()
    if boot == boot_id() and capture_info.monotonic_s is not None:
        return Instant(capture_info.monotonic_s, utc)
    return Instant(now.monotonic_s - _age_s(utc), utc)


def _age_s(utc: datetime) -> float:
    """Age by the wall clock: all that is known for another boot; never used to call a fix current."""
    age_s = (utc_now() - (utc if utc.tzinfo else utc.replace(tzinfo=UTC))).total_seconds()
    return age_s if age_s > 0.0 else LONG_AGO_S


def described(answer: Answer) -> dict[str, object]:
    """An answer as values for one log line."""
    fix: Fix = answer.fix
    values: dict[str, object] = {"status": fix.status, "mode": answer.mode}
    if fix.position:
        values |= {
            "lat_deg": round(fix.position.lat_deg, 6),
            "lon_deg": round(fix.position.lon_deg, 6),
            "probability": round(fix.probability, 4),
        }
    values["seconds"] = round(sum(fix.timing_s.values()), 2)
    return values
