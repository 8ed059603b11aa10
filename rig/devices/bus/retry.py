"""The one retry policy: a few tries within a bounded time, and only for what may pass by itself.

It stands above the drivers. A driver that retries by itself hides a bad cable and multiplies timeouts. What was
overcome is noted (``rig.fault_notes``).
"""

import time
from collections.abc import Callable
from typing import TypeVar

from rig.devices.bus.deadline import Deadline
from rig.errors import LostPortError, TransientError
from rig.fault_notes import note_fault

TRIES = 7
"""With the doubling pauses they span 1.3 s: a servo's restart, or a plug that is seated badly."""

REPLUG_S = 5.0
"""How long an adapter that was pulled out is waited for."""

REPLUG_POLL_S = 0.1

T = TypeVar("T")


def retry(
    exchange: Callable[[], T],
    *,
    tries: int = TRIES,
    within_s: float = 5.0,
    pause_s: float = 0.02,
    replug_s: float | None = None,
) -> T:
    """What ``exchange`` returns, called again after a ``TransientError``.

    There are at most ``tries`` calls, none of which starts later than ``within_s`` after the first; the pause
    between them doubles from ``pause_s``. A ``LostPortError`` costs none of them: the port is waited for, for
    ``replug_s`` in all (default: ``REPLUG_S``). ``exchange`` must be safe to repeat: a read, or a write of a state
    (not a step). Raises the last ``TransientError``, and any other exception at once.
    """
    if tries < 1:
        raise ValueError(f"retry needs at least one try, not {tries}")
    deadline = Deadline.after(within_s)
    port_is_back: Deadline | None = None
    while True:
        try:
            return exchange()
        except LostPortError as error:
            port_is_back = port_is_back or Deadline.after(REPLUG_S if replug_s is None else replug_s)
            if port_is_back.expired:
                raise
            note_fault(error.device, error.problem, "waited for it to come back")
            time.sleep(REPLUG_POLL_S)
            deadline = Deadline.after(within_s)
        except TransientError as error:
            tries -= 1
            if tries == 0 or deadline.remaining_s <= pause_s:
                raise
            note_fault(error.device, error.problem, "tried again")
            time.sleep(pause_s)
            pause_s *= 2
