"""The retry policy: a few tries within a bounded time, for transient errors only.

It is applied above the drivers. A driver that retries hides bad cables and multiplies timeouts. Recovered errors are
noted (``rig.fault_notes``).
"""

from collections.abc import Callable
from typing import TypeVar

from rig import timebase
from rig.devices.bus.deadline import Deadline
from rig.errors import LostPortError, TransientError
from rig.fault_notes import note_fault

TRIES = 7
"""With doubling pauses they span 1.3 s: a servo's reboot, or a loose plug."""

REPLUG_S = 5.0
"""Wait for an unplugged adapter."""

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

    At most ``tries`` calls, none later than ``within_s`` after the first; the pause between them doubles from
    ``pause_s``. A ``LostPortError`` does not count: the port is awaited for ``replug_s`` in total (default:
    ``REPLUG_S``). ``exchange`` must be idempotent: a read, or a write of a state. Raises the last ``TransientError``,
    and any other exception at once.
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
            timebase.sleep(REPLUG_POLL_S)
            deadline = Deadline.after(within_s)
        except TransientError as error:
            tries -= 1
            if tries == 0 or deadline.remaining_s <= pause_s:
                raise
            note_fault(error.device, error.problem, "tried again")
            timebase.sleep(pause_s)
            pause_s *= 2
