"""The person who calibrates: what they are told, and when they say that they are ready. All of it on standard error."""

import sys
from typing import Protocol

from rig.config.calibration_files import CalibrationError


class Guide(Protocol):
    """Tells what goes on, and waits for the person where only they can act."""

    def say(self, text: str) -> None:
        """Tell something; stays visible."""
        ...

    def ready(self, task: str) -> None:
        """Ask the person to do something, and wait until they have."""
        ...

    def agrees(self, question: str) -> bool:
        """Ask a question that is answered with yes or no."""
        ...


class TerminalGuide:
    """A person at a terminal, or a script at a pipe: one line for each question, answered with a line.

    With ``yes`` nobody is asked: everything is taken to be ready and agreed.
    """

    def __init__(self, yes: bool) -> None:
        self._yes = yes

    def say(self, text: str) -> None:
        """Tell something."""
        print(text, file=sys.stderr, flush=True)

    def ready(self, task: str) -> None:
        """Ask for something and wait for Enter. ``CalibrationError`` where nobody is there to press it."""
        self.say(f"{task} Then press Enter.")
        if not self._yes:
            self._answer()

    def agrees(self, question: str) -> bool:
        """Ask; Enter alone means yes."""
        self.say(f"{question} [Y/n]")
        return self._yes or not self._answer().strip().lower().startswith("n")

    def _answer(self) -> str:
        line = sys.stdin.readline()
        if not line:
            raise CalibrationError("nobody answers on standard input; give --yes where no answer is needed")
        return line
