"""Progress of a capture for the operator, on stderr: a progress bar on a terminal, else one line a step."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from rig import event_bus


class ProgressReporter(Protocol):
    """Receives the current step (``doing``) and finished steps (``done``), each a short sentence."""

    def doing(self, what: str) -> None:
        """The step that begins now; replaced by the next."""
        ...

    def done(self, what: str) -> None:
        """A finished step; stays visible."""
        ...


class PublishingReporter:
    """A progress reporter that also publishes to the event bus."""

    def __init__(self, report: ProgressReporter) -> None:
        self._report = report

    def doing(self, what: str) -> None:
        """Pass on."""
        event_bus.publish(event_bus.Step("info", "capture", what))
        self._report.doing(what)

    def done(self, what: str) -> None:
        """Pass on."""
        event_bus.publish(event_bus.Step("info", "capture", what))
        self._report.done(what)


class _Lines:
    def __init__(self, console: Console) -> None:
        self._console = console

    def doing(self, what: str) -> None:
        pass

    def done(self, what: str) -> None:
        self._console.print(what, markup=False, highlight=False, soft_wrap=True)


class _Bar:
    def __init__(self, progress: Progress, steps: int) -> None:
        self._progress = progress
        self._task = progress.add_task("", total=steps)

    def doing(self, what: str) -> None:
        self._progress.update(self._task, description=what)

    def done(self, what: str) -> None:
        self._progress.console.print(what, markup=False, highlight=False, soft_wrap=True)
        self._progress.advance(self._task)


@contextmanager
def console_progress(steps: int) -> Iterator[ProgressReporter]:
    """A progress reporter for a number of steps."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield _Lines(console)
        return
    columns = SpinnerColumn(), BarColumn(bar_width=20), TimeElapsedColumn(), TextColumn("{task.description}")
    with Progress(*columns, console=console, transient=True) as progress:
        yield _Bar(progress, steps)
