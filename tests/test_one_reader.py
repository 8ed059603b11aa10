"""JSON and TOML from outside are read by ``localizer.documents`` and by nothing else."""

import ast
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
PARSERS = {"json.loads", "json.load", "validate_json", "model_validate_json"}
"""Of the standard library, and of any of pydantic's models."""
OWN = {
    "localizer/documents.py": "the reader",
    "localizer/predict/lens.py": "a camera whose fields the reader has read",
    "localizer/track/odometry.py": "text of the reader",
    "rig/daemon/http/map.py": "what its own process has drawn",
    "rig/daemon/search/worker.py": "what the daemon asks its own process",
    "rig/daemon/search/process.py": "what its own process answers",
    "rig/daemon/odometry/receiver.py": "the state that it has stored itself",
    "rig/commands/capture.py": "a fix of its own",
    "sim/commands/demo.py": "a fix of its own, and what its own command prints",
    "sim/rigs/calibration_trial.py": "what its own command prints",
    "sim/evaluate/table.py": "its own settings",
    "sim/evaluate/sensitivity/worker.py": "what its own process asks",
    "sim/evaluate/sensitivity/run.py": "what its own process answers",
}
"""Files that parse what does not come from outside, and what that is."""


def parsing(tree: ast.Module) -> Iterator[ast.Call]:
    """The calls of a parser whose argument has not gone through the reader."""
    for node in ast.walk(tree):
        if (
            isinstance(node, ast.Call)
            and isinstance(node.func, ast.Attribute)
            and PARSERS & {node.func.attr, ast.unparse(node.func)}
            and "json_text" not in ast.unparse(node)
        ):
            yield node


def test_nothing_else_parses_what_comes_from_outside() -> None:
    found = {
        path.relative_to(ROOT).as_posix(): [ast.unparse(call) for call in calls]
        for package in ("localizer", "rig", "sim")
        for path in (ROOT / package).rglob("*.py")
        if (calls := list(parsing(ast.parse(path.read_text(encoding="utf-8")))))
    }
    assert found.keys() <= OWN.keys(), {name: found[name] for name in found.keys() - OWN.keys()}


def test_nothing_else_imports_tomllib() -> None:
    for package in ("localizer", "rig", "sim"):
        for path in (ROOT / package).rglob("*.py"):
            if path.name != "documents.py":
                assert "tomllib" not in path.read_text(encoding="utf-8"), path
