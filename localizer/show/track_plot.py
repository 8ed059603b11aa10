"""The plot of a track: all hypotheses on the whole DEM, and a detail map of the movements between the stops."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse, Rectangle
from numpy.typing import NDArray

from localizer.dem.geodesy import map_metres_at
from localizer.dem.ground import map_metres
from localizer.dem.lattice import Dem
from localizer.fix import ellipse, lat_lon
from localizer.show.plot import TRUE_MARKS
from localizer.show.relief import dem_bounds_m, draw_relief
from localizer.show.text import CHI2_95
from localizer.track.document import TrackHypothesis, TrackLine, track_line
from localizer.track.gaussian_place import matrix
from localizer.track.odometry import Odometry
from localizer.track.tracker import Step
from localizer.truth import Truth

Floats = NDArray[np.float64]
Bounds = tuple[float, float, float, float]
"""West, east, south, north in metres of the metric CRS."""

STOPS = colormaps["plasma"]
LEAST_ZOOM_CELLS = 12.0
"""Least half side of the detail map, in cells."""
SMALLEST_AREA, LARGEST_AREA = 14.0, 130.0
"""Of a hypothesis's mark, points^2, by its probability."""
LEAST_DRAWN = 0.01
"""Probability from which a hypothesis has a number and an arrow."""


def draw_track(
    path: Path, steps: Sequence[Step], odometry: Odometry, dem: Dem, truths: Sequence[Truth] = ()
) -> None:
    """Draw the picture into ``path``, in the format that its suffix names. ``truths``: none, or one for each step."""
    lines = [track_line(step, dem) for step in steps]
    figure = Figure(figsize=(16.0, 8.6), dpi=110, facecolor="white")
    FigureCanvasAgg(figure)
    figure.suptitle(_title(lines), fontsize=15, y=0.97)
    grid = figure.add_gridspec(
        2, 2, height_ratios=(1.0, 0.1), left=0.05, right=0.985, bottom=0.02, top=0.9, hspace=0.18, wspace=0.12
    )
    whole, near = figure.add_subplot(grid[0, 0]), figure.add_subplot(grid[0, 1])
    everything = dem_bounds_m(dem)
    draw_relief(whole, dem, everything, unit_m=1000.0)
    _draw_hypotheses(whole, lines, dem, (1000.0, 1000.0), (0.0, 0.0))
    zoom = _zoom(lines, truths, dem, everything)
    origin_m = ((zoom[0] + zoom[1]) / 2.0, (zoom[2] + zoom[3]) / 2.0)
    unit_m = map_metres(dem.metric_crs, *origin_m).axis_scales  # its axes count metres of the ground
    draw_relief(near, dem, zoom, origin_m=origin_m, unit_m=unit_m)
    _draw_legs(near, lines, odometry, dem, unit_m, origin_m)
    _draw_hypotheses(near, lines, dem, unit_m, origin_m)
    _draw_truths(near, truths, dem, unit_m, origin_m)
    _number_stops(near, lines, unit_m, origin_m)
    whole.add_patch(
        Rectangle(
            (zoom[0] / 1000.0, zoom[2] / 1000.0),
            (zoom[1] - zoom[0]) / 1000.0,
            (zoom[3] - zoom[2]) / 1000.0,
            fill=False,
            ec="black",
            lw=1.2,
        )
    )
    whole.set_title("all hypotheses: the whole DEM, km", fontsize=11, loc="left")
    near.set_title(f"the way, m from {origin_m[0]:.0f} E  {origin_m[1]:.0f} N", fontsize=11, loc="left")
    _draw_legend(figure.add_subplot(grid[1, :]), lines, truths)
    figure.savefig(path)


def _title(lines: Sequence[TrackLine]) -> str:
    last = lines[-1].fix
    where = f": {lat_lon(last.position)}" if last.position is not None else ""
    return f"{len(lines)} bundles, the last {last.status}{where}     probability {last.probability:.3f}"


def _zoom(lines: Sequence[TrackLine], truths: Sequence[Truth], dem: Dem, everything: Bounds) -> Bounds:
    """Bounds around the fixes, else around the most probable places, else of the whole DEM."""
    fixes = [line.fix.position for line in lines if line.fix.status == "fix" and line.fix.position]
    points = [(p.easting_m, p.northing_m) for p in fixes] or [
        (line.hypotheses[0].easting_m, line.hypotheses[0].northing_m) for line in lines if line.hypotheses
    ]
    points += [truth.metric(dem) for truth in truths]
    if not points:
        return everything
    west_m, south_m = np.min(points, axis=0)
    east_m, north_m = np.max(points, axis=0)
    middle = (west_m + east_m) / 2.0, (south_m + north_m) / 2.0
    scale = map_metres(dem.metric_crs, float(middle[0]), float(middle[1])).scale
    half_m = max(
        0.65 * max(east_m - west_m, north_m - south_m), scale * LEAST_ZOOM_CELLS * max(dem.spacing_ns_m, 1.0)
    )
    return (
        float(middle[0] - half_m),
        float(middle[0] + half_m),
        float(middle[1] - half_m),
        float(middle[1] + half_m),
    )


def _colour(number: int, of: int) -> tuple[float, float, float, float]:
    return STOPS(0.1 + 0.8 * number / max(of - 1, 1))


def _inside(axes: Axes, x: float, y: float) -> bool:
    (west, east), (south, north) = axes.get_xlim(), axes.get_ylim()
    return west <= x <= east and south <= y <= north


def _draw_hypotheses(
    axes: Axes,
    lines: Sequence[TrackLine],
    dem: Dem,
    unit_m: tuple[float, float],
    origin_m: tuple[float, float],
) -> None:
    """A mark for each, larger for the likelier and hollow where the bundle's images do not show it, with its 95 % ellipse."""
    for number, line in enumerate(lines):
        colour = _colour(number, len(lines))
        for h in line.hypotheses:
            x, y = (h.easting_m - origin_m[0]) / unit_m[0], (h.northing_m - origin_m[1]) / unit_m[1]
            if not _inside(axes, x, y):
                continue
            axes.scatter(
                [x],
                [y],
                s=SMALLEST_AREA + (LARGEST_AREA - SMALLEST_AREA) * h.probability,
                marker="D" if line.fix.status == "ambiguous" else "o",
                facecolor=colour if h.seen else "none",
                edgecolor="black" if h.seen else colour,
                linewidth=0.8 if h.seen else 1.6,
                zorder=5,
            )
            _draw_ellipse(axes, h, dem, x, y, unit_m, colour)


def _draw_ellipse(
    axes: Axes,
    hypothesis: TrackHypothesis,
    dem: Dem,
    x: float,
    y: float,
    unit_m: tuple[float, float],
    colour: tuple[float, float, float, float],
) -> None:
    here = map_metres(dem.metric_crs, hypothesis.easting_m, hypothesis.northing_m)
    in_units = here.map_covariance(hypothesis.covariance_m2) / np.outer(unit_m, unit_m)
    one_sigma = ellipse(matrix(in_units))
    axes.add_patch(
        Ellipse(
            (x, y),
            2.0 * np.sqrt(CHI2_95) * one_sigma.major_m,
            2.0 * np.sqrt(CHI2_95) * one_sigma.minor_m,
            angle=90.0 - one_sigma.grid_azimuth_deg,
            facecolor=(*colour[:3], 0.15),
            edgecolor=colour,
            lw=1.2,
        )
    )


def _draw_legs(
    axes: Axes,
    lines: Sequence[TrackLine],
    odometry: Odometry,
    dem: Dem,
    unit_m: tuple[float, float],
    origin_m: tuple[float, float],
) -> None:
    """The movement by odometry from each hypothesis, as an arrow."""
    for line, leg in zip(lines[:-1], odometry, strict=True):
        if leg is None:
            continue
        for start in line.hypotheses:
            x, y = (start.easting_m - origin_m[0]) / unit_m[0], (start.northing_m - origin_m[1]) / unit_m[1]
            if start.probability < LEAST_DRAWN or not _inside(axes, x, y):
                continue
            step = map_metres_at(dem, start.row, start.col).to_map @ leg.step_m / unit_m
            axes.annotate(
                "",
                (x + float(step[0]), y + float(step[1])),
                (x, y),
                arrowprops={"arrowstyle": "->", "lw": 1.6, "color": "black"},
                annotation_clip=True,
            )


def _number_stops(
    axes: Axes, lines: Sequence[TrackLine], unit_m: tuple[float, float], origin_m: tuple[float, float]
) -> None:
    for number, line in enumerate(lines):
        for h in line.hypotheses:
            x, y = (h.easting_m - origin_m[0]) / unit_m[0], (h.northing_m - origin_m[1]) / unit_m[1]
            if h.probability >= LEAST_DRAWN and _inside(axes, x, y):
                axes.annotate(
                    str(number + 1), (x, y), (9, 9), textcoords="offset points", fontsize=12, weight="bold"
                )


def _draw_truths(
    axes: Axes,
    truths: Sequence[Truth],
    dem: Dem,
    unit_m: tuple[float, float],
    origin_m: tuple[float, float],
) -> None:
    for truth in truths:
        easting_m, northing_m = truth.metric(dem)
        for style in TRUE_MARKS:
            mark = Line2D([(easting_m - origin_m[0]) / unit_m[0]], [(northing_m - origin_m[1]) / unit_m[1]])
            mark.update_from(style)
            mark.set_zorder(4.0)
            axes.add_artist(mark)


def _draw_legend(axes: Axes, lines: Sequence[TrackLine], truths: Sequence[Truth]) -> None:
    handles: list[tuple[Line2D | tuple[Line2D, ...], str]] = []
    for number, line in enumerate(lines):
        marker = "D" if line.fix.status == "ambiguous" else "o"
        style = Line2D([], [], ls="", marker=marker, mfc=_colour(number, len(lines)), mec="black", ms=9.0)
        handles.append((style, f"{number + 1}  {line.bundle}: {line.fix.status} ({line.mode})"))
    handles.append(
        (Line2D([], [], ls="", marker="o", mfc="none", mec="grey", ms=9.0), "not shown by its bundle")
    )
    if truths:
        handles.append((TRUE_MARKS, "true places"))
    axes.axis("off")
    axes.legend(
        [handle for handle, _ in handles],
        [label for _, label in handles],
        loc="center",
        ncols=3,
        frameon=False,
        fontsize=10 if len(handles) <= 6 else 8,
    )
