"""Reads JSON and TOML input of the simulator's commands with skyfix's common reader.

Worlds and devices of ``sim`` share no code with what they test; parsing of scripts and logs is not part of them.
"""

from pathlib import Path
from typing import Any

from localizer.documents import DocumentError, json_values, read_file, read_json, read_toml
from sim.errors import SimulationError

MAX_LOG_BYTES = 256_000_000


def toml_file(what: str, path: Path) -> dict[str, Any]:
    """The tables of a TOML file; ``what`` describes it in errors. Raises ``SimulationError``."""
    try:
        return read_toml(path, dotted=True)
    except OSError as error:
        raise SimulationError(
            f"{what} {path}: {error.strerror or error}; name a readable TOML file"
        ) from error
    except DocumentError as error:
        raise SimulationError(f"{what} {path}: {error}") from error


def json_file(what: str, path: Path) -> Any:
    """The values in a file. Raises ``SimulationError``."""
    try:
        return read_json(path)
    except OSError as error:
        raise SimulationError(
            f"{what} {path}: {error.strerror or error}; name a readable JSON file"
        ) from error
    except DocumentError as error:
        raise SimulationError(f"{what} {path}: {error}") from error


def log_lines(path: Path) -> list[bytes]:
    """The lines of a log of ``rig record``. Raises ``SimulationError``."""
    try:
        return read_file(path, MAX_LOG_BYTES).splitlines()
    except OSError as error:
        raise SimulationError(f"log {path}: {error.strerror or error}; name a readable file") from error
    except DocumentError as error:
        raise SimulationError(f"log {path}: {error}") from error


def values_of(content: bytes | str) -> Any:
    """The values of a JSON document. Raises ``SimulationError``, whose message continues the document's name."""
    try:
        return json_values(content)
    except DocumentError as error:
        raise SimulationError(str(error)) from error
