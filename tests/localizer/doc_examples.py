"""The examples in docstrings of what a package exports, and how one is run."""

import doctest
from collections.abc import Iterator, Mapping
from typing import Any

_FINDER = doctest.DocTestFinder(recurse=False)


def examples_of(things: Mapping[str, Any]) -> Iterator[doctest.DocTest]:
    """Of docstrings that have an example, under the names given."""
    for name, thing in things.items():
        yield from (test for test in _FINDER.find(thing, name, module=False, globs={}) if test.examples)


def require_what_it_says(example: doctest.DocTest, names: Mapping[str, Any]) -> None:
    """Run an example with these names; it fails where something else comes out."""
    example.globs = dict(names)
    said: list[str] = []
    doctest.DocTestRunner(optionflags=doctest.ELLIPSIS).run(example, out=said.append)
    assert not said, "".join(said)
