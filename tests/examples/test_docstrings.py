"""The examples in the docstrings of what `localizer` exports."""

import doctest
import inspect
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import localizer


def _examples() -> Iterator[doctest.DocTest]:
    finder = doctest.DocTestFinder(recurse=False)
    named = [("localizer", localizer), *((name, getattr(localizer, name)) for name in localizer.__all__)]
    for name, thing in named:
        yield from (test for test in finder.find(thing, name, globs={}) if test.examples)


EXAMPLES = list(_examples())


@pytest.mark.long
@pytest.mark.parametrize("example", EXAMPLES, ids=lambda example: example.name)
def test_the_example_in_a_docstring_gives_what_it_says(
    example: doctest.DocTest, in_drive: Path, result: localizer.LocateResult
) -> None:
    said: list[str] = []
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS)
    example.globs = {"localizer": localizer, "Path": Path, "result": result}
    runner.run(example, out=said.append)
    assert not said, "".join(said)


def test_every_function_has_an_example() -> None:
    functions: list[tuple[str, Any]] = [
        (name, thing) for name in localizer.__all__ if inspect.isfunction(thing := getattr(localizer, name))
    ]
    assert functions
    assert not {name for name, _ in functions} - {example.name for example in EXAMPLES}
