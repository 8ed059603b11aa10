"""The rig's clocks. ``time.monotonic`` is for ages, order and deadlines; UTC is for timestamps.

The wall clock of a vehicle computer steps when GPS or NTP first answer. UTC here does not step within a session: it is
the wall clock's time at ``begin_session`` plus the monotonic time since, so that the times within one bundle are
consistent. ``step_s`` is by how much the wall clock has stepped since.

``SKYFIX_CLOCK_OFFSET`` may name a file with seconds to add to the wall clock. It lets a simulation step this clock
without stepping the computer's. A file that is absent or holds no number adds nothing.
"""

import os
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from rig import timebase

OFFSET_VARIABLE = "SKYFIX_CLOCK_OFFSET"

PLAUSIBLE = datetime(2025, 1, 1, tzinfo=UTC), datetime(2050, 1, 1, tzinfo=UTC)
"""A computer without a battery-backed clock starts in 1970, or at the time of its last run or of its disk image."""


def wall_clock() -> datetime:
    """The computer's wall clock, UTC."""
    return timebase.wall_utc() + timedelta(seconds=_offset_s())


def _offset_s() -> float:
    path = os.environ.get(OFFSET_VARIABLE)
    if not path:
        return 0.0
    try:
        return float(Path(path).read_text(encoding="ascii"))
    except (OSError, ValueError):
        return 0.0


class _Session:
    """The wall clock and the monotonic clock, read at the same moment."""

    def __init__(self) -> None:
        self.monotonic_s = timebase.monotonic_s()
        self.utc = wall_clock()


_session = _Session()


def begin_session() -> None:
    """Set the session's time to the wall clock. Call it before a capture, not during one."""
    global _session  # noqa: PLW0603 - there is one wall clock, and everything that reads it shall agree
    _session = _Session()


def utc_at(monotonic_s: float) -> datetime:
    """UTC of a monotonic time, by the session's clock."""
    return _session.utc + timedelta(seconds=monotonic_s - _session.monotonic_s)


def utc_now() -> datetime:
    """UTC now, by the session's clock."""
    return utc_at(timebase.monotonic_s())


def step_s() -> float:
    """Seconds by which the wall clock has stepped since the session began; forwards is positive."""
    return (wall_clock() - utc_now()).total_seconds()


def problem(now: datetime | None = None) -> str | None:
    """Why the computer's clock must be wrong, in one sentence; None if its time is plausible."""
    utc = now or utc_now()
    if PLAUSIBLE[0] <= utc < PLAUSIBLE[1]:
        return None
    return f"the computer's clock says {utc:%Y-%m-%d %H:%M} UTC"


@dataclass(frozen=True)
class Instant:
    """The same instant on both clocks: ``time.monotonic`` in seconds, and UTC (``rig.clock``)."""

    monotonic_s: float
    utc: datetime

    @classmethod
    def now(cls) -> "Instant":
        """The present."""
        monotonic_s = timebase.monotonic_s()
        return cls(monotonic_s, utc_at(monotonic_s))
