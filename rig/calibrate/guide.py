"""Instructions to and answers from the operator of a calibration, on standard error."""

import sys
from typing import Protocol

from rig.config.calibration_files import CalibrationError


class Guide(Protocol):
    """Shows instructions, and waits where the operator has to act."""

    def say(self, text: str) -> None:
        """Show a message."""
        ...

    def ready(self, task: str) -> None:
        """Ask the operator to do something, and wait until it is done."""
        ...

    def confirm(self, question: str) -> bool:
        """Ask a yes-no question."""
        ...


class TerminalGuide:
    """An operator at a terminal, or a script at a pipe: one line for each question, answered with a line.

    With ``yes`` nothing is asked: every task counts as done, every question as agreed.
    """

    def __init__(self, yes: bool) -> None:
        self._yes = yes

    def say(self, text: str) -> None:
        """Show a message."""
        print(text, file=sys.stderr, flush=True)

    def ready(self, task: str) -> None:
        """Ask and wait for Enter. ``CalibrationError`` if standard input has ended."""
        self.say(f"{task} Then press Enter.")
        if not self._yes:
            self._answer()

    def confirm(self, question: str) -> bool:
        """Ask; Enter alone means yes."""
        self.say(f"{question} [Y/n]")
        return self._yes or not self._answer().strip().lower().startswith("n")

    def _answer(self) -> str:
        line = sys.stdin.readline()
        if not line:
            raise CalibrationError("nobody answers on standard input; give --yes where no answer is needed")
        return line
