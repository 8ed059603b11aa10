"""The one retry policy: a few tries within a bounded time, and only for what may pass by itself.

It stands above the drivers. A driver that retries by itself hides a bad cable and multiplies timeouts.
"""

import logging
import time
from collections.abc import Callable
from typing import TypeVar

from rig.bus.deadline import Deadline
from rig.errors import TransientError

_log = logging.getLogger(__name__)

T = TypeVar("T")


def retry(exchange: Callable[[], T], *, tries: int = 3, within_s: float = 5.0, pause_s: float = 0.01) -> T:
    """What ``exchange`` returns, called again after a ``TransientError``.

    There are at most ``tries`` calls, none of which starts later than ``within_s`` after the first; the pause
    between them doubles from ``pause_s``. ``exchange`` must be safe to repeat: a read, or a write of a state
    (not a step). Raises the last ``TransientError``, and any other exception at once.
    """
    deadline = Deadline.after(within_s)
    for tries_left in range(tries - 1, -1, -1):
        try:
            return exchange()
        except TransientError as error:
            if tries_left == 0 or deadline.remaining_s <= pause_s:
                raise
            _log.info("trying again: %s", error)
        time.sleep(pause_s)
        pause_s *= 2
    raise ValueError(f"retry needs at least one try, not {tries}")
