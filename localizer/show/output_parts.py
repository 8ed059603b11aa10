"""Output of several files: each is made independently, and a failure does not prevent the others."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from localizer.errors import SkyfixError

PROGRAM_ERROR = 1
"""Exit status where something that was asked for is missing through a defect of the program (the contract's)."""


class PartFailedError(SkyfixError):
    """Parts of the output are missing; the message names each, and what of the rest there is."""

    def __init__(self, message: str, exit_status: int) -> None:
        super().__init__(message)
        self.exit_status = exit_status


class OutputParts:
    """Collects what fails. ``end`` raises it, once everything else has been written."""

    def __init__(self) -> None:
        self.failures: list[SkyfixError] = []

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        """Context in which one part is made; its exception is collected, except for those that end the program."""
        try:
            yield
        except SkyfixError as error:
            self.failures.append(error)
        except Exception as error:  # noqa: BLE001 - a defect, which is named; the other parts are worth having
            self.failures.append(PartFailedError(f"{name}: {_described(error)}", PROGRAM_ERROR))

    @property
    def notes(self) -> list[str]:
        """What failed, one line each."""
        return [" ".join(str(error).split()) for error in self.failures]

    def end(self) -> None:
        """Raises ``PartFailedError`` where something has failed: 1 where a defect of the program was among it, else 2."""
        if not self.failures:
            return
        status = min(error.exit_status for error in self.failures)
        raise PartFailedError("; ".join(self.notes), status) from self.failures[0]


def _described(error: Exception) -> str:
    at = error.__traceback__
    while at is not None and at.tb_next is not None:
        at = at.tb_next
    where = f" in {Path(at.tb_frame.f_code.co_filename).name}, line {at.tb_lineno}" if at else ""
    return (
        f"could not be made ({type(error).__name__}: {error}{where}); everything else is written; "
        "that is a defect of the program: please report it"
    )
