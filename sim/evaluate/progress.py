"""Progress of a long run on standard error: a bar with the remaining time on a terminal, else occasional lines."""

from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from sim.evaluate.row import CaseRow
from sim.evaluate.summary import is_wrong_fix

LINES = 20  # in a whole run


@contextmanager
def case_progress(cases: int) -> Iterator[Callable[[CaseRow], None]]:
    """A callback for finished rows."""
    console = Console(stderr=True)
    seen: Counter[str] = Counter()
    columns = BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(), TextColumn("{task.description}")
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("", total=cases)

        def report(row: CaseRow) -> None:
            seen[row.status] += 1
            if is_wrong_fix(row):
                seen["wrong"] += 1
                console.print(f"case {row.case}: wrong fix on {row.dem}", markup=False, highlight=False)
            so_far = ", ".join(f"{count} {name}" for name, count in sorted(seen.items()))
            bar.update(task, advance=1, description=so_far)
            done = seen["fix"] + seen["ambiguous"] + seen["none"]
            if not console.is_terminal and done % max(cases // LINES, 1) == 0:
                console.print(f"{done} of {cases}: {so_far}", markup=False, highlight=False)

        yield report
