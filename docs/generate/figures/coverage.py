"""What the ellipse of a fix claims, and how often that was so."""

import re
from pathlib import Path

import numpy as np
from scipy import stats

from generate.figures.drawing import BLUE, CHI2_95, GREY, ORANGE, RED, draw_ellipse, new_figure, save
from generate.figures.scene import COMPACT, scene

MEASUREMENTS = Path(__file__).resolve().parents[2] / "measurements.md"
LEVELS = (0.50, 0.90, 0.95, 0.99)
SHOWN = ("realistic", "foreground", "occluded", "cloud", "no_compass", "few_frames", "dem_error")


def measured_coverage(page: str) -> dict[str, tuple[int, tuple[float, ...]]]:
    """By scenario, the number of fixes and the shares of them inside the ellipses of 50, 90, 95 and 99 %."""
    lines = [[cell.strip() for cell in line.strip("| ").split("|")] for line in page.splitlines()]
    head = next(line for line in lines if "scenario" in line and "in 95 %" in line)
    found = {}
    for line in lines:
        if len(line) != len(head) or not re.fullmatch(r"\d+", line[head.index("n")]):
            continue
        shares = [line[head.index(f"in {round(100 * level)} %")] for level in LEVELS]
        if "-" not in shares:
            fixes = round(int(line[head.index("n")]) * _share(line[head.index("fix")]))
            found[line[head.index("scenario")]] = fixes, tuple(map(_share, shares))
    return found


def _share(percent: str) -> float:
    return float(percent.rstrip(" %")) / 100.0


def draw_ellipse_of_a_fix() -> None:
    """Two ellipses of one covariance, and what lies inside them."""
    best = scene(COMPACT).located.best
    assert best is not None
    drawn = np.random.default_rng(5).multivariate_normal([0.0, 0.0], best.covariance_enu_m2, 1000)
    squared = np.einsum("ni,ij,nj->n", drawn, np.linalg.inv(best.covariance_enu_m2), drawn)
    figure = new_figure(5.2, 4.6)
    axes = figure.subplots()
    within, beyond = drawn[squared <= CHI2_95], drawn[squared > CHI2_95]
    axes.scatter(within[:, 0], within[:, 1], s=4.0, color=BLUE, alpha=0.5, lw=0.0)
    axes.scatter(beyond[:, 0], beyond[:, 1], s=8.0, color=RED, lw=0.0)
    draw_ellipse(axes, (0.0, 0.0), best.covariance_enu_m2, 1.0, ec="black", lw=1.4, ls="--")
    draw_ellipse(axes, (0.0, 0.0), best.covariance_enu_m2, CHI2_95, ec="black", lw=1.8)
    inside = [100.0 * float((squared <= chi2).mean()) for chi2 in (1.0, CHI2_95)]
    axes.plot([], [], color="black", ls="--", label=f"one sigma: {inside[0]:.0f} % of 1000 draws inside")
    axes.plot([], [], color="black", label=f"95 %, {np.sqrt(CHI2_95):.2f} sigma: {inside[1]:.0f} % inside")
    axes.set(xlabel="metres east", ylabel="metres north", aspect="equal")
    axes.set(xlim=(-6.5, 6.5), ylim=(-4.6, 6.5))
    axes.legend(loc="upper center")
    save(figure, "ellipse.svg")


def draw_coverage() -> None:
    """How many of the fixes of each scenario had the truth inside."""
    found = measured_coverage(MEASUREMENTS.read_text())
    figure = new_figure(7.2, 4.0)
    axes = figure.subplots()
    colours = (ORANGE, BLUE, "black", GREY)
    for index, (level, colour) in enumerate(zip(LEVELS, colours, strict=True)):
        axes.axvline(level, color=colour, lw=1.0, ls=":")
        for place, name in enumerate(SHOWN):
            fixes, shares = found[name]
            inside = round(shares[index] * fixes)
            low, high = stats.beta(inside + 0.5, fixes - inside + 0.5).ppf([0.025, 0.975])
            line = place + 0.17 * (index - 1.5)
            axes.plot([low, high], [line, line], color=colour, lw=1.4)
            axes.plot(shares[index], line, "o", color=colour, ms=4.5)
    axes.set_yticks(range(len(SHOWN)), [f"{name} ({found[name][0]} fixes)" for name in SHOWN])
    axes.invert_yaxis()
    axes.set(
        xlabel="share of the fixes with the truth inside the ellipse of 50, 90, 95, 99 %", xlim=(0.45, 1.01)
    )
    axes.set_title("Dots: measured, with 95 % intervals; dotted lines: as claimed")
    save(figure, "coverage.svg")
