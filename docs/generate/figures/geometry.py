"""The geometry of the paper: from a row in the picture to a line over the terrain."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Arc

from generate.figures.drawing import BLUE, GREEN, GREY, GROUND, ORANGE, RED, new_figure, save
from generate.figures.scene import COMPACT, Floats, central_bands, profile_m, scene
from localizer.dem.horizon import horizon


def draw() -> None:
    """The camera from the side, and a real profile with the line of sight over it."""
    figure = new_figure(9.0, 3.8)
    camera, terrain = figure.subplots(1, 2, width_ratios=[1.0, 1.5])
    _camera(camera)
    _terrain(terrain)
    save(figure, "geometry.svg")


def _camera(axes: Axes) -> None:
    tilt, focal, height = np.radians(14.0), 3.0, 0.95
    axis = np.array([np.cos(tilt), np.sin(tilt)])
    up = np.array([-np.sin(tilt), np.cos(tilt)])
    middle, seen = focal * axis, focal * axis + height * up
    axes.plot([0.0, 4.4], [0.0, 0.0], color=GREY, lw=0.8, ls="--")
    origin = np.zeros(2)
    _line(axes, origin, 1.42 * middle, BLUE, 1.2)
    _line(axes, origin, 1.34 * seen, RED, 1.6)
    _line(axes, middle - 1.5 * up, middle + 1.5 * up, "black", 2.0)
    _line(axes, middle, seen, ORANGE, 3.0)
    axes.plot(0.0, 0.0, "o", color="black", ms=6.0)
    alpha = np.degrees(tilt + np.arctan(height / focal))
    axes.add_patch(Arc((0.0, 0.0), 3.2, 3.2, theta1=0.0, theta2=np.degrees(tilt), color=BLUE, lw=1.2))
    axes.add_patch(Arc((0.0, 0.0), 4.2, 4.2, theta1=0.0, theta2=alpha, color=RED, lw=1.2))
    for at, words, colour, size in (
        (np.array([1.68, 0.12]), "φ", BLUE, 11.0),
        (np.array([2.14, 0.66]), "α", RED, 11.0),
        (middle + 0.45 * height * up + [0.1, 0.0], "h", ORANGE, 11.0),
        (0.42 * middle + [-0.05, 0.1], "f", BLUE, 11.0),
        (1.3 * middle + [-0.05, -0.36], "optical axis", BLUE, 9.0),
        (1.34 * seen + [-1.55, 0.06], "to the horizon", RED, 9.0),
        (middle - 1.5 * up + [0.1, -0.08], "image", "black", 9.0),
        (np.array([-0.1, -0.34]), "optical centre, altitude H", "black", 9.0),
        (np.array([3.55, -0.24]), "horizontal", GREY, 9.0),
    ):
        axes.text(at[0], at[1], words, color=colour, fontsize=size)
    axes.set(xlim=(-0.4, 4.7), ylim=(-1.1, 2.6), aspect="equal", title="The camera, seen from the side")
    axes.axis("off")


def _line(axes: Axes, start: Floats, end: Floats, colour: str, width: float) -> None:
    axes.plot([start[0], end[0]], [start[1], end[1]], color=colour, lw=width)


def _terrain(axes: Axes) -> None:
    here = scene(COMPACT)
    band = central_bands(here)[0][0]
    angle_deg, far_m = horizon(here.terrain, here.row, here.col, here.altitude_m, band.azimuth_deg)
    alpha, x_m = float(angle_deg[0, 0]), float(far_m[0, 0])
    distance_m = np.linspace(1.0, 1.35 * x_m, 600)
    height_m = profile_m(here.terrain, here.row, here.col, band.azimuth_deg, distance_m)
    drop_m = here.terrain.drop_per_m2 * distance_m**2
    sight_m = here.altitude_m + distance_m * np.tan(np.radians(alpha)) + drop_m
    lowest = float(height_m.min()) - 25.0
    axes.fill_between(distance_m / 1000.0, height_m, lowest, color=GROUND, lw=0.0)
    axes.plot(distance_m / 1000.0, sight_m, color=RED, lw=1.6)
    axes.axhline(here.altitude_m, color=GREY, lw=0.8, ls="--")
    top_m = float(np.interp(x_m, distance_m, sight_m))
    axes.plot(0.0, here.altitude_m, "o", color="black", ms=6.0, clip_on=False)
    axes.plot(x_m / 1000.0, top_m, "o", color=GREEN, ms=6.0)
    axes.annotate("camera: H", (0.0, here.altitude_m), (6, -14), textcoords="offset points")
    axes.annotate(
        f"horizon point: x = {x_m:.0f} m, Z = {top_m:.0f} m",
        (x_m / 1000.0, top_m),
        (0, 20),
        textcoords="offset points",
        ha="center",
        color=GREEN,
    )
    axes.text(
        0.03,
        0.94,
        f"Z(x) = H + x tan α + (1 - k) x² / 2R,  α = {alpha:.2f}°",
        transform=axes.transAxes,
        color=RED,
    )
    axes.set(
        xlabel="horizontal distance x, km",
        ylabel="altitude, m",
        title=f"The terrain at azimuth {band.azimuth_deg:.0f}° of a simulated place",
        xlim=(-0.02 * x_m / 1000.0, None),
        ylim=(lowest, top_m + 0.35 * (top_m - lowest)),
    )
