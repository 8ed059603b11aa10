"""The paper's Table I beside the repeated one, on the terminal and as JSON."""

import json
from collections.abc import Sequence
from dataclasses import asdict

from rich.console import Console
from rich.table import Table

from sim.paper.experiment import TABLE_I, Row, mean


def print_table(rows: Sequence[Row]) -> None:
    """Both tables side by side, the means below."""
    table = Table(
        title="Table I: the paper (p) and skyfix (s); errors in grid points, ± what the answer claims (1 sigma), "
        "grid = without refinement"
    )
    for heading in (
        "place (p)",
        "place (s)",
        "one dir. p",
        "one dir. s",
        "all p",
        "all s",
        "POINTs p",
        "POINTs s",
        "noise-free p",
        "grid s",
        "noise-free s",
        "5 px p",
        "grid s",
        "5 px s",
    ):
        table.add_column(heading, justify="right", no_wrap=True)
    for paper, row in zip(TABLE_I, rows, strict=True):
        table.add_row(
            "{:.1f}, {:.1f}".format(*paper.actual),
            "{:.1f}, {:.1f}".format(*row.actual),
            str(paper.candidates_after_one_direction),
            str(row.candidates_after_one_direction),
            str(paper.candidates_after_all),
            str(row.candidates_after_all),
            f"{paper.points_explored:,}",
            f"{row.points_explored:,}",
            _error(paper.error_noise_free),
            _error(row.grid_only_error_noise_free),
            _with_claim(row.error_noise_free, row.claimed_noise_free),
            _error(paper.error_sigma5),
            _error(row.grid_only_error_sigma5),
            _with_claim(row.error_sigma5, row.claimed_sigma5),
        )
    means = summary(rows)
    table.add_section()
    table.add_row(
        "mean",
        *[""] * 7,
        _error(mean([run.error_noise_free for run in TABLE_I])),
        _error(means["grid_only_mean_error_noise_free"]),
        _with_claim(means["mean_error_noise_free"], means["mean_claimed_noise_free"]),
        _error(mean([run.error_sigma5 for run in TABLE_I])),
        _error(means["grid_only_mean_error_sigma5"]),
        _with_claim(means["mean_error_sigma5"], means["mean_claimed_sigma5"]),
    )
    Console(width=max(196, Console().width)).print(table)


def summary(rows: Sequence[Row]) -> dict[str, float | None]:
    """Mean errors and mean stated sigmas in grid points; None if a place was not located."""
    return {
        "mean_error_noise_free": mean([row.error_noise_free for row in rows]),
        "mean_error_sigma5": mean([row.error_sigma5 for row in rows]),
        "grid_only_mean_error_noise_free": mean([row.grid_only_error_noise_free for row in rows]),
        "grid_only_mean_error_sigma5": mean([row.grid_only_error_sigma5 for row in rows]),
        "mean_claimed_noise_free": mean([row.claimed_noise_free for row in rows]),
        "mean_claimed_sigma5": mean([row.claimed_sigma5 for row in rows]),
    }


def to_json(rows: Sequence[Row]) -> str:
    """The means and the rows as one JSON object."""
    return json.dumps({**summary(rows), "rows": [asdict(row) for row in rows]})


def _with_claim(error: float | None, claimed: float | None) -> str:
    return _error(error) if error is None or claimed is None else f"{error:.3f} ± {claimed:.3f}"


def _error(value: float | None) -> str:
    return "not found" if value is None else f"{value:.3f}"
