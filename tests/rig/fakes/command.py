"""What tests of the command ``rig`` share."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from fakes.whole_rig import RunningRig

Run = Callable[..., tuple[int, str, str]]


def toml(tables: dict[str, Any], prefix: str = "") -> str:
    """TOML of nested tables of plain values."""
    values = [f"{key} = {json.dumps(v)}" for key, v in tables.items() if not isinstance(v, dict)]
    sections = [
        f"\n[{prefix}{key}]\n{toml(v, f'{prefix}{key}.')}" for key, v in tables.items() if isinstance(v, dict)
    ]
    return "\n".join(values) + "\n" + "".join(sections)


def written(running: RunningRig, folder: Path, **changes: dict[str, object] | None) -> Path:
    path = folder / "rig.toml"
    path.write_text(toml(running.settings(**changes)))
    return path


def one_line(result: tuple[int, str, str]) -> str:
    """The line that bad input ends with."""
    status, out, err = result
    assert status == 2
    assert out == ""
    assert err.startswith("rig")
    assert err.count("\n") == 1
    assert err.endswith("\n")
    return err.rstrip("\n")
