"""The page of the rig's configuration file: every key, by the models that read it."""

import re
from collections.abc import Iterator
from typing import Any, get_args, get_origin

from pydantic import BaseModel

from generate.fields import description, docstrings, field_rows
from generate.markdown import GENERATED, code, escaped, from_docstring, table
from rig.config.sections import AllSections

INTRODUCTION = """\
A rig is described by one TOML file. `--config` names it, or the environment variable `SKYFIX_CONFIG`. Copy
[configs/vehicle.toml](../../configs/vehicle.toml) and go through it from top to bottom. This page lists all keys with
their types, ranges and defaults. An unknown key is an error, and so is a value out of its range. Relative paths start
from the file's folder.

The head's axes are right (x), along the line of sight (y) and up (z); the vehicle's are right, forward and up. They are
the same at pan 0 and tilt 0. Pan turns clockwise seen from above, tilt turns up.
"""
_NAMED = re.compile(r"^``\[.*?``(?: (?:and|with) ``.*?``)*: ")


def configuration_page() -> str:
    """All sections."""
    sections = (_section(name, model) for name, model in sections_of(AllSections))
    return "\n".join(["# Configuration\n", GENERATED, INTRODUCTION, *sections])


def sections_of(model: type[BaseModel], prefix: str = "") -> Iterator[tuple[str, type[BaseModel]]]:
    """Each table of the file as it is opened, with its model; once for each model that it may be of."""
    for name, field in model.model_fields.items():
        several = get_origin(field.annotation) is tuple
        for inner in _models_of(field.annotation):
            yield f"[[{prefix}{name}]]" if several else f"[{prefix}{name}]", inner
            yield from sections_of(inner, f"{prefix}{name}.")


def _models_of(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in get_args(annotation) for model in _models_of(part)]


def _section(name: str, model: type[BaseModel]) -> str:
    kinds = get_args(model.model_fields["kind"].annotation) if "kind" in model.model_fields else ()
    title = name + (f", kind {', '.join(kinds)}" if kinds else "")
    text = _NAMED.sub("", description(model))
    text = from_docstring(text[:1].upper() + text[1:])
    header = ["key", "type", "unit", "range", "default", "meaning"]
    return f"## {escaped(title)}\n\n{text}\n\n{table(header, key_rows(model))}"


def key_rows(model: type[BaseModel]) -> list[list[str]]:
    """The rows of a section's table; what is itself a section is left out."""
    schema = model.model_json_schema()
    keys = [key for key, field in model.model_fields.items() if not _models_of(field.annotation)]
    schema = {**schema, "properties": {key: schema["properties"][key] for key in keys}}
    return [
        [
            code(row.name),
            row.kind.replace(" or null", ""),  # TOML has none
            row.unit,
            row.limits,
            row.default or "required",
            row.meaning,
        ]
        for row in field_rows(schema, docstrings(model))
    ]
