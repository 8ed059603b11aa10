"""Stage 1: one height of the skyline in each direction cuts the DEM down."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LightSource

from generate.figures.drawing import (
    BLUE,
    GREEN,
    GREY,
    GROUND,
    ORANGE,
    RED,
    new_figure,
    save,
)
from generate.figures.scene import COMPACT, Floats, Scene, central_bands, profile_m, scene

STEP_M = 25.0
TRIED = 400
"""Cells that are looked at for one that shows a test well."""


def draw_profile() -> None:
    """One direction: a cell that stays, one whose terrain is too high, and one whose terrain is too low."""
    here = scene(COMPACT)
    left = here.located.stage1.survivors
    steps = list(left)
    label = steps[1]
    band = next(each for each in central_bands(here)[0] if each.label == label)
    hypothesis = central_bands(here)[1]
    low, high = float(band.low[hypothesis]), float(band.high[hypothesis])
    distance_m = np.arange(STEP_M, 13_000.0, STEP_M)
    rng = np.random.default_rng(1)
    kept = {tuple(cell) for cell in left[label].tolist()}
    gone = [tuple(cell) for cell in left["altitude"].tolist() if tuple(cell) not in kept]
    tried = [gone[i] for i in rng.choice(len(gone), TRIED, replace=False)]
    tangents = np.array([_highest(here, cell, band.azimuth_deg, distance_m)[0] for cell in tried])
    too_high = tried[int(np.nanargmin(np.abs(tangents - (high + 0.035))))]
    too_low = tried[int(np.nanargmin(np.abs(tangents - (low - 0.012))))]
    true_cell = (round(here.row), round(here.col))
    figure = new_figure(9.0, 6.4)
    for axes, cell, title, colour in zip(
        figure.subplots(3, 1, sharex=True),
        (true_cell, too_high, too_low),
        (
            "Stays: the highest POINT lies within the band",
            "Goes: a POINT stands above the band",
            "Goes: no POINT reaches the band",
        ),
        (GREEN, RED, RED),
        strict=True,
    ):
        _profile(axes, here, cell, band.azimuth_deg, distance_m, (low, high))
        axes.set_title(f"{title} (row {cell[0]}, column {cell[1]})", color=colour)
        axes.set_ylabel("altitude, m")
    figure.axes[0].legend(loc="upper left", ncols=3)
    axes.set_xlabel(f"distance towards azimuth {band.azimuth_deg:.1f}°, km")
    save(figure, "stage1-profile.svg")


def _eye_m(here: Scene, cell: tuple[int, ...]) -> float:
    return float(here.terrain.height_m[cell[0], cell[1]]) + here.observation.mast_height_m


def _highest(
    here: Scene, cell: tuple[int, ...], azimuth_deg: float, distance_m: Floats
) -> tuple[float, float]:
    """Tangent and distance of the highest POINT; NaN where the DEM ends on the way."""
    height_m = profile_m(here.terrain, cell[0], cell[1], azimuth_deg, distance_m)
    rise_m = height_m - here.terrain.drop_per_m2 * distance_m**2 - _eye_m(here, cell)
    if not np.isfinite(rise_m).all():
        return np.nan, np.nan
    at = int((rise_m / distance_m).argmax())
    return float(rise_m[at] / distance_m[at]), float(distance_m[at])


def _profile(
    axes: Axes,
    here: Scene,
    cell: tuple[int, ...],
    azimuth_deg: float,
    distance_m: Floats,
    band: tuple[float, float],
) -> None:
    eye_m, drop_m = _eye_m(here, cell), here.terrain.drop_per_m2 * distance_m**2
    height_m = profile_m(here.terrain, cell[0], cell[1], azimuth_deg, distance_m)
    low_m, high_m = (eye_m + tangent * distance_m + drop_m for tangent in band)
    km = distance_m / 1000.0
    tangent, far_m = _highest(here, cell, azimuth_deg, distance_m)
    axes.fill_between(km, height_m, 0.0, color=GROUND, lw=0.0)
    axes.fill_between(km, low_m, high_m, color=BLUE, alpha=0.35, lw=0.0, label="band of the skyline's height")
    top_m = eye_m + tangent * far_m + here.terrain.drop_per_m2 * far_m**2
    axes.plot(0.0, eye_m, "o", color="black", clip_on=False, label="CAMERA")
    axes.plot(far_m / 1000.0, top_m, "o", color=ORANGE, label="highest POINT")
    axes.set(
        xlim=(0.0, km[-1]), ylim=(float(np.nanmin(height_m)) - 20.0, 1.12 * max(top_m, float(high_m[-1])))
    )


def draw_map() -> None:
    """The cells that are left after each test."""
    here = scene(COMPACT)
    survivors = here.located.stage1.survivors
    figure = new_figure(9.0, 2.9)
    axes = figure.subplots(1, len(survivors), sharex=True, sharey=True)
    east_m, north_m = here.cell_m
    rows, cols = here.terrain.height_m.shape
    extent = (0.0, cols * east_m / 1000.0, -rows * north_m / 1000.0, 0.0)
    light = LightSource(azdeg=315, altdeg=45)
    shaded = light.hillshade(here.terrain.height_m[::2, ::2], vert_exag=1.5, dx=2 * east_m, dy=2 * north_m)
    for each, (step, cells) in zip(axes, survivors.items(), strict=True):
        each.imshow(0.55 + 0.45 * shaded, extent=extent, cmap="gray", vmin=0.0, vmax=1.0)
        each.scatter(
            cells[:, 1] * east_m / 1000.0, -cells[:, 0] * north_m / 1000.0, s=0.6, color=BLUE, lw=0.0
        )
        each.plot(
            here.col * east_m / 1000.0,
            -here.row * north_m / 1000.0,
            "o",
            mfc="none",
            mec=RED,
            ms=9.0,
            mew=1.6,
        )
        each.set_title(f"after {step}\n{len(cells):,} cells")
        each.set(xticks=[], yticks=[])
        for spine in each.spines.values():
            spine.set_visible(False)
    axes[0].set_ylabel(f"{rows * north_m / 1000.0:.0f} km", color=GREY)
    axes[0].set_xlabel(f"{cols * east_m / 1000.0:.0f} km", color=GREY)
    save(figure, "stage1-map.png")
