"""What `import localizer` gives: complete and documented. What holds for all packages is in tests/test_public.py."""

import ast
import dataclasses
import inspect
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from numpydoc.validate import validate
from pydantic import BaseModel

import localizer
from localizer import experiments

PACKAGE = Path(localizer.__file__).parent
STYLE = {
    # what a docstring must have is checked; of the order and the words only what holds everywhere here
    "GL05", "GL06", "GL07", "GL08", "GL10", "SS01", "SS02", "SS03", "SS04", "SS06",
    "PR01", "PR02", "PR03", "PR04", "PR05", "PR07", "PR08", "PR09", "PR10", "RT01", "RT03", "RT04", "RT05",
    "SA02", "SA04",
}  # fmt: skip
VERB_FIRST = "SS05"
FUNCTIONS = sorted(name for name in localizer.__all__ if inspect.isfunction(getattr(localizer, name)))
CLASSES = sorted(name for name in localizer.__all__ if inspect.isclass(getattr(localizer, name)))
METHODS = [
    "Fix.error_ellipse",
    "Fix.to_json",
    "Movement.from_heading",
    "Tracker.step",
    "Tracker.to_json",
    "Tracker.from_json",
    "Truth.distance_m",
]


def test_every_public_name_is_a_function_or_a_class() -> None:
    assert len(FUNCTIONS) + len(CLASSES) == len(localizer.__all__)


def test_import_star_gives_the_public_names_and_leaves_the_importers_version_alone() -> None:
    names: dict[str, Any] = {"__version__": "mine"}
    exec("from localizer import *", names)
    assert set(localizer.__all__) <= set(names)
    assert names["__version__"] == "mine"


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="locale"):
        localizer.locale  # noqa: B018


def test_every_name_for_experiments_is_there_and_documented() -> None:
    assert experiments.__doc__ is not None
    for name in experiments.__all__:
        assert getattr(experiments, name) is not None
        assert f"`{name}`" in experiments.__doc__


def _imports(path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module is not None:
            yield node.module
        if isinstance(node, ast.Import):
            yield from (name.name for name in node.names)


@pytest.mark.parametrize("room", ["paper", "evaluate"])
def test_an_experiment_of_the_simulator_imports_only_what_is_public(room: str) -> None:
    public = {"localizer", "localizer.experiments"}
    reader = "localizer.documents"  # of all that comes from outside in JSON, see test_one_reader
    for path in (PACKAGE.parent / "sim" / room).rglob("*.py"):
        private = {m for m in _imports(path) if m.split(".")[0] == "localizer"} - public - {reader}
        assert not private, path


def _defects(name: str, checks: set[str]) -> list[str]:
    return [f"{code} {text}" for code, text in validate(f"localizer.{name}")["errors"] if code in checks]


@pytest.mark.parametrize("name", [*FUNCTIONS, *METHODS])
def test_a_functions_docstring_is_in_numpydoc_style(name: str) -> None:
    short = {"RT01", "PR01"} if name.endswith("json") else set()  # one line says it all
    verb = set() if name.endswith("to_json") else {VERB_FIRST}
    assert not _defects(name, (STYLE | verb) - short)


@pytest.mark.parametrize("name", CLASSES)
def test_a_classs_docstring_is_in_numpydoc_style(name: str) -> None:
    fields = {"PR01", "PR02", "PR03"}  # they are attributes
    assert not _defects(name, STYLE - fields)


def _fields(thing: type) -> set[str]:
    if issubclass(thing, BaseModel):
        return set(thing.model_fields) - {"schema_name"}
    if dataclasses.is_dataclass(thing):
        return {field.name for field in dataclasses.fields(thing)}
    return set(getattr(thing, "_fields", ()))


def _explained_below(thing: type) -> set[str]:
    """Fields with a string after them."""
    (body,) = (
        node.body for node in ast.parse(inspect.getsource(thing)).body if isinstance(node, ast.ClassDef)
    )
    return {
        node.target.id
        for node, after in pairwise(body)
        if isinstance(node, ast.AnnAssign)
        and isinstance(node.target, ast.Name)
        and isinstance(after, ast.Expr)
    }


@pytest.mark.parametrize("name", CLASSES)
def test_every_field_of_a_public_class_is_explained(name: str) -> None:
    thing = getattr(localizer, name)
    _, _, listed = (thing.__doc__ or "").partition("Attributes\n")
    lines = [line.strip() for line in listed.splitlines() if " : " in line]
    explained = {field for line in lines for field in line.split(" : ")[0].split(", ")}
    assert _fields(thing) <= explained or _fields(thing) <= explained | _explained_below(thing)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_function_takes_few_arguments_by_position(name: str) -> None:
    parameters = inspect.signature(getattr(localizer, name)).parameters.values()
    by_position = [p for p in parameters if p.kind is not inspect.Parameter.KEYWORD_ONLY]
    assert len(by_position) <= 5
