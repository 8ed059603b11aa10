"""The rig's clocks. ``time.monotonic`` is for ages, order and deadlines; UTC is for the record.

The wall clock of a vehicle computer steps when GPS or NTP first answer. UTC here runs evenly through a session: it is
the wall clock's at ``begin_session``, carried on by the monotonic clock, so that the times within one bundle belong
together. ``step_s`` tells by how much the wall clock has gone another way since.

``SKYFIX_CLOCK_OFFSET`` may name a file with seconds to add to the wall clock. It is there for simulations, which can
step this clock but not the computer's; a file that is absent or not a number adds nothing.
"""

import os
import time
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

OFFSET_VARIABLE = "SKYFIX_CLOCK_OFFSET"

PLAUSIBLE = datetime(2025, 1, 1, tzinfo=UTC), datetime(2050, 1, 1, tzinfo=UTC)
"""A computer without a battery begins in 1970, or where its last run or its image ended; this program is younger."""


def wall_clock() -> datetime:
    """What the computer takes for UTC at this moment."""
    return datetime.now(UTC) + timedelta(seconds=_offset_s())


def _offset_s() -> float:
    path = os.environ.get(OFFSET_VARIABLE)
    if not path:
        return 0.0
    try:
        return float(Path(path).read_text(encoding="ascii"))
    except (OSError, ValueError):
        return 0.0


class _Session:
    """A pair of simultaneous times."""

    def __init__(self) -> None:
        self.monotonic_s = time.monotonic()
        self.utc = wall_clock()


_session = _Session()


def begin_session() -> None:
    """Take over the wall clock's time; before a capture, not within one."""
    global _session  # noqa: PLW0603 - there is one wall clock, and everything that reads it shall agree
    _session = _Session()


def utc_at(monotonic_s: float) -> datetime:
    """UTC of a moment on the monotonic clock, by the session's time."""
    return _session.utc + timedelta(seconds=monotonic_s - _session.monotonic_s)


def utc_now() -> datetime:
    """UTC of this moment, by the session's time."""
    return utc_at(time.monotonic())


def step_s() -> float:
    """By how many seconds the wall clock has stepped since the session began, forwards positive."""
    return (wall_clock() - utc_now()).total_seconds()


def problem(now: datetime | None = None) -> str | None:
    """That the computer's clock cannot be right, in words for people; None where it may be."""
    utc = now or utc_now()
    if PLAUSIBLE[0] <= utc < PLAUSIBLE[1]:
        return None
    return f"the computer's clock says {utc:%Y-%m-%d %H:%M} UTC"


@dataclass(frozen=True)
class Instant:
    """A moment on both clocks: ``time.monotonic`` in seconds, and UTC (``rig.clock``)."""

    monotonic_s: float
    utc: datetime

    @classmethod
    def now(cls) -> "Instant":
        """This moment."""
        monotonic_s = time.monotonic()
        return cls(monotonic_s, utc_at(monotonic_s))
