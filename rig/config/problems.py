"""Error messages for a configuration, with section and key named as in the file."""

import difflib
import re
from collections.abc import Iterator
from typing import Any, get_args, get_origin

from pydantic import BaseModel
from pydantic_core import ErrorDetails

from rig.config.camera_url import shown

PROBLEMS_NAMED = 3

Keys = tuple[str, ...]


def joined(problems: list[str]) -> str:
    """All problems in one line: the first few, and the number of the others."""
    distinct = list(dict.fromkeys(problems))
    more = len(distinct) - PROBLEMS_NAMED
    return "; ".join(distinct[:PROBLEMS_NAMED]) + (f"; and {more} more" if more > 0 else "")


def wrong_keys(table: dict[str, Any], model: type[BaseModel], section: Keys = ()) -> Iterator[str]:
    """A sentence for each key or section that is unknown or missing (a misspelt one is not missing)."""
    absent = [key for key in model.model_fields if key not in table]
    missing = {key for key in absent if model.model_fields[key].is_required()}
    for key in [key for key in table if key not in model.model_fields]:
        is_section = isinstance(table[key], dict)
        meant = _closest_key(key, absent)
        missing.difference_update(meant)
        hint = "".join(
            f"; did you mean {_section((*section, name)) if is_section else name}?" for name in meant
        )
        yield f"{_place((*section, key), is_section)}: unknown {_noun(is_section)}{hint}"
    for key, field in model.model_fields.items():
        models = _models(field.annotation)
        if key in missing:
            yield f"{_place((*section, key), bool(models))}: missing {_noun(bool(models))}"
        elif key in table and models:
            # [[section]] may be repeated
            several = get_origin(field.annotation) is tuple and isinstance(table[key], list)
            for each in table[key] if several else [table[key]]:
                yield from _wrong_keys_in_section(each, models, (*section, key))


def wrong_value(error: ErrorDetails, tables: dict[str, Any]) -> str:
    """The sentence for one value that pydantic does not accept, once ``wrong_keys`` has nothing to say."""
    keys, value = _found(error["loc"], tables)
    message = error["msg"].removeprefix("Value error, ")
    if error["type"] == "value_error":
        names_its_place = re.match(r"\[[a-z_.]+\] ", message)
        return message if names_its_place else f"{_place(keys, isinstance(value, dict))}: {message}"
    if error["type"] in ("missing", "too_short", "too_long"):
        message = "wrong number of values"
    found = shown(value) if isinstance(value, str) else value  # a URL may have a password in it
    return f"{_place(keys)}: {message[:1].lower()}{message[1:]} (found {found!r})"


def _closest_key(key: str, absent: list[str]) -> list[str]:
    """The most similar absent key: one or none."""
    starting_alike = [name for name in absent if name.startswith(key)]
    return starting_alike[:1] or difflib.get_close_matches(key, absent, n=1, cutoff=0.6)


def _wrong_keys_in_section(table: Any, models: list[type[BaseModel]], section: Keys) -> Iterator[str]:
    if not isinstance(table, dict):
        yield f"{_place(section)}: must be a section, {_section(section)}"
    elif len(models) == 1:
        yield from wrong_keys(table, models[0], section)
    elif "kind" not in table:
        yield f"{_place((*section, 'kind'))}: missing key"
    else:
        kinds = {kind: model for model in models for kind in get_args(model.model_fields["kind"].annotation)}
        if table["kind"] in kinds:
            yield from wrong_keys(table, kinds[table["kind"]], section)
        else:
            yield f"{_place((*section, 'kind'))}: {table['kind']!r} is none of {', '.join(kinds)}"


def _found(location: tuple[int | str, ...], tables: dict[str, Any]) -> tuple[Keys, Any]:
    """Keys and value in the file. Pydantic's location also contains union branches and list positions."""
    keys: list[str] = []
    value: Any = tables
    for part in location:
        if isinstance(value, dict) and part in value:
            value = value[part]
            keys.append(str(part))
    return tuple(keys), value


def _place(keys: Keys, is_section: bool = False) -> str:
    if is_section or not keys[:-1]:
        return _section(keys) if is_section else keys[0]
    return f"{_section(keys[:-1])} {keys[-1]}"


def _section(keys: Keys) -> str:
    return f"[{'.'.join(keys)}]"


def _noun(is_section: bool) -> str:
    return "section" if is_section else "key"


def _models(annotation: Any) -> list[type[BaseModel]]:
    """The section models of a field: none for a plain value, several if ``kind`` selects one."""
    if isinstance(annotation, type):
        return [annotation] if issubclass(annotation, BaseModel) else []
    return [model for part in get_args(annotation) for model in _models(part)]
