"""The results of ``rig check`` as a table and as JSON."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from rich.console import Console
from rich.table import Table

from rig.check.result import DeviceCheck

PLAIN_WIDTH = 160  # width of the table without a terminal


def print_table(checks: Sequence[DeviceCheck], console: Console) -> None:
    """Print the results as a table, then one line for each problem and each hint."""
    degrees = "°C" if console.encoding.lower().startswith("utf") else "deg C"
    table = Table("device", "identity", "reading", "noise", "V", degrees, "verdict")
    for check in checks:
        table.add_row(
            check.device,
            check.identity or "-",
            check.reading or "-",
            check.noise or "-",
            _numbers(check.volts),
            _numbers(check.temperatures_c),
            "ok" if check.ok else "FAILED",
            style=None if check.ok else "red",
        )
    console.print(table)
    for check in checks:
        lines = [f"{check.device}: {check.problem}"] if check.problem else []
        for line in [*lines, *(f"{check.device}: note: {hint}" for hint in check.hints)]:
            console.print(line, markup=False, highlight=False, soft_wrap=True)


def as_json(checks: Sequence[DeviceCheck]) -> dict[str, Any]:
    """The results as JSON values. ``values`` holds the readings as numbers with units in their names; null: unknown."""
    return {
        "ok": all(check.ok for check in checks),
        "devices": [
            {
                **asdict(check),
                "values": _rounded(check.values),
                "ok": check.ok,
                "verdict": "ok" if check.ok else "failed",
            }
            for check in checks
        ],
    }


def table_console() -> Console:
    """A console on standard output, wide enough for the table if it is not a terminal."""
    console = Console()
    return console if console.is_terminal else Console(width=PLAIN_WIDTH)


def _rounded(values: Mapping[str, float | str | None]) -> dict[str, float | str | None]:
    """Rounded to significant digits; NaN becomes null, which JSON lacks."""
    return {
        key: (round(value, 5) if math.isfinite(value) else None) if isinstance(value, float) else value
        for key, value in values.items()
    }


def _numbers(values: Sequence[float]) -> str:
    return " ".join(f"{value:.1f}" for value in values) or "-"
