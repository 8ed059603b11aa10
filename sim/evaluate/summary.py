"""Summary statistics of a table of cases."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from scipy import stats

from sim.evaluate.row import CaseRow

WRONG_CELLS = 5.0
WRONG_SIGMAS = 5.0
CONFIDENCE = 0.95
NOMINAL = (0.5, 0.9, 0.95, 0.99)
PROBABILITY_EDGES = (0.0, 0.2, 0.4, 0.6, 0.8, 0.9, 0.99, 0.999, 1.0)


def is_right(row: CaseRow) -> bool:
    """Whether the best place is the true one by either measure, whatever the status."""
    if row.outside or row.error_cells is None or row.mahalanobis2 is None:
        return False
    return row.error_cells <= WRONG_CELLS or row.mahalanobis2 <= WRONG_SIGMAS**2


def is_wrong_fix(row: CaseRow) -> bool:
    """Whether a wrong place has status ``fix``: far off by both measures, or any place if the truth is outside the DEM."""
    return row.status == "fix" and not is_right(row)


def right_fixes(rows: Sequence[CaseRow]) -> list[CaseRow]:
    """The fixes that are not wrong; errors and ellipses are evaluated on these."""
    return [r for r in rows if r.status == "fix" and not is_wrong_fix(r)]


def upper_bound(events: int, trials: int) -> float | None:
    """One-sided Clopper-Pearson bound of a share; None without trials."""
    if trials == 0:
        return None
    return 1.0 if events == trials else float(stats.beta.ppf(CONFIDENCE, events + 1, trials - events))


def coverage(rows: Sequence[CaseRow]) -> dict[str, float | None]:
    """Share of the fixes whose truth lies in the ellipse of each nominal probability."""
    squares = np.array([r.mahalanobis2 for r in rows if r.status == "fix" and not r.outside], float)
    return {
        f"{nominal:g}": float(np.mean(squares <= stats.chi2.ppf(nominal, 2))) if len(squares) else None
        for nominal in NOMINAL
    }


def reliability(rows: Sequence[CaseRow]) -> list[dict[str, Any]]:
    """For bins of the stated probability: number of answers, mean probability, and share of right places."""
    answered = [r for r in rows if r.probability is not None]
    bins = []
    for low, high in pairwise(PROBABILITY_EDGES):
        last = high == PROBABILITY_EDGES[-1]
        inside = [
            r
            for r in answered
            if r.probability is not None and low <= r.probability < (2.0 if last else high)
        ]
        if inside:
            bins.append(
                {
                    "from": low,
                    "to": high,
                    "answers": len(inside),
                    "mean_probability": float(np.mean([r.probability or 0.0 for r in inside])),
                    "right": float(np.mean([is_right(r) for r in inside])),
                }
            )
    return bins


def summarize(rows: Sequence[CaseRow]) -> dict[str, Any]:
    """All figures of some cases. Errors are those of all fixes; bound and ellipses are evaluated on the fixes that are
    not wrong.
    """
    fixes = [r for r in rows if r.status == "fix"]
    wrong = [r for r in rows if is_wrong_fix(r)]
    right = right_fixes(rows)
    times = [r.time_s for r in rows]
    return {
        "cases": len(rows),
        "fix": _share(len(fixes), len(rows)),
        "ambiguous": _share(sum(r.status == "ambiguous" for r in rows), len(rows)),
        "none": _share(sum(r.status == "none" for r in rows), len(rows)),
        "wrong_fixes": len(wrong),
        "wrong_fix_cases": [r.case for r in wrong],
        "wrong_share_upper_95": upper_bound(len(wrong), len(rows)),
        "error_m": _errors([r.error_m for r in fixes if not r.outside]),
        "error_cells": _errors([r.error_cells for r in fixes if not r.outside]),
        "error_right_m": _errors([r.error_m for r in right]),
        "rmse_over_crlb": _over_bound(right, "crlb_rms_m"),
        "rmse_over_free_altitude_crlb": _over_bound(right, "crlb_free_altitude_rms_m"),
        "rmse_over_far_horizon_crlb": _over_bound(right, "crlb_far_horizon_rms_m"),
        "rmse_over_wary_crlb": _over_bound(right, "crlb_wary_rms_m"),
        "coverage": coverage(right),
        "coverage_fixes": len(right),
        "reliability": reliability(rows),
        "truth_among_candidates": _share(sum(r.truth_among for r in rows), len(rows)),
        "truth_among_when_ambiguous": _share(
            sum(r.truth_among for r in rows if r.status == "ambiguous"),
            sum(r.status == "ambiguous" for r in rows),
        ),
        "time_s": {"median": _quantile(times, 0.5), "p95": _quantile(times, 0.95)},
    }


def summarize_by_dem(rows: Sequence[CaseRow]) -> dict[str, dict[str, Any]]:
    """Figures of all cases, and of each DEM where there are several."""
    names = sorted({r.dem for r in rows})
    parts = {"all": summarize(rows)}
    if len(names) > 1:
        parts |= {name: summarize([r for r in rows if r.dem == name]) for name in names}
    return parts


def _share(count: int, total: int) -> float | None:
    return count / total if total else None


def _quantile(values: Sequence[float], share: float) -> float | None:
    return float(np.quantile(values, share)) if values else None


def _errors(values: Sequence[float | None]) -> dict[str, float | None]:
    known = [v for v in values if v is not None]
    return {
        "median": _quantile(known, 0.5),
        "p95": _quantile(known, 0.95),
        "mean": float(np.mean(known)) if known else None,
        "rmse": float(np.sqrt(np.mean(np.square(known)))) if known else None,
    }


def _over_bound(rows: Sequence[CaseRow], column: str) -> float | None:
    """Root of the mean squared error over the mean squared bound."""
    pairs = [(r.error_m, getattr(r, column)) for r in rows]
    known = np.array([(e, b) for e, b in pairs if e is not None and b is not None], float)
    return float(np.sqrt(np.mean(known[:, 0] ** 2) / np.mean(known[:, 1] ** 2))) if len(known) else None
