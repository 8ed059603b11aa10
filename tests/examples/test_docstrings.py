"""The examples in the docstrings of what `localizer` exports."""

import doctest
import inspect
from pathlib import Path
from typing import Any

import pytest
from doc_examples import examples_of, require_what_it_says

import localizer

EXAMPLES = list(
    examples_of({"localizer": localizer} | {name: getattr(localizer, name) for name in localizer.__all__})
)


@pytest.mark.long
@pytest.mark.parametrize("example", EXAMPLES, ids=lambda example: example.name)
def test_the_example_in_a_docstring_gives_what_it_says(
    example: doctest.DocTest, in_drive: Path, result: localizer.LocateResult
) -> None:
    require_what_it_says(example, {"localizer": localizer, "Path": Path, "result": result})


def test_every_function_has_an_example() -> None:
    functions: list[tuple[str, Any]] = [
        (name, thing) for name in localizer.__all__ if inspect.isfunction(thing := getattr(localizer, name))
    ]
    assert functions
    assert not {name for name, _ in functions} - {example.name for example in EXAMPLES}
