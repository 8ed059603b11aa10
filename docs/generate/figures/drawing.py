"""How the figures look, and how they are saved: the same bytes from the same numbers."""

from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
from numpy.typing import NDArray
from PIL import Image

FOLDER = Path(__file__).resolve().parents[2] / "figures"
MOST_BYTES = 300_000
DOTS_PER_INCH = 130
COLOURS = 128

# Okabe and Ito's colours, which people who see colours differently can tell apart.
BLUE, ORANGE, GREEN, RED, SKY, PURPLE = "#0072b2", "#e69f00", "#009e73", "#d55e00", "#56b4e9", "#cc79a7"
GREY, GROUND = "#666666", "#b9a88a"

CHI2_95 = 5.991464547107979
"""Of two degrees of freedom: a squared distance in standard deviations that 95 % stay below."""


def new_figure(width_in: float, height_in: float) -> Figure:
    """An empty figure with the common style."""
    mpl.rcParams.update(
        {
            "font.size": 9.0,
            "axes.spines.top": False,
            "axes.spines.right": False,
            "axes.titlesize": 10.0,
            "axes.titlelocation": "left",
            "legend.frameon": False,
            "svg.hashsalt": "skyfix",
        }
    )
    return Figure(figsize=(width_in, height_in), layout="constrained")


def save(figure: Figure, name: str) -> None:
    """Write a figure; ``name`` says the format. A picture of pixels has a palette, which makes it small."""
    path = FOLDER / name
    if path.suffix == ".svg":
        figure.savefig(path, facecolor="white", metadata={"Date": None})
    else:
        drawn = BytesIO()
        figure.savefig(drawn, format="png", dpi=DOTS_PER_INCH, facecolor="white")
        Image.open(drawn).convert("RGB").quantize(COLOURS).save(path, optimize=True)
    if path.stat().st_size > MOST_BYTES:
        raise ValueError(f"{path} is larger than {MOST_BYTES} bytes")


def draw_ellipse(
    axes: Axes, centre: Sequence[float], covariance: NDArray[np.float64], chi2: float, **style: Any
) -> None:
    """The ellipse of all points whose squared distance, in standard deviations, is ``chi2``."""
    variances, directions = np.linalg.eigh(covariance)
    minor, major = 2.0 * np.sqrt(chi2 * variances)
    angle_deg = float(np.degrees(np.arctan2(directions[1, 1], directions[0, 1])))
    axes.add_patch(Ellipse((centre[0], centre[1]), major, minor, angle=angle_deg, fill=False, **style))
