"""Plots of calibrations, drawn without a display."""

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure


def new_figure(title: str, panels: int) -> tuple[Figure, list[Axes]]:
    """A figure with this many panels side by side."""
    figure = Figure(figsize=(5.5 * panels, 4.6), dpi=110, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title, fontsize=12)
    return figure, [figure.add_subplot(1, panels, i + 1) for i in range(panels)]
