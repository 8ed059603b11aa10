"""Signals of commands: the first one ends the command with clean-up, further ones are ignored."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from localizer.errors import SkyfixError


class TerminatedError(SkyfixError):
    """The command was ended by a signal; the exit status is the one that shells use for it."""

    def __init__(self, number: int) -> None:
        super().__init__(f"ended by {signal.Signals(number).name}")
        self.exit_status = 128 + number


@contextmanager
def stopping_cleanly() -> Iterator[None]:
    """Turn SIGINT into ``KeyboardInterrupt``, SIGTERM and SIGHUP into ``TerminatedError``, once.

    Then the clean-up runs: torque off, devices closed, no partial files. A second signal must not leave the motors on,
    so it is ignored; every step of the clean-up has a time limit.
    """
    numbers = signal.SIGINT, signal.SIGTERM, signal.SIGHUP

    def stop(number: int, frame: FrameType | None) -> None:
        for each in numbers:
            signal.signal(each, signal.SIG_IGN)
        raise KeyboardInterrupt if number == signal.SIGINT else TerminatedError(number)

    before = {number: signal.signal(number, stop) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
