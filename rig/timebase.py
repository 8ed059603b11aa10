"""The time base of the rig: monotonic time, the waits on it, and the wall clock. All of ``rig`` takes them from here.

Behind it stands one clock, the computer's. ``running_on`` puts another in its place, for tests: one that runs faster,
together with simulated devices, or one that is stepped. The operating system waits on the computer's clock in any case:
for the end of a thread or a process, and for a byte, for as long as ``computer_s`` says.
"""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from typing import Protocol


class Clock(Protocol):
    """A clock that runs on, and the waits on it."""

    def monotonic_s(self) -> float:
        """Seconds since an unspecified moment; never steps back."""
        ...

    def wall_utc(self) -> datetime:
        """UTC, as set by somebody; may step."""
        ...

    def sleep(self, seconds: float) -> None:
        """Wait."""
        ...

    def wait(self, event: threading.Event, seconds: float) -> bool:
        """Wait for an event, for at most ``seconds``; returns whether it is set."""
        ...

    def wait_for(self, changed: threading.Condition, ready: Callable[[], bool], seconds: float) -> bool:
        """Wait on a condition that is held until it is ``ready``, for at most ``seconds``; returns whether it is."""
        ...

    def computer_s(self, seconds: float) -> float:
        """How long that lasts on the computer's clock."""
        ...


class ComputerClock:
    """The computer's clock."""

    def monotonic_s(self) -> float:
        """``time.monotonic``."""
        return time.monotonic()

    def wall_utc(self) -> datetime:
        """The computer's date and time."""
        return datetime.now(UTC)

    def sleep(self, seconds: float) -> None:
        """``time.sleep``."""
        time.sleep(seconds)

    def wait(self, event: threading.Event, seconds: float) -> bool:
        """``threading.Event.wait``."""
        return event.wait(seconds)

    def wait_for(self, changed: threading.Condition, ready: Callable[[], bool], seconds: float) -> bool:
        """``threading.Condition.wait_for``."""
        return changed.wait_for(ready, seconds)

    def computer_s(self, seconds: float) -> float:
        """As long."""
        return seconds


_clock: Clock = ComputerClock()


@contextmanager
def running_on(clock: Clock) -> Iterator[None]:
    """Let ``clock`` be the clock of all threads of this process while the context lasts."""
    global _clock  # noqa: PLW0603 - times of all threads are compared with each other
    before, _clock = _clock, clock
    try:
        yield
    finally:
        _clock = before


def monotonic_s() -> float:
    """Seconds since an unspecified moment; on the computer's clock ``time.monotonic``."""
    return _clock.monotonic_s()


def wall_utc() -> datetime:
    """UTC by the wall clock, which may step."""
    return _clock.wall_utc()


def sleep(seconds: float) -> None:
    """Wait."""
    _clock.sleep(seconds)


def wait(event: threading.Event, seconds: float) -> bool:
    """Wait for an event, for at most ``seconds``; returns whether it is set."""
    return _clock.wait(event, seconds)


def wait_for(changed: threading.Condition, ready: Callable[[], bool], seconds: float) -> bool:
    """Wait on a condition that is held until it is ``ready``, for at most ``seconds``; returns whether it is."""
    return _clock.wait_for(changed, ready, seconds)


def computer_s(seconds: float) -> float:
    """How long that lasts on the computer's clock: a time limit for the operating system."""
    return _clock.computer_s(seconds)
