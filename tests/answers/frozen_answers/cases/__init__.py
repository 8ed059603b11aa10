"""The cases: one module for each kind, which has ``CASES``, a table from the name to what makes the question."""

from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path

from frozen_answers.cases import drives, files, grounds, pictures, readings, scenarios, twins
from frozen_answers.inputs import Question

Make = Callable[[Path], Question]
"""Makes the question from seeds; files go into the folder given."""

KINDS: dict[str, Mapping[str, Make]] = {
    "scenario": scenarios.CASES,
    "pictures": pictures.CASES,
    "twins": twins.CASES,
    "ground": grounds.CASES,
    "files": files.CASES,
    "readings": readings.CASES,
    "drive": drives.CASES,
}


@lru_cache(maxsize=1)
def all_cases() -> dict[str, Make]:
    """Every case as ``kind/name``."""
    return {f"{kind}/{name}": make for kind, cases in KINDS.items() for name, make in cases.items()}
