"""Deadlines on the monotonic clock, as the wall clock may step at any time."""

from collections.abc import Callable
from dataclasses import dataclass

from rig import timebase


@dataclass(frozen=True)
class Deadline:
    """A moment, until which something is waited for.

    Attributes
    ----------
    at_s : float
        On ``time.monotonic``'s clock.
    """

    at_s: float

    @classmethod
    def after(cls, seconds: float) -> "Deadline":
        """The moment so many seconds from now.

        Parameters
        ----------
        seconds : float
            From now.

        Returns
        -------
        Deadline
            That moment.
        """
        return cls(timebase.monotonic_s() + seconds)

    @property
    def remaining_s(self) -> float:
        """Seconds left, never negative."""
        return max(0.0, self.at_s - timebase.monotonic_s())

    @property
    def expired(self) -> bool:
        """Whether the moment has passed."""
        return timebase.monotonic_s() >= self.at_s


def wait_until(condition: Callable[[], bool], deadline: Deadline, poll_s: float) -> bool:
    """Poll ``condition`` every ``poll_s`` seconds until it holds; False if it does not by the deadline.

    It is evaluated at least once, and once more after the deadline, so that a process that was not scheduled does not
    blame the device.
    """
    while True:
        last_try = deadline.expired
        if condition():
            return True
        if last_try:
            return False
        timebase.sleep(min(poll_s, deadline.remaining_s))
