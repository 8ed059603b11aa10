"""The command ``python -m frozen_answers``."""

import fnmatch
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import click
from pydantic import ValidationError
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from frozen_answers.answer import Frozen, read_frozen, write_frozen
from frozen_answers.cases import all_cases
from frozen_answers.compare import compare
from frozen_answers.run import Computed, run
from frozen_answers.show import as_json, print_comparison
from localizer import SkyfixError
from sim import SimulationError

FROZEN = Path(__file__).parents[1] / "answers.jsonl"
RESULTS = Path("build/answers/now.jsonl")
SLOWEST = 5
LINES = 20


@click.command(
    epilog="Example: python -m frozen_answers 'twins/*' 'drive/*'. Exit status: 0 all the same, 1 something differs, 2 bad use."
)
@click.argument("patterns", nargs=-1)
@click.option("--jobs", type=click.IntRange(1, 64), default=2, show_default=True, help="Processes.")
@click.option("--fresh", is_flag=True, help="Compute all again, also what the same code has computed.")
@click.option("--freeze", is_flag=True, help="Write the answers of now into the file of frozen ones.")
@click.option("--list", "only_list", is_flag=True, help="List the cases; compute nothing.")
@click.option("--json", "json_wanted", is_flag=True, help="Print the differences as one JSON object.")
@click.option(
    "--frozen",
    type=click.Path(dir_okay=False, path_type=Path),
    default=FROZEN,
    help="The file to compare with.",
)
@click.option(
    "--results",
    type=click.Path(dir_okay=False, path_type=Path),
    default=RESULTS,
    show_default=True,
    help="Where the answers of now are kept; an interrupted run goes on from there.",
)
def main(
    patterns: tuple[str, ...],
    jobs: int,
    fresh: bool,
    freeze: bool,
    only_list: bool,
    json_wanted: bool,
    frozen: Path,
    results: Path,
) -> None:
    """Compare what the search answers now with the frozen answers.

    PATTERNS select cases by kind or name, as twins, 'twins/*' or readings/no-compass; all without.
    """
    names = chosen(all_cases(), patterns)
    if only_list:
        click.echo("\n".join(names))
        return
    before = _frozen(frozen, absent_will_do=freeze)
    try:
        with progress(len(names)) as report:
            computed = run(names, results, jobs=jobs, fresh=fresh, report=report)
    except (SimulationError, SkyfixError, OSError) as error:
        raise BadUseError(f"{error}") from None
    now = {name: one.found for name, one in computed.items()}
    if freeze:
        _freeze(frozen, before, now, whole=not patterns)
        return
    known = before if not patterns else {name: before[name] for name in names if name in before}
    comparisons = compare(known, now)
    if json_wanted:
        click.echo(as_json(comparisons))
    else:
        print_comparison(Console(width=None if sys.stdout.isatty() else 160), comparisons)
        _print_times(list(computed.values()))
    if any(comparison.explanation for comparison in comparisons):
        sys.exit(1)


def chosen(names: Iterable[str], patterns: Sequence[str]) -> list[str]:
    """The cases that the patterns select. Raises BadUseError if one selects none."""
    every: list[str] = list(names)
    found: list[str] = []
    for pattern in patterns or ["*"]:
        matching = [
            name
            for name in every
            if fnmatch.fnmatchcase(name, pattern) or fnmatch.fnmatchcase(name, f"{pattern}/*")
        ]
        if not matching:
            raise BadUseError(f"{pattern}: no case has such a name; --list lists them")
        found += [name for name in matching if name not in found]
    return found


class BadUseError(click.ClickException):
    """One line on standard error, and exit status 2."""

    exit_code = 2


def _frozen(path: Path, *, absent_will_do: bool) -> dict[str, Frozen]:
    try:
        return read_frozen(path)
    except FileNotFoundError:
        if absent_will_do:
            return {}
        raise BadUseError(f"{path}: no such file; --freeze writes it") from None
    except (OSError, ValidationError) as error:
        raise BadUseError(f"{path}: {str(error).splitlines()[0]}") from None


def _freeze(path: Path, before: dict[str, Frozen], now: dict[str, Frozen], *, whole: bool) -> None:
    """``whole``: all cases were computed, so that others are gone."""
    defects = [name for name, one in now.items() if any(answer.status == "error" for answer in one.answers)]
    if defects:
        raise BadUseError(f"{defects[0]}: ended in an error of the program; nothing is frozen")
    write_frozen(path, (now if whole else {**before, **now}).values())
    click.echo(f"{len(now)} answers frozen in {path}", err=True)


def _print_times(computed: list[Computed]) -> None:
    cpu_s = sum(one.cpu_s for one in computed)
    slowest = sorted(computed, key=lambda one: -one.cpu_s)[:SLOWEST]
    named = ", ".join(f"{one.found.case} {one.cpu_s:.0f} s" for one in slowest)
    click.echo(f"     {cpu_s:.0f} s of processor time; slowest: {named}")


@contextmanager
def progress(cases: int) -> Iterator[Callable[[Computed, bool], None]]:
    """A callback for finished cases: a bar on a terminal, else occasional lines, on standard error."""
    console = Console(stderr=True)
    done = taken = 0
    columns = BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(), TextColumn("{task.description}")
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("", total=cases)

        def report(computed: Computed, kept: bool) -> None:
            nonlocal done, taken
            done, taken = done + 1, taken + kept
            bar.update(task, advance=1, description=computed.found.case)
            if not console.is_terminal and not kept and done % max(cases // LINES, 1) == 0:
                console.print(f"{done} of {cases}: {computed.found.case}", markup=False, highlight=False)

        yield report
    if taken:
        console.print(
            f"{taken} of {cases} were computed by the same code before; --fresh computes them again",
            markup=False,
            highlight=False,
        )


if __name__ == "__main__":
    main()
