"""A fault script: what goes wrong when, for how long. TOML (``[[fault]]``) or JSON (a list).

[[fault]]
at = 2.0            # seconds after the rig first speaks to the head; 0: from the very beginning
device = "compass"
fault = "nack"
for = 1.5           # seconds; left out: to the end
share = 0.5         # a parameter of this fault
"""

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sim.errors import SimulationError
from sim.faults.catalogue import CATALOGUE, DEVICES, FaultKind

COMMON_KEYS = ("at", "device", "fault", "for")


@dataclass(frozen=True)
class Fault:
    """One entry of a script; ``parameters`` holds all that the fault has, defaults filled in."""

    at_s: float
    device: str
    fault: str
    for_s: float | None
    parameters: Mapping[str, float]

    def __str__(self) -> str:
        lasting = f" for {self.for_s:g} s" if self.for_s is not None else ""
        return f"{self.device} {self.fault}{lasting}"


def load_faults(path: Path) -> tuple[Fault, ...]:
    """Read a script.

    Raises:
        SimulationError: it cannot be read, or an entry names what there is not.
    """
    from sim.documents import json_file, toml_file  # of the commands only; faults do not need it

    content: Any = (json_file if path.suffix == ".json" else toml_file)("fault script", path)
    entries = content.get("fault") if isinstance(content, dict) else content
    if not isinstance(entries, list) or (isinstance(content, dict) and set(content) != {"fault"}):
        raise SimulationError(f"fault script {path}: expected a list of [[fault]] tables and nothing else")
    try:
        return parse_faults(entries)
    except SimulationError as error:
        raise SimulationError(f"fault script {path}: {error}") from error


def parse_faults(entries: Sequence[Any]) -> tuple[Fault, ...]:
    """The faults of a script's entries, in the order of time. ``SimulationError`` names the entry from 1."""
    faults = []
    for number, entry in enumerate(entries, 1):
        try:
            faults.append(_fault(entry))
        except ValueError as error:
            raise SimulationError(f"fault {number}: {error}") from error
    return tuple(sorted(faults, key=lambda fault: fault.at_s))


def _fault(entry: Any) -> Fault:
    if not isinstance(entry, dict):
        raise ValueError("expected a table with at, device and fault")
    for key in COMMON_KEYS[:3]:
        if key not in entry:
            raise ValueError(f"{key} is missing")
    device, name = entry["device"], entry["fault"]
    if device not in DEVICES:
        raise ValueError(f"there is no device {device!r}{_instead(device, DEVICES)}")
    kinds: dict[str, FaultKind] = {}
    for group in DEVICES[device]:
        kinds |= CATALOGUE[group]
    if name not in kinds:
        raise ValueError(f"{device} has no fault {name!r}{_instead(name, kinds)}")
    kind = kinds[name]
    at_s, for_s = _seconds(entry, "at"), _seconds(entry, "for") if "for" in entry else None
    if for_s is not None and not kind.lasts:
        raise ValueError(f"{name} is over at once; leave `for` away")
    given = {key: entry[key] for key in entry if key not in COMMON_KEYS}
    for key, value in given.items():
        if key not in kind.parameters:
            raise ValueError(f"{name} has no parameter {key!r}{_instead(key, kind.parameters)}")
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ValueError(f"{key} = {value!r} is no number")
    return Fault(at_s, device, name, for_s, {**kind.parameters, **given})


def _seconds(entry: Mapping[str, Any], key: str) -> float:
    value = entry[key]
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value < 1e6:
        raise ValueError(f"{key} = {value!r} should be seconds, 0 or more")
    return float(value)


def _instead(name: object, known: Mapping[str, object]) -> str:
    near = difflib.get_close_matches(str(name), known, 1)
    if near:
        return f"; did you mean {near[0]!r}?"
    return f"; there are {', '.join(known)}" if known else "; it has none"
