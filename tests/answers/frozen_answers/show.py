"""The comparison for people, as a short table, and for machines, as one JSON object."""

import json
from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from frozen_answers.compare import QUANTITIES, Change, Comparison
from frozen_answers.explain import MEANING

MOST_SHOWN = 40
MOST_CHANGES = 4


def largest_changes(comparisons: Sequence[Comparison], *, within: bool) -> dict[str, tuple[float, str]]:
    """For each quantity the largest finite amount, and its case; ``within``: of those within the tolerances only."""
    largest: dict[str, tuple[float, str]] = {}
    for comparison in comparisons:
        for change in comparison.changes:
            counts = np.isfinite(change.amount) and not (within and change.beyond)
            if counts and change.amount > largest.get(change.what, (0.0, ""))[0]:
                largest[change.what] = change.amount, comparison.case
    return largest


def print_comparison(console: Console, comparisons: Sequence[Comparison]) -> None:
    """The table, then what the explanations mean, then the counts."""
    different = [comparison for comparison in comparisons if comparison.explanation]
    if different:
        table = Table(box=None, pad_edge=False, header_style="bold")
        for title in ("case", "explained by", "what differs"):
            table.add_column(title, overflow="fold")
        for comparison in sorted(different, key=lambda one: one.alarm is None)[:MOST_SHOWN]:
            table.add_row(comparison.case, comparison.explanation, _what_differs(comparison))
        console.print(table, markup=False, highlight=False)
        if len(different) > MOST_SHOWN:
            console.print(f"... and {len(different) - MOST_SHOWN} more; --json lists all", highlight=False)
        console.print()
        for why, count in Counter(one.explanation for one in different).most_common():
            assert why is not None
            console.print(f"{count:4} {why}: {MEANING[why]}", markup=False, highlight=False)
    within = ", ".join(
        f"{what} {amount:.2g} {QUANTITIES[what].unit}".strip()
        for what, (amount, _) in largest_changes(comparisons, within=True).items()
    )
    same = len(comparisons) - len(different)
    console.print(f"{same:4} of {len(comparisons)} the same", markup=False, highlight=False)
    if within:
        console.print(f"     largest changes within the tolerances: {within}", markup=False, highlight=False)


def _what_differs(comparison: Comparison) -> str:
    changes = sorted(comparison.beyond, key=lambda change: (change.look, list(QUANTITIES).index(change.what)))
    drive = any(change.look for change in comparison.changes)
    parts = [f"look {change.look}: {change.text()}" if drive else change.text() for change in changes]
    more = [f"{len(parts) - MOST_CHANGES} more"] if len(parts) > MOST_CHANGES else []
    return "; ".join([*([comparison.alarm] if comparison.alarm else []), *parts[:MOST_CHANGES], *more])


def as_json(comparisons: Sequence[Comparison]) -> str:
    """One object on one line."""
    different = [comparison for comparison in comparisons if comparison.explanation]
    content = {
        "cases": len(comparisons),
        "same": len(comparisons) - len(different),
        "explanations": dict(Counter(comparison.explanation for comparison in different)),
        "different": [
            {
                "case": comparison.case,
                "explanation": comparison.explanation,
                "alarm": comparison.alarm,
                "changes": [_change(change) for change in comparison.changes],
            }
            for comparison in different
        ],
        "largest": {
            what: {"amount": _finite(amount), "case": case}
            for what, (amount, case) in largest_changes(comparisons, within=False).items()
        },
        "tolerances": {what: quantity.tolerance for what, quantity in QUANTITIES.items()},
    }
    return json.dumps(content, allow_nan=False)


def _change(change: Change) -> dict[str, Any]:
    return {
        "look": change.look,
        "what": change.what,
        "frozen": change.frozen,
        "now": change.now,
        "amount": _finite(change.amount),
        "unit": QUANTITIES[change.what].unit,
        "moved_m": change.moved_m,
        "beyond": change.beyond,
    }


def _finite(amount: float) -> float | None:
    """None: a value against none, which is infinitely far."""
    return float(f"{amount:.6g}") if np.isfinite(amount) else None
