"""`make mutate`: put small faults into modules, one at a time, and see whether the tests notice."""

import sys
from pathlib import Path

import click

from mutate.mutants import mutants_of
from mutate.score import GOAL, Book, Score, share_noticed, unexplained, write_page
from mutate.trial import try_modules

BOOK = Book(Path(__file__).parents[1])


@click.command()
@click.argument("modules", nargs=-1)
@click.option("--all", "every", is_flag=True, help="Every module of modules.toml.")
@click.option(
    "--most", type=click.IntRange(min=1), help="Try at most so many mutants of a module, chosen at random."
)
@click.option("--jobs", type=click.IntRange(min=1), default=2, show_default=True, help="Modules at a time.")
@click.option("--list", "only_list", is_flag=True, help="List the mutants and try none.")
@click.option("--keep/--no-keep", default=True, help="Write scores.json and the table of docs/testing.md.")
def main(
    modules: tuple[str, ...], *, every: bool, most: int | None, jobs: int, only_list: bool, keep: bool
) -> None:
    """Put small faults into MODULES (paths, or parts of paths), one at a time, and run their tests.

    Without MODULES: those that have changed since their score was measured.
    """
    chosen = _chosen(modules, every=every)
    if only_list:
        for module in chosen:
            for mutant in mutants_of((BOOK.root / module).read_text()):
                click.echo(f"{module}:{mutant.line}: {mutant.name}")
        return
    work = BOOK.root / "build" / "mutation"
    below = 0
    for number, result in enumerate(try_modules(BOOK.root, work, chosen, most=most, jobs=jobs), 1):
        if result.refused:
            click.echo(f"[{number}/{len(chosen)}] {result.module}: not tried: {result.refused}")
            below += 1
            continue
        score = BOOK.score(result)
        if keep:
            BOOK.keep(result.module, score)
        below += _say(
            f"[{number}/{len(chosen)}] {result.module}", score, BOOK.explanations().get(result.module, {})
        )
    if keep:
        write_page(BOOK, BOOK.root / "docs" / "testing.md")
    sys.exit(1 if below else 0)


def _chosen(parts: tuple[str, ...], *, every: bool) -> dict[str, list[str]]:
    known = BOOK.modules()
    if every:
        return known
    if not parts:
        return {module: known[module] for module in BOOK.stale()}
    chosen = {module: known[module] for module in known if any(part in module for part in parts)}
    for part in parts:
        if not any(part in module for module in known):
            raise click.BadParameter(
                f"no module of modules.toml has {part} in its path", param_hint="MODULES"
            )
    return chosen


def _say(what: str, score: Score, explanations: dict[str, str]) -> bool:
    """Print a module's score and what survived; tell whether it is below the goal."""
    share = share_noticed(score, explanations)
    click.echo(
        f"{what}: {share:.0%} noticed, {score.tried} of {score.mutants} mutants tried, {score.cpu_s} s of CPU"
    )
    for name in unexplained(score, explanations):
        click.echo(f"    {name}")
    return share < GOAL


if __name__ == "__main__":
    main()
