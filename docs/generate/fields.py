"""The fields of a pydantic model as rows of a table: type, unit, limits, default, and what its docstring says."""

import ast
import inspect
import json
import re
import textwrap
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel

from generate.markdown import code, from_docstring

Schema = Mapping[str, Any]

UNITS = {
    "deg_s2": "°/s²",
    "deg_s": "°/s",
    "mg_c": "mg/°C",
    "m_h": "m/h",
    "m2": "m²",
    "mg": "mg",
    "ut": "µT",
    "hpa": "hPa",
    "deg": "°",
    "px": "px",
    "ms": "ms",
    "mb": "MB",
    "rad": "rad",
    "c": "°C",
    "m": "m",
    "s": "s",
    "v": "V",
    "k": "K",
    "ev": "EV",
    "fraction": "1",
    "share": "1",
}
"""Units by the suffix of a field's name; a longer suffix goes before one that ends alike."""
_LIMITS = (
    ("exclusiveMinimum", "> "),
    ("minimum", "≥ "),
    ("exclusiveMaximum", "< "),
    ("maximum", "≤ "),
)


@dataclass(frozen=True)
class FieldRow:
    """One field. ``default`` is None where the field has to be given."""

    name: str
    kind: str
    unit: str
    limits: str
    default: str | None
    meaning: str


def unit_of(name: str) -> str:
    """The unit that a field's name ends in; empty where it has none."""
    return next((unit for suffix, unit in UNITS.items() if name.endswith(f"_{suffix}")), "")


def docstrings(model: type[BaseModel]) -> dict[str, str]:
    """What is said of each field, by its name: below it in the source, else in the class's section "Attributes" (numpydoc).

    Of what the model derives from, too.
    """
    found: dict[str, str] = {}
    for base in reversed(model.__mro__):
        if issubclass(base, BaseModel) and base is not BaseModel:
            found |= _attributes(base.__doc__ or "") | _class_docstrings(base)
    return found


def description(model: type[BaseModel]) -> str:
    """A class's docstring before its first section, without the breaks of its lines."""
    return " ".join(_SECTION.split(inspect.cleandoc(model.__doc__ or ""))[0].split())


_SECTION = re.compile(r"^(\w[\w ]*)\n-{3,}\n", re.MULTILINE)


def _attributes(docstring: str) -> dict[str, str]:
    _, *sections = _SECTION.split(inspect.cleandoc(docstring))
    texts = dict(zip(sections[::2], sections[1::2], strict=True)).get("Attributes", "")
    entries = re.findall(r"^(\S.*?)(?: : .*)?\n((?:[ ]+.*\n?|\n)+)", texts + "\n", re.MULTILINE)
    return {name.strip(): " ".join(text.split()) for names, text in entries for name in names.split(",")}


def _class_docstrings(model: type[BaseModel]) -> dict[str, str]:
    (definition,) = ast.parse(textwrap.dedent(inspect.getsource(model))).body
    assert isinstance(definition, ast.ClassDef)
    found = {}
    for field, below in zip(definition.body, definition.body[1:], strict=False):
        is_text = isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant)
        if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name) and is_text:
            text = ast.literal_eval(below.value)  # type: ignore[attr-defined]
            found[field.target.id] = " ".join(str(text).split())
    return found


def models_in(model: type[BaseModel]) -> Iterator[type[BaseModel]]:
    """A model and all models that its fields are made of, each once."""
    waiting: list[Any] = [model]
    seen: set[Any] = set()
    while waiting:
        here = waiting.pop(0)
        if inspect.isclass(here) and issubclass(here, BaseModel):
            if here not in seen:
                seen.add(here)
                yield here
                waiting += [field.annotation for field in here.model_fields.values()]
        else:
            waiting += list(getattr(here, "__args__", ()))
            waiting += [value for value in [getattr(here, "__value__", None)] if value is not None]


def field_rows(schema: Schema, meanings: Mapping[str, str], link: str = "") -> list[FieldRow]:
    """The rows of one object of a JSON Schema; ``link`` goes before the anchors of the objects in it."""
    required = set(schema.get("required", ()))
    return [
        FieldRow(
            name=name,
            kind=kind_of(field, link),
            unit=unit_of(name),
            limits=limits_of(field),
            default=None if name in required or "default" not in field else _default(field["default"]),
            meaning=from_docstring(meanings.get(name, field.get("description", ""))),
        )
        for name, field in schema.get("properties", {}).items()
    ]


def kind_of(field: Schema, link: str = "") -> str:
    """A type in words: ``number``, ``array of 3 numbers``, ``"fix" or "none"``, a link to an object."""
    if "$ref" in field:
        name = field["$ref"].rpartition("/")[2]
        return f"[{name}]({link}#{name.lower()})"
    if "const" in field:
        return code(json.dumps(field["const"]))
    if "enum" in field:
        *most, last = (code(json.dumps(value)) for value in field["enum"])
        return f"{', '.join(most)} or {last}" if most else last
    for several in ("anyOf", "oneOf"):
        if several in field:
            return " or ".join(dict.fromkeys(kind_of(each, link) for each in field[several]))
    if field.get("type") == "array":
        return _array(field, link)
    if field.get("type") == "object":
        values = field.get("additionalProperties")
        return f"object of {kind_of(values, link)} values" if isinstance(values, dict) else "object"
    named = {"date-time": "time", "path": "path"}
    return named.get(field.get("format", ""), str(field.get("type", "any value")))


def _array(field: Schema, link: str) -> str:
    if "prefixItems" in field:
        kinds = list(dict.fromkeys(kind_of(each, link) for each in field["prefixItems"]))
        count = len(field["prefixItems"])
        return f"array of {count} {_plural(kinds[0])}" if len(kinds) == 1 else f"array: {', '.join(kinds)}"
    if "items" not in field:
        return "array"
    count_text = f"{field['maxItems']} " if field.get("minItems", 0) == field.get("maxItems") else ""
    return f"array of {count_text}{_plural(kind_of(field['items'], link))}"


def _plural(kind: str) -> str:
    first, space, rest = kind.partition(" ")
    return f"{first}s{space}{rest}" if first.isalpha() and " or " not in kind else kind


def limits_of(field: Schema) -> str:
    """The range of a number, of an array's items, or of a text's length."""
    for several in ("anyOf", "oneOf"):
        if several in field:
            return ", ".join(dict.fromkeys(text for each in field[several] if (text := limits_of(each))))
    if field.get("type") == "array":
        inner = field.get("items") or (field.get("prefixItems") or [{}])[0]
        parts = [limits_of(inner)]
        if "prefixItems" not in field and field.get("minItems") != field.get("maxItems"):
            parts.append(_count(field, "minItems", "maxItems", "items"))
        return ", ".join(part for part in parts if part)
    if "minimum" in field and "maximum" in field:
        return f"{_number(field['minimum'])} to {_number(field['maximum'])}"
    parts = [f"{sign}{_number(field[key])}" for key, sign in _LIMITS if key in field]
    return ", ".join([*parts, *filter(None, [_count(field, "minLength", "maxLength", "characters")])])


def _number(value: float) -> str:
    return str(int(value)) if value == int(value) else str(value)


def _count(field: Schema, least: str, most: str, what: str) -> str:
    if field.get(least) and most in field:
        return f"{field[least]} to {field[most]} {what}"
    if most in field:
        return f"at most {field[most]} {what}"
    if least in field:
        return f"at least {field[least]} {what if field[least] > 1 else what.rstrip('s')}"
    return ""


def _default(value: Any) -> str:
    return "absent" if value is None else code(json.dumps(value, ensure_ascii=False))
