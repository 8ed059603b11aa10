"""What a trial of a module shows, and which text of the module it was."""

import hashlib
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Result:
    """What became of a module's mutants."""

    module: str
    mutants: int
    """How many the module has."""
    tried: int
    survivors: tuple[str, ...]
    """Names of those that no test noticed."""
    cpu_s: float
    refused: str = ""
    """Why the module could not be tried."""


def source_digest(path: Path) -> str:
    """Tells whether a module is the one that a score was measured on."""
    return hashlib.sha256(path.read_bytes()).hexdigest()[:12]
