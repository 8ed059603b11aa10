"""Stage 2: whole curves compared, by a disparity that outliers cannot dominate."""

import numpy as np
from numpy.typing import NDArray

from generate.figures.drawing import BLUE, GREEN, GREY, ORANGE, RED, new_figure, save
from generate.figures.scene import COMPACT, Floats, Scene, scene, skyline_of
from localizer.dem.horizon import horizon
from localizer.search.stage2 import GEMAN_MCCLURE_SIGMAS

Cells = NDArray[np.int64]

EVERY = 4
"""Every so many bins of the measured skyline are compared: a degree."""


def draw() -> None:
    """The curve that was measured and those of three cells, the disparities of all cells, and the loss."""
    here = scene(COMPACT)
    cells = here.located.stage1.last
    skyline = skyline_of(here)
    azimuth_deg = np.arange(len(skyline.elevation_deg)) * 360.0 / len(skyline.elevation_deg)
    seen = np.isfinite(skyline.elevation_deg)
    best = here.located.best
    bias_deg = best.azimuth_bias_deg if best else 0.0
    disparity = _disparities(here, cells, bias_deg)
    apart = np.hypot(cells[:, 0] - here.row, cells[:, 1] - here.col)
    winner = int(disparity.argmin())
    far = np.flatnonzero(apart > 20.0)
    rival = int(far[disparity[far].argmin()])
    figure = new_figure(9.0, 5.8)
    axes = figure.subplot_mosaic([["curves", "curves"], ["ranked", "loss"]])
    curves, ranked, loss = axes["curves"], axes["ranked"], axes["loss"]
    curves.plot(
        azimuth_deg[seen], skyline.elevation_deg[seen], ".", ms=3.5, color="black", label="measured skyline"
    )
    for index, colour, words in (
        (winner, GREEN, "predicted from the best cell"),
        (rival, RED, f"predicted from a cell {apart[rival] * here.terrain.cell_m / 1000.0:.1f} km away"),
    ):
        angle_deg, _ = _predicted(here, cells[index : index + 1], azimuth_deg - bias_deg)
        curves.plot(azimuth_deg, angle_deg[0], color=colour, lw=1.1, label=words)
    curves.set(
        xlabel="azimuth by the compass, °", ylabel="elevation, °", xlim=(0.0, 360.0), ylim=(-2.5, 13.5)
    )
    curves.set_xticks(range(0, 361, 45))
    curves.set_title("The curve of the best cell, and of the best cell elsewhere that stage 1 left as well")
    curves.legend(ncols=3, loc="upper center")
    ranked.scatter(apart * here.terrain.cell_m / 1000.0, disparity, s=6.0, color=BLUE)
    ranked.set(
        xlabel="distance from the true place, km",
        ylabel="mean negative log-likelihood",
        title=f"Disparity of the {len(cells)} cells that stage 1 left",
        xscale="log",
    )
    sigmas = np.linspace(0.0, 12.0, 200)
    loss.plot(sigmas, 0.5 * sigmas**2, color=GREY, ls="--", label="squares")
    loss.plot(
        sigmas,
        0.5 * sigmas**2 / (1.0 + sigmas**2 / GEMAN_MCCLURE_SIGMAS**2),
        color=ORANGE,
        label="Geman-McClure",
    )
    loss.axhline(0.5 * GEMAN_MCCLURE_SIGMAS**2, color=GREY, lw=0.7, ls=":")
    loss.set(
        xlabel="residual, standard deviations",
        ylabel="loss",
        ylim=(0.0, 14.0),
        xlim=(0.0, 12.0),
        title="What one column may cost",
    )
    loss.legend(loc="lower right")
    save(figure, "stage2.svg")


def _predicted(here: Scene, cells: Cells, azimuth_deg: Floats) -> tuple[Floats, Floats]:
    ground_m = here.terrain.height_m[cells[:, 0], cells[:, 1]]
    eye_m = ground_m + here.observation.mast_height_m
    return horizon(here.terrain, cells[:, 0], cells[:, 1], eye_m, azimuth_deg)


def _disparities(here: Scene, cells: Cells, bias_deg: float) -> Floats:
    """The disparity (n,) of cells: the camera stands anywhere in its cell, so that what is near is uncertain."""
    skyline = skyline_of(here)
    at = np.arange(0, len(skyline.elevation_deg), EVERY)
    at = at[np.isfinite(skyline.elevation_deg[at])]
    azimuth_deg = at * 360.0 / len(skyline.elevation_deg) - bias_deg
    angle_deg, distance_m = _predicted(here, cells, azimuth_deg)
    slack_m = here.terrain.half_cell_relief_m[cells[:, 0], cells[:, 1]] + here.terrain.nominal_error_m
    variance = skyline.sigma_deg[at] ** 2 + np.degrees(slack_m[:, None] / distance_m) ** 2
    squared = (skyline.elevation_deg[at] - angle_deg) ** 2 / variance
    loss = squared / (1.0 + squared / GEMAN_MCCLURE_SIGMAS**2) + np.log(np.radians(np.sqrt(variance)) ** 2)
    return np.asarray(0.5 * loss.mean(axis=1))
