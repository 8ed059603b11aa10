"""The reader of JSON and TOML from outside: limits on size, depth and numbers, and errors of one line.

Whoever reads a file, a socket or a request says before the message which one it was: ``f"{path}: {error}"``.
"""

import json
import math
import os
import re
import select
import stat
import time
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from localizer.errors import SkyfixError

MOST_JSON_BYTES = 8_000_000
MOST_TOML_BYTES = 1_000_000
MOST_VALUES = 500_000
DEEPEST = 64
MOST_DIGITS = 300
"""Most digits of an integer; longer ones exceed the range of a double."""
PIPE_S = 5.0
"""Time limit for reading a pipe."""
_READ_BYTES = 1 << 20

# Each part of a dotted key is one level more, and ``tomllib`` takes a time that grows with the square of their number:
# https://github.com/python/cpython/issues/149231.
_LONG_KEY = re.compile(
    r"""(?:\.[ \t]*(?:[A-Za-z0-9_-]+|"[^"\n]{0,200}"|'[^'\n]{0,200}')[ \t]*){%d}""" % DEEPEST  # noqa: UP031
)


class DocumentError(SkyfixError):
    """A refused document. The message follows the document's name: "is nested more than 64 deep"."""


def read_file(path: Path, most_bytes: int) -> bytes:
    """The whole of a file, or of a pipe that somebody writes to within ``PIPE_S``.

    Raises ``OSError`` where there is nothing to read, ``DocumentError`` where there is more than ``most_bytes``.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC | os.O_NOCTTY)
    except ValueError:  # a zero byte in the name
        raise DocumentError("is no name that a file can have") from None
    try:
        waits = not stat.S_ISREG(os.fstat(descriptor).st_mode)
        until_s = time.monotonic() + PIPE_S
        parts: list[bytes] = []
        left = most_bytes + 1
        while left > 0:
            if waits and not select.select([descriptor], [], [], max(0.0, until_s - time.monotonic()))[0]:
                raise DocumentError(f"is no file, and nothing has come from it within {PIPE_S:g} s")
            part = os.read(descriptor, min(left, _READ_BYTES))
            if not part:
                break
            parts.append(part)
            left -= len(part)
    finally:
        os.close(descriptor)
    content = b"".join(parts)
    _check_size(content, most_bytes)
    return content


def read_json(path: Path, most_bytes: int = MOST_JSON_BYTES) -> Any:
    """The values in a JSON file. Raises ``OSError`` and ``DocumentError``."""
    return json_values(read_file(path, most_bytes), most_bytes)


def read_toml(path: Path, most_bytes: int = MOST_TOML_BYTES, *, dotted: bool = False) -> dict[str, Any]:
    """The tables of a TOML file; ``dotted`` as ``toml_values`` has it. Raises ``OSError`` and ``DocumentError``."""
    return toml_values(read_file(path, most_bytes), most_bytes, dotted=dotted)


def json_text(content: bytes | str, most_bytes: int = MOST_JSON_BYTES) -> str:
    """The text of a JSON document for another parser (pydantic's), once it has been found sound. ``DocumentError``."""
    json_values(content, most_bytes)
    return _decoded(content)


def json_values(content: bytes | str, most_bytes: int = MOST_JSON_BYTES) -> Any:
    """The values of a JSON document: UTF-8, with or without a byte order mark. Raises ``DocumentError``.

    Stricter than the standard asks, as what follows is: no name twice in one object, no number that a double cannot hold, no
    NaN, no zero character and no half of a surrogate pair in a text.
    """
    _check_size(content, most_bytes)
    text = _decoded(content)
    if sum(map(text.count, ",[{")) > MOST_VALUES:
        raise DocumentError(f"holds more than {MOST_VALUES} values")
    try:
        values = json.loads(text, parse_int=_whole_number, object_pairs_hook=_each_name_once)
    except RecursionError:
        raise DocumentError(f"is nested more than {DEEPEST} deep") from None
    except ValueError as error:
        raise DocumentError(f"Invalid JSON: {error}") from None
    _check_values(values, _json_place)
    return values


def toml_values(
    content: bytes | str, most_bytes: int = MOST_TOML_BYTES, *, dotted: bool = False
) -> dict[str, Any]:
    """The tables of a TOML document: UTF-8, with or without a byte order mark. Raises ``DocumentError``.

    The error names a place as ``[camera] fx_px``, or as ``camera.fx_px`` where ``dotted``.

    Numbers and texts as ``json_values`` has them; TOML's inf and nan are in no file of ours.
    """
    _check_size(content, most_bytes)
    text = _decoded(content)
    if _LONG_KEY.search(text):
        raise DocumentError(f"is nested more than {DEEPEST} deep")
    try:
        tables = tomllib.loads(text)
    except RecursionError:
        raise DocumentError(f"is nested more than {DEEPEST} deep") from None
    except ValueError as error:  # tomllib's own error is one; others come of numbers and dates
        raise DocumentError(f"is not valid TOML: {error}") from None
    _check_values(tables, _json_place if dotted else _toml_place)
    return tables


def toml_text(content: bytes, most_bytes: int = MOST_TOML_BYTES) -> str:
    """The text of a TOML document that is sound, without a byte order mark, to be changed. ``DocumentError``."""
    toml_values(content, most_bytes)
    return _decoded(content)


def _check_size(content: bytes | str, most_bytes: int) -> None:
    if len(content) > most_bytes:
        raise DocumentError(f"is larger than {most_bytes / 1e6:g} MB")


def _decoded(content: bytes | str) -> str:
    if isinstance(content, str):
        return content.removeprefix("\ufeff")
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise DocumentError("is UTF-16 text; save it as UTF-8")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise DocumentError(
            f"is not UTF-8 text (byte 0x{content[error.start]:02x} at {error.start}); save it as UTF-8"
        ) from None


def _whole_number(digits: str) -> int:
    if len(digits) > MOST_DIGITS:
        raise ValueError(f"a number of {len(digits)} digits")
    return int(digits)


def _each_name_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        seen: set[str] = set()
        twice = next(name for name, _ in pairs if name in seen or seen.add(name))  # type: ignore[func-returns-value]
        raise ValueError(f"{_short(twice)} occurs twice in one object")
    return found


def _check_values(root: Any, named: Callable[[list[Any]], str]) -> None:
    """Check all values below ``root``, iteratively: a recursion could overflow on deeply nested values."""
    waiting: list[tuple[Any, tuple[Any, ...] | None, int]] = [(root, None, 0)]
    wrong: str | None = None
    while waiting and wrong is None:
        value, place, depth = waiting.pop()
        if isinstance(value, dict | list):
            if depth >= DEEPEST:
                raise DocumentError(f"is nested more than {DEEPEST} deep")
            items = value.items() if isinstance(value, dict) else enumerate(value)
            for key, each in items:
                wrong = wrong or (_wrong_text(key) if isinstance(key, str) else None)
                waiting.append((each, (place, key), depth + 1))
        elif isinstance(value, str):
            wrong = _wrong_text(value)
        elif isinstance(value, float) and not math.isfinite(value):
            wrong = f"input should be a finite number (found {value})"
        elif isinstance(value, int) and abs(value) >= 10**MOST_DIGITS:
            wrong = f"is a number of more than {MOST_DIGITS} digits"
    if wrong is not None:
        keys: list[Any] = []
        while place is not None:
            place, key = place
            keys.append(key)
        name = named(keys[::-1])[:200]
        raise DocumentError(f"{name}: {wrong}" if name else wrong)


def _wrong_text(text: str) -> str | None:
    if "\0" in text:
        return f"should have no control characters (found {_short(text)})"
    if not text.isascii() and any("\ud800" <= letter <= "\udfff" for letter in text):
        return f"should be text, not half of a surrogate pair (found {_short(text)})"
    return None


def _json_place(keys: list[Any]) -> str:
    """``camera.distortion[2]``."""
    return "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in keys).lstrip(".")


def _toml_place(keys: list[Any]) -> str:
    """``[camera] distortion``, as ``rig.config.problems`` names it."""
    names = [key for key in keys if isinstance(key, str)]
    return f"[{'.'.join(names[:-1])}] {names[-1]}" if names[1:] else "".join(names)


def _short(text: str) -> str:
    return repr(text if len(text) <= 40 else text[:40] + "...")
