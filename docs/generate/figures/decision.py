"""How ``fix``, ``ambiguous`` and ``none`` are told apart."""

import numpy as np
from matplotlib.axes import Axes

from generate.figures.drawing import BLUE, GREEN, GREY, ORANGE, RED, new_figure, save
from localizer.search.decide import FIX_EVIDENCE, FIX_PROBABILITY, LEAST_EVIDENCE, TEMPERING_EXPONENT
from localizer.search.fit.outliers import OUTLIER_SHARE, UNRELATED_SKYLINE_RAD

SIGMA_RAD = np.radians(0.05)
"""Of a block's middle, contour and DEM together, in the drawing."""


def draw() -> None:
    """What a stretch of the horizon tells, how probable the best of two places is, and the regions of the answer."""
    figure = new_figure(9.6, 3.4)
    block, probability, regions = figure.subplots(1, 3)
    _block(block)
    _probability(probability)
    _regions(regions)
    save(figure, "decision.svg")


def _block(axes: Axes) -> None:
    off = np.linspace(0.0, 6.0, 200)
    likelier = UNRELATED_SKYLINE_RAD / SIGMA_RAD * np.exp(-0.5 * off**2)
    axes.plot(off, np.log((1.0 - OUTLIER_SHARE) * likelier + OUTLIER_SHARE), color=BLUE)
    axes.axhline(0.0, color=GREY, lw=0.7)
    axes.axhline(np.log(OUTLIER_SHARE), color=GREY, lw=0.7, ls=":")
    axes.text(0.1, np.log(OUTLIER_SHARE) + 0.12, "an outlier", color=GREY)
    axes.set(
        xlabel="misfit of a 6° block, sigmas",
        ylabel="evidence over chance",
        title="What one block tells",
    )


def _probability(axes: Axes) -> None:
    ahead = np.linspace(0.0, 20.0, 200)
    axes.plot(ahead, 1.0 / (1.0 + np.exp(-TEMPERING_EXPONENT * ahead)), color=BLUE)
    least = np.log(FIX_PROBABILITY / (1.0 - FIX_PROBABILITY)) / TEMPERING_EXPONENT
    axes.plot([least, least, 0.0], [0.5, FIX_PROBABILITY, FIX_PROBABILITY], color=GREY, lw=0.8, ls=":")
    axes.annotate(
        f"{FIX_PROBABILITY:g} at {least:.1f}", (least, FIX_PROBABILITY), (4, -14), textcoords="offset points"
    )
    axes.set(
        xlabel="log-odds ahead of the second place",
        ylabel="probability of the first",
        title="Two places",
        xlim=(0.0, 20.0),
        ylim=(0.5, 1.01),
    )


def _regions(axes: Axes) -> None:
    least = np.log(FIX_PROBABILITY / (1.0 - FIX_PROBABILITY)) / TEMPERING_EXPONENT
    top, right = 20.0, 60.0
    axes.fill_between([0.0, LEAST_EVIDENCE], 0.0, top, color=RED, alpha=0.25, lw=0.0)
    axes.fill_between([LEAST_EVIDENCE, right], 0.0, top, color=ORANGE, alpha=0.3, lw=0.0)
    axes.fill_between([FIX_EVIDENCE, right], least, top, color=GREEN, alpha=0.45, lw=0.0)
    axes.text(0.5 * LEAST_EVIDENCE, 0.5 * top, "none", ha="center")
    axes.text(0.5 * (FIX_EVIDENCE + right), 0.5 * (least + top), "fix", ha="center")
    axes.text(0.5 * (LEAST_EVIDENCE + right), 0.5 * least, "ambiguous", ha="center")
    axes.set(
        xlabel="evidence of the best place",
        ylabel="log-odds ahead of the second place",
        title="The answer",
        xlim=(0.0, right),
        ylim=(0.0, top),
        xticks=[0.0, LEAST_EVIDENCE, FIX_EVIDENCE, 40.0, right],
    )
