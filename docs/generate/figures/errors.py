"""Why a thousand columns are not a thousand observations: neighbours see the same error of the DEM."""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from generate.figures.drawing import BLUE, GREY, ORANGE, RED, new_figure, save

Floats = NDArray[np.float64]

COLUMNS, VIEW_DEG = 1000, 60.0
CELL_M = 30.0
CONTOUR_RAD = 0.7 / 492.8
"""Of the contour: 0.7 px."""
ROUGH_M, SMOOTH_M = 0.5, 1.5
LENGTHS_M = {60.0: ORANGE, 300.0: BLUE, 1500.0: RED}


def covariance(distance_m: float, length_m: float) -> Floats:
    """Of the residuals (n, n) of columns that all see a ridge at one distance, square radians.

    Independent noise of the contour, an Ornstein-Uhlenbeck process that is forgotten in a cell, a Matern process of
    smoothness 3/2 that goes on for ``length_m``; s metres seen from d metres are s / d radians.
    """
    azimuth = np.linspace(0.0, np.radians(VIEW_DEG), COLUMNS)
    along_m = distance_m * np.abs(azimuth[:, None] - azimuth)
    scaled = np.sqrt(3.0) * along_m / length_m
    height2 = ROUGH_M**2 * np.exp(-along_m / CELL_M) + SMOOTH_M**2 * (1.0 + scaled) * np.exp(-scaled)
    return np.asarray(CONTOUR_RAD**2 * np.eye(COLUMNS) + height2 / distance_m**2)


def effective_number(residuals: Floats) -> float:
    """How many independent columns would tell a common offset as well as these correlated ones."""
    ones = np.ones(len(residuals))
    return float(residuals[0, 0] * (ones @ cho_solve(cho_factor(residuals), ones)))


def draw() -> None:
    """Residuals of a near and of a far ridge, and how many observations they are worth."""
    figure = new_figure(9.0, 3.6)
    samples, numbers = figure.subplots(1, 2)
    azimuth_deg = np.linspace(0.0, VIEW_DEG, COLUMNS)
    rng = np.random.default_rng(3)
    white = rng.standard_normal(COLUMNS)
    for distance_m, colour, shift in ((500.0, RED, 12.0), (10_000.0, BLUE, 0.0)):
        drawn = np.linalg.cholesky(covariance(distance_m, 300.0)) @ white
        samples.plot(
            azimuth_deg,
            1000.0 * drawn + shift,
            color=colour,
            lw=0.6,
            label=f"ridge at {distance_m / 1000.0:g} km",
        )
        samples.axhline(shift, color=GREY, lw=0.6)
    samples.set(
        xlabel="azimuth, °",
        ylabel="residual, milliradians (upper one shifted)",
        title="Residuals by one and the same error model",
    )
    samples.legend(loc="upper right", ncols=2)
    samples.set_ylim(-7.0, 26.0)
    distances_m = np.geomspace(100.0, 50_000.0, 16)
    for length_m, colour in LENGTHS_M.items():
        worth = [effective_number(covariance(distance, length_m)) for distance in distances_m]
        numbers.loglog(distances_m / 1000.0, worth, color=colour, label=f"{length_m:.0f} m")
    numbers.axhline(COLUMNS, color=GREY, lw=0.7, ls=":")
    numbers.set(
        xlabel="distance of the ridge, km",
        ylabel="effective number of columns",
        title=f"What {COLUMNS} columns are worth",
        ylim=(0.8, 1500.0),
    )
    numbers.legend(title="DEM error correlated over", loc="lower right")
    save(figure, "errors.svg")
