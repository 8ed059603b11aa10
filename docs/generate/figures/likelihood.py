"""The likelihood around a fix, and the ellipse that is fitted to it."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh

from generate.figures.drawing import CHI2_95, ORANGE, RED, draw_ellipse, new_figure, save
from generate.figures.scene import COMPACT, SEVERAL_PEAKS, cost_around, scene

LEAST = -14.0
"""Log-likelihoods further below the best one are drawn alike."""


def draw() -> None:
    """Two places: one where all fits end at one peak, and one where they do not."""
    figure = new_figure(9.0, 4.4)
    left, right = figure.subplots(1, 2)
    image = _lattice(left, COMPACT, 6.0, 0.3, "A place with one peak")
    _lattice(right, SEVERAL_PEAKS, 45.0, 2.25, "A place close to hills: several fits, one ellipse")
    bar = figure.colorbar(image, ax=[left, right], shrink=0.85, extend="min")
    bar.set_label("log-likelihood below the best")
    save(figure, "likelihood.png")


def _lattice(axes: Axes, case: int, reach_m: float, step_m: float, title: str) -> QuadMesh:
    here = scene(case)
    best = here.located.best
    assert best is not None
    cost, ticks_m = cost_around(here, reach_m, step_m)
    below = np.maximum(cost.min() - cost, LEAST)
    image = axes.pcolormesh(ticks_m, ticks_m, below, cmap="viridis", vmin=LEAST, vmax=0.0, shading="nearest")
    draw_ellipse(axes, (0.0, 0.0), best.covariance_enu_m2, 1.0, ec="white", lw=1.2, ls="--")
    draw_ellipse(axes, (0.0, 0.0), best.covariance_enu_m2, CHI2_95, ec="white", lw=1.8)
    true_m = here.offset_m(best.row, best.col)
    axes.plot(-true_m[0], -true_m[1], "o", mfc="none", mec=RED, ms=9.0, mew=2.0, label="true place")
    axes.plot(0.0, 0.0, "*", color=ORANGE, mec="black", ms=11.0, label="fix")
    axes.set(xlabel="metres east of the fix", ylabel="metres north of the fix", aspect="equal", title=title)
    axes.set(xlim=(-reach_m, reach_m), ylim=(-reach_m, reach_m))
    axes.legend(loc="upper left", labelcolor="white")
    return image
