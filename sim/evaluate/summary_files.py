"""Writes the summary of an evaluation as JSON, Markdown and plots."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from sim.evaluate.plots import write_plots
from sim.evaluate.row import CaseRow
from sim.evaluate.summary import NOMINAL, summarize_by_dem


def write_summary(rows: Sequence[CaseRow], scenario: str, folder: Path) -> str:
    """Write ``summary.json``, ``summary.md`` and the plots into the folder; returns the summary's text."""
    parts = summarize_by_dem(rows)
    text = summary_text(scenario, parts)
    (folder / "summary.json").write_text(
        json.dumps({"scenario": scenario, "parts": parts}, indent=2) + "\n", encoding="utf-8"
    )
    write_plots(rows, scenario, folder)
    (folder / "summary.md").write_text(text + "\n", encoding="utf-8")
    return text


def summary_text(scenario: str, parts: dict[str, dict[str, Any]]) -> str:
    """A Markdown table, one row per DEM, and the reliability of the stated probabilities."""
    head = [
        "cases of",
        "n",
        "fix",
        "amb.",
        "none",
        "wrong (95 % below)",
        "median m",
        "95 % m",
        "RMSE m",
        "median cells",
        "RMSE/CRLB",
        "same, altitude free",
        "same, far horizon",
        "same, both",
        *(f"in {nominal:.0%}" for nominal in NOMINAL),
        "truth among",
        "median s",
        "95 % s",
    ]
    lines = [f"## {scenario}", "", _line(head), _line(["---"] * len(head))]
    lines += [_line(_cells(name, figures)) for name, figures in parts.items()]
    every = parts["all"]
    if every["wrong_fix_cases"]:
        lines += ["", f"Wrong fixes: cases {', '.join(map(str, every['wrong_fix_cases']))}."]
    if every["reliability"]:
        lines += ["", _line(["probability", "answers", "mean", "right"]), _line(["---"] * 4)]
        lines += [
            _line(
                [
                    f"{b['from']:g} to {b['to']:g}",
                    str(b["answers"]),
                    f"{b['mean_probability']:.3f}",
                    f"{b['right']:.3f}",
                ]
            )
            for b in every["reliability"]
        ]
    return "\n".join(lines)


def _cells(name: str, figures: dict[str, Any]) -> list[str]:
    metres = figures["error_m"]
    return [
        name,
        str(figures["cases"]),
        *(_percent(figures[status]) for status in ("fix", "ambiguous", "none")),
        f"{figures['wrong_fixes']} ({_percent(figures['wrong_share_upper_95'])})",
        *(_number(metres[which]) for which in ("median", "p95", "rmse")),
        _number(figures["error_cells"]["median"]),
        _number(figures["rmse_over_crlb"]),
        _number(figures["rmse_over_free_altitude_crlb"]),
        _number(figures["rmse_over_far_horizon_crlb"]),
        _number(figures["rmse_over_wary_crlb"]),
        *(_percent(share) for share in figures["coverage"].values()),
        _percent(figures["truth_among_candidates"]),
        *(_number(figures["time_s"][which]) for which in ("median", "p95")),
    ]


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100.0 * share:.1f} %"
