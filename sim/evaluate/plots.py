"""Plots of an evaluation."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy import stats

from sim.evaluate.row import CaseRow
from sim.evaluate.summary import reliability, right_fixes

SIZE_IN = (6.0, 4.5)
DPI = 110
SMALLEST_M = 1e-3
COLOUR = "tab:blue"


def write_plots(rows: Sequence[CaseRow], title: str, folder: Path) -> list[Path]:
    """Draw the plots for which there are enough data; returns the files."""
    fixes = [r for r in rows if r.status == "fix" and not r.outside]
    right = right_fixes(rows)
    bounded = [r for r in right if r.crlb_rms_m is not None]
    written = []
    for name, draw, chosen in (
        ("error_cdf", _error_cdf, fixes),
        ("coverage", _coverage, right),
        ("reliability", _reliability, [r for r in rows if r.probability is not None]),
        ("error_against_bound", _error_against_bound, bounded),
        ("error_map", _error_map, right),
    ):
        if chosen:
            figure = Figure(figsize=SIZE_IN, layout="constrained")
            axes = figure.subplots()
            draw(axes, chosen)
            axes.set_title(f"{title}, {len(chosen)} cases")
            axes.grid(alpha=0.3)
            path = folder / f"{name}.png"
            figure.savefig(path, dpi=DPI)
            written.append(path)
    return written


def _error_cdf(axes: Axes, rows: Sequence[CaseRow]) -> None:
    for name in sorted({r.dem for r in rows}):
        error = np.sort([max(r.error_m or 0.0, SMALLEST_M) for r in rows if r.dem == name])
        axes.step(
            error, (np.arange(len(error)) + 1) / len(error), where="post", label=f"{name} ({len(error)})"
        )
    axes.set(xscale="log", xlabel="error of fixes, m", ylabel="share of fixes below", ylim=(0.0, 1.02))
    axes.legend(fontsize="small")


def _coverage(axes: Axes, rows: Sequence[CaseRow]) -> None:
    """In Gaussian terms: the share of the fixes inside the ellipse of each nominal probability."""
    inside = np.sort(stats.chi2.cdf([r.mahalanobis2 or 0.0 for r in rows], 2))
    axes.plot([0.0, 1.0], [0.0, 1.0], color="grey", lw=1.0, label="as claimed")
    axes.step(inside, (np.arange(len(inside)) + 1) / len(inside), where="post", color=COLOUR, label="found")
    axes.set(xlabel="nominal probability of the ellipse", ylabel="share of the fixes inside", aspect="equal")
    axes.legend(loc="upper left")


def _reliability(axes: Axes, rows: Sequence[CaseRow]) -> None:
    bins = reliability(rows)
    axes.plot([0.0, 1.0], [0.0, 1.0], color="grey", lw=1.0, label="as claimed")
    mean, share = [b["mean_probability"] for b in bins], np.array([b["right"] for b in bins])
    count = np.array([b["answers"] for b in bins])
    interval = stats.beta(share * count + 0.5, (1.0 - share) * count + 0.5)  # Jeffreys'
    low, high = np.asarray(interval.ppf(0.025)), np.asarray(interval.ppf(0.975))
    spread = np.clip(np.array([share - low, high - share]), 0.0, 1.0)
    axes.errorbar(mean, share, spread, fmt="o", color=COLOUR, capsize=3.0, label="found, 95 %")
    for x, y, n in zip(mean, share, count, strict=True):
        axes.annotate(
            f"{n}", (x, y), textcoords="offset points", xytext=(-4, 6), ha="right", fontsize="small"
        )
    axes.set(xlabel="probability given", ylabel="share of right places", xlim=(0.0, 1.03), ylim=(-0.02, 1.05))
    axes.legend(loc="upper left")


def _error_against_bound(axes: Axes, rows: Sequence[CaseRow]) -> None:
    bound = np.array([r.crlb_rms_m for r in rows], float)
    error = np.maximum([r.error_m or 0.0 for r in rows], SMALLEST_M)
    claimed = np.array([r.sigma_major_m for r in rows], float)
    axes.scatter(bound, claimed, s=8.0, color="lightgrey", label="the fix's own sigma (major axis)")
    axes.scatter(bound, error, s=8.0, color=COLOUR, label="error")
    ends = np.array([bound.min(), bound.max()])
    axes.plot(ends, ends, color="black", lw=1.0, label="bound (rms)")
    axes.set(xscale="log", yscale="log", xlabel="Cramér-Rao bound, rms, m", ylabel="m")
    axes.legend(fontsize="small")


def _error_map(axes: Axes, rows: Sequence[CaseRow]) -> None:
    east = np.array([(r.easting_m or 0.0) - r.true_easting_m for r in rows])
    north = np.array([(r.northing_m or 0.0) - r.true_northing_m for r in rows])
    ground = [r.error_m or 0.0 for r in rows] / np.maximum(np.hypot(east, north), 1e-9)
    east, north = east * ground, north * ground
    axes.scatter(east, north, s=8.0, alpha=0.6, color=COLOUR)
    reach = 1.1 * float(np.quantile(np.hypot(east, north), 0.98)) or 1.0
    axes.set(xlabel="east of the truth, m", ylabel="north of the truth, m", aspect="equal")
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach))
