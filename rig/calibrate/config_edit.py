"""Edits the rig's configuration file in place: names a calibration file and changes nothing else."""

import json
import os
import re
from pathlib import Path
from typing import Any

from localizer.documents import MOST_TOML_BYTES, DocumentError, read_file, toml_text, toml_values
from rig.atomic import write_atomically
from rig.config.calibration_files import CalibrationError, CalibrationKind

_SECTION = re.compile(r"^\s*\[([^\[\]]+)\]", re.MULTILINE)


def name_in_config(config_path: Path, kind: CalibrationKind, file: Path) -> None:
    """Set ``[calibration] kind`` to ``file``, relative to the configuration's folder; comments and everything else
    stay.

    ``CalibrationError`` where the configuration cannot be written.
    """
    named = os.path.relpath(file, config_path.parent)
    try:
        before = toml_text(read_file(config_path, MOST_TOML_BYTES))
        after = with_calibration(before, kind, named)
        if toml_values(after) != _expected(toml_values(before), kind, named):
            raise CalibrationError(
                f"{config_path}: its [calibration] is laid out so that it cannot be changed safely; "
                f'write there: {kind} = "{named}"'
            )
        write_atomically(config_path, after.encode())
    except DocumentError as error:
        raise CalibrationError(
            f"{config_path}: {error}; write under [calibration]: {kind} = {named!r}"
        ) from error
    except OSError as error:
        raise CalibrationError(
            f"{config_path}: cannot be changed: {error.strerror}; write under [calibration]: {kind} = {named!r}"
        ) from error


def with_calibration(text: str, kind: CalibrationKind, named: str) -> str:
    """The configuration text with ``kind`` set in its section ``[calibration]``."""
    line = f"{kind} = {json.dumps(named)}"
    start = re.search(r"^\s*\[calibration\][^\n]*\n?", text, re.MULTILINE)
    if start is None:
        return f"{text.rstrip()}\n\n[calibration]\n{line}\n"
    following = _SECTION.search(text, start.end())
    end = following.start() if following else len(text)
    section = text[start.end() : end]
    changed, count = re.subn(rf"^\s*{kind}\s*=.*$", lambda _: line, section, count=1, flags=re.MULTILINE)
    head = text[: start.end()] if text[: start.end()].endswith("\n") else text[: start.end()] + "\n"
    return head + (changed if count else f"{line}\n{section}") + text[end:]


def _expected(tables: dict[str, Any], kind: CalibrationKind, named: str) -> dict[str, Any]:
    return {**tables, "calibration": {**tables.get("calibration", {}), kind: named}}
