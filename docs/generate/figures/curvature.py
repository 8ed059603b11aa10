"""What the curved Earth and the refracting air do to a height and to an angle."""

import numpy as np

from generate.figures.drawing import BLUE, GREY, ORANGE, new_figure, save
from localizer.dem.horizon import EARTH_RADIUS_M, REFRACTION

FOCAL_PX = 492.8


def draw() -> None:
    """The apparent drop by distance, and the angle that it makes."""
    distance_m = np.linspace(0.0, 60_000.0, 300)
    figure = new_figure(9.0, 3.2)
    drop, angle = figure.subplots(1, 2)
    for refraction, colour, label in (
        (0.0, GREY, "no refraction, k = 0"),
        (REFRACTION, BLUE, f"k = {REFRACTION:g}"),
    ):
        drop_m = (1.0 - refraction) * distance_m**2 / (2.0 * EARTH_RADIUS_M)
        drop.plot(distance_m / 1000.0, drop_m, color=colour, label=label)
        angle_mrad = 1000.0 * (1.0 - refraction) * distance_m / (2.0 * EARTH_RADIUS_M)
        angle.plot(distance_m / 1000.0, angle_mrad, color=colour)
    at_20_m = (1.0 - REFRACTION) * 20_000.0**2 / (2.0 * EARTH_RADIUS_M)
    drop.plot(20.0, at_20_m, "o", color=ORANGE)
    drop.annotate(
        f"{at_20_m:.0f} m at 20 km", (20.0, at_20_m), (-4, 10), textcoords="offset points", ha="right"
    )
    drop.set(xlabel="distance, km", ylabel="apparent drop, m", title="A far ridge seems to be lower ...")
    drop.legend()
    angle.set(
        xlabel="distance, km", ylabel="milliradians", title="... by an angle that grows with the distance"
    )
    pixels = angle.secondary_yaxis(
        "right", functions=(lambda a: a * FOCAL_PX / 1000.0, lambda p: p * 1000.0 / FOCAL_PX)
    )
    pixels.set_ylabel(f"pixels, at f = {FOCAL_PX:g} px")
    save(figure, "curvature.svg")
