"""The plot of a fix: the frames with their skylines, and a map with the cells left after each step of stage 1."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LinearSegmentedColormap, to_hex
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpecFromSubplotSpec, SubplotSpec
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse, Rectangle
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from localizer.dem.geodesy import metric_to_rowcol, rowcol_to_metric
from localizer.dem.ground import map_metres
from localizer.dem.lattice import Dem
from localizer.fix import Fix, ellipse, lat_lon
from localizer.search.details import FrameDetail, LocateDetails, LocateResult
from localizer.show.relief import dem_bounds_m, draw_relief
from localizer.show.text import CHI2_95
from localizer.truth import Truth

Floats = NDArray[np.float64]

FOUND, DOUBTFUL, PREDICTED = "#00d5ff", "#ff9d00", "#ff1f8f"
PLACE = "#ffe600"
STAGE_COLOURS = LinearSegmentedColormap.from_list(
    "stages", ["#98a3ff", "#4657e8", "#00a4c7", "#f07d00", "#e0101f"]
)
"""From the first step of stage 1 to the last."""
STAGE_AREA = 6000.0
SMALLEST_AREA, LARGEST_AREA = 1.6, 40.0
"""Total area of the markers of a step, points^2; least and largest area of one marker."""
MOST_CELLS_OUTLINED = 25
MOST_LARGE_ENTRIES = 9


def draw_fix(
    path: Path,
    images: Mapping[str, NDArray[np.uint8]],
    result: LocateResult,
    dem: Dem,
    truth: Truth | None = None,
) -> None:
    """Draw the picture into ``path``, in the format that its suffix names.

    ``images`` holds each frame's picture, BGR, by the frame's label.
    """
    figure = Figure(figsize=(16.0, 8.3), dpi=110, facecolor="white")
    FigureCanvasAgg(figure)
    figure.suptitle(_title(result.fix, dem, truth), fontsize=15, x=0.5, y=0.975)
    whole = figure.add_gridspec(
        1, 2, width_ratios=(1.36, 1.0), left=0.012, right=0.988, bottom=0.06, top=0.905, wspace=0.09
    )
    _draw_frames(figure, whole[0, 0], images, result)
    right = GridSpecFromSubplotSpec(2, 1, whole[0, 1], height_ratios=(2.3, 1.0), hspace=0.2)
    draw_map(figure.add_subplot(right[0, 0]), result, dem, truth)
    below = GridSpecFromSubplotSpec(1, 2, right[1, 0], width_ratios=(1.25, 1.0), wspace=0.05)
    _draw_detail(figure.add_subplot(below[0, 0]), result, dem, truth)
    _draw_legend(figure.add_subplot(below[0, 1]), result, truth)
    figure.savefig(path)


def _title(fix: Fix, dem: Dem, truth: Truth | None) -> str:
    if fix.position is None:
        return f"{fix.status}: the frames fit no place in this DEM"
    parts = [f"{fix.status}: {lat_lon(fix.position)}"]
    if fix.covariance_m2 is not None:
        axes = ellipse(fix.covariance_m2)
        parts.append(f"± {axes.major_m:.1f} x {axes.minor_m:.1f} m (1 sigma)")
    parts.append(f"probability {fix.probability:.3f}")
    if truth is not None:
        parts.append(f"true error {truth.distance_m(fix.position, dem):.1f} m")
    return "     ".join(parts)


# ---- the frames


def _draw_frames(
    figure: Figure, place: SubplotSpec, images: Mapping[str, NDArray[np.uint8]], result: LocateResult
) -> None:
    frames = result.details.frames
    across = int(np.ceil(np.sqrt(len(frames))))
    down = -(-len(frames) // across)
    grid = GridSpecFromSubplotSpec(
        down + 1, across, place, height_ratios=[1.0] * down + [0.05], hspace=0.045 * down, wspace=0.02
    )
    for i, frame in enumerate(frames):
        axes = figure.add_subplot(grid[i // across, i % across])
        draw_frame(axes, images[frame.label], frame, result.fix.residual.get(frame.label))
    axes = figure.add_subplot(grid[down, :])
    axes.axis("off")
    axes.legend(
        handles=[
            Line2D([], [], color=FOUND, lw=3, label="skyline found"),
            Line2D([], [], color=DOUBTFUL, lw=3, label="found, too doubtful to use"),
            Line2D([], [], color=PREDICTED, lw=2, ls="--", label="skyline predicted at the fix"),
        ],
        loc="center",
        ncols=3,
        frameon=False,
        fontsize=11,
    )


def draw_frame(axes: Axes, image: NDArray[np.uint8], frame: FrameDetail, residual_px: float | None) -> None:
    """A frame (height, width, 3) BGR with the skylines found and predicted; ``residual_px``: rms of those columns that fit."""
    height_px, width_px = image.shape[:2]
    axes.imshow(image[:, :, ::-1], interpolation="antialiased")
    for chosen, colour in ((~frame.used, DOUBTFUL), (frame.used, FOUND)):
        u_px, v_px = _line_with_gaps(frame, frame.found_u_px[chosen], frame.found_v_px[chosen])
        axes.plot(u_px, v_px, color=colour, lw=2.8, solid_capstyle="round")
    order = np.argsort(frame.turned_px(frame.predicted_u_px, frame.predicted_v_px)[0])
    axes.plot(
        frame.predicted_u_px[order], frame.predicted_v_px[order], color=PREDICTED, lw=1.3, ls=(0, (5, 2))
    )
    axes.set_xlim(-0.5, width_px - 0.5)
    axes.set_ylim(height_px - 0.5, -0.5)
    axes.set_xticks([])
    axes.set_yticks([])
    residual = "" if residual_px is None else f"     residual {residual_px:.2f} px"
    if frame.left_out:
        residual = "     left out: it contradicts the others"
    axes.set_title(f"{frame.label}{residual}", fontsize=11, loc="left", pad=4)


def _line_with_gaps(frame: FrameDetail, u_px: Floats, v_px: Floats) -> tuple[Floats, Floats]:
    """The points ordered by the columns of the upright frame, with NaN where columns are missing."""
    column_px = frame.turned_px(u_px, v_px)[0]
    order = np.argsort(column_px)
    u_px, v_px = u_px[order], v_px[order]
    gaps = np.flatnonzero(np.diff(column_px[order]) > 1.5) + 1
    return np.insert(u_px, gaps, np.nan), np.insert(v_px, gaps, np.nan)


# ---- the map


def draw_map(axes: Axes, result: LocateResult, dem: Dem, truth: Truth | None) -> None:
    """The whole DEM, in kilometres of its metric CRS, with what each step of stage 1 left."""
    draw_relief(axes, dem, dem_bounds_m(dem), unit_m=1000.0)
    for _, cells, colour, area in stage1_steps_of(result.details):
        easting_m, northing_m = rowcol_to_metric(dem, cells[:, 0], cells[:, 1])
        axes.scatter(
            easting_m / 1000.0, northing_m / 1000.0, s=area, c=colour, marker="s", lw=0.0, rasterized=True
        )
    _draw_places(axes, result.fix, dem, truth, (1000.0, 1000.0), (0.0, 0.0))
    axes.set_xlabel(f"easting, km   ({dem.metric_crs.name})", fontsize=9, labelpad=2)
    axes.set_ylabel("northing, km", fontsize=9, labelpad=2)
    few_ticks(axes, 7)


def stage1_steps_of(details: LocateDetails) -> list[tuple[str, NDArray[np.int64], str, float]]:
    """Name, cells, colour and area of a cell's mark for each step; the last step always has the last colour."""
    steps = list(details.survivors.items())
    along = np.linspace(1.0, 0.0, len(steps))[::-1]
    return [
        (
            name,
            cells,
            to_hex(STAGE_COLOURS(float(position))),
            float(np.clip(STAGE_AREA / max(len(cells), 1), SMALLEST_AREA, LARGEST_AREA)),
        )
        for (name, cells), position in zip(steps, along, strict=True)
    ]


def _draw_detail(axes: Axes, result: LocateResult, dem: Dem, truth: Truth | None) -> None:
    """A detail map around the fix, scaled so that its ellipse is visible; metres on the ground from the fix."""
    position, covariance_m2 = result.fix.position, result.fix.covariance_m2
    if position is None or covariance_m2 is None:
        axes.axis("off")
        return
    origin_m = position.easting_northing_m
    one_sigma = ellipse(covariance_m2)
    half_m = 1.5 * np.sqrt(CHI2_95) * one_sigma.major_m
    if truth is not None:
        off_m = truth.distance_m(position, dem)
        # a distant true place would make the ellipse invisible again
        half_m = max(half_m, 1.3 * off_m) if off_m < 12.0 * half_m else half_m
    unit_m = map_metres(dem.metric_crs, *origin_m).axis_scales
    bounds_m = (
        origin_m[0] - 1.6 * half_m * unit_m[0],
        origin_m[0] + 1.6 * half_m * unit_m[0],
        origin_m[1] - half_m * unit_m[1],
        origin_m[1] + half_m * unit_m[1],
    )
    draw_relief(axes, dem, bounds_m, origin_m=origin_m, unit_m=unit_m)
    outline_cells(axes, dem, bounds_m, origin_m, unit_m)
    axes.add_patch(
        Ellipse(
            (0.0, 0.0),
            2.0 * np.sqrt(CHI2_95) * one_sigma.major_m,
            2.0 * np.sqrt(CHI2_95) * one_sigma.minor_m,
            angle=90.0 - one_sigma.grid_azimuth_deg,
            facecolor=(1.0, 0.9, 0.0, 0.25),
            edgecolor="black",
            lw=1.4,
        )
    )
    _draw_places(axes, result.fix, dem, truth, unit_m, origin_m)
    axes.set_xlabel("metres from the fix", fontsize=9, labelpad=2)
    few_ticks(axes, 5)


def outline_cells(
    axes: Axes,
    dem: Dem,
    bounds_m: tuple[float, float, float, float],
    origin_m: tuple[float, float],
    unit_m: tuple[float, float],
) -> None:
    """The borders of the DEM's cells, for scale, where there are few enough of them; as in ``draw_relief``."""
    west_m, east_m, south_m, north_m = bounds_m
    row, col = metric_to_rowcol(dem, [west_m, east_m, west_m, east_m], [south_m, south_m, north_m, north_m])
    first_row, last_row, first_col, last_col = (
        int(np.floor(end)) for end in (row.min(), row.max() + 1, col.min(), col.max() + 1)
    )
    if max(last_row - first_row, last_col - first_col) > MOST_CELLS_OUTLINED:
        return
    rows, cols = np.arange(first_row, last_row + 1) + 0.5, np.arange(first_col, last_col + 1) + 0.5
    for line_row, line_col in [(np.full(2, r), cols[[0, -1]]) for r in rows] + [
        (rows[[0, -1]], np.full(2, c)) for c in cols
    ]:
        easting_m, northing_m = rowcol_to_metric(dem, line_row, line_col)
        axes.plot(
            (easting_m - origin_m[0]) / unit_m[0],
            (northing_m - origin_m[1]) / unit_m[1],
            color="black",
            lw=0.5,
            alpha=0.4,
        )


def _draw_places(
    axes: Axes,
    fix: Fix,
    dem: Dem,
    truth: Truth | None,
    unit_m: tuple[float, float],
    origin_m: tuple[float, float],
) -> None:
    """The candidates of an ambiguous result, the fix and the true place."""

    def mark(easting_m: float, northing_m: float, style: Line2D) -> None:
        marker = Line2D([(easting_m - origin_m[0]) / unit_m[0]], [(northing_m - origin_m[1]) / unit_m[1]])
        marker.update_from(style)
        marker.set_zorder(5.0)
        axes.add_artist(marker)

    if fix.status == "ambiguous":
        for candidate in fix.candidates:
            mark(candidate.easting_m, candidate.northing_m, CANDIDATE_MARK)
    if truth is not None:
        for style in TRUE_MARKS:
            mark(*truth.metric(dem), style)
    if fix.position is not None:
        mark(fix.position.easting_m, fix.position.northing_m, FIX_MARK)


CANDIDATE_MARK = Line2D([], [], ls="", marker="D", mfc=PLACE, mec="black", mew=0.9, ms=7.0)
FIX_MARK = Line2D([], [], ls="", marker="*", mfc=PLACE, mec="black", mew=0.9, ms=14.0)
TRUE_MARKS = (
    Line2D([], [], ls="", marker="o", mfc="none", mec="black", mew=4.0, ms=15.0),
    Line2D([], [], ls="", marker="o", mfc="none", mec="white", mew=2.0, ms=15.0),
)


def few_ticks(axes: Axes, most: int) -> None:
    """Ticks at round numbers, at most ``most`` along each axis."""
    axes.tick_params(labelsize=9)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(nbins=most, steps=[1, 2, 5, 10]))
    axes.ticklabel_format(style="plain", useOffset=False)


def _draw_legend(axes: Axes, result: LocateResult, truth: Truth | None) -> None:
    """What the map shows, with the number of cells left after each step."""
    handles: list[tuple[Line2D | Rectangle | tuple[Line2D, ...], str]] = [
        (
            Line2D([], [], ls="", marker="s", mfc=colour, mec="none", ms=7.0),
            f"{len(cells):,} cells left after {name}",
        )
        for name, cells, colour, _ in stage1_steps_of(result.details)
    ]
    if result.fix.status == "ambiguous":
        handles.append((CANDIDATE_MARK, f"{len(result.fix.candidates)} candidates"))
    if result.fix.position is not None:
        handles.append((FIX_MARK, "fix" if result.fix.status == "fix" else "likeliest candidate"))
    if result.fix.covariance_m2 is not None:
        handles.append(
            (Rectangle((0, 0), 1, 1, fc=(1.0, 0.9, 0.0, 0.25), ec="black", lw=1.4), "its 95 % ellipse")
        )
    if truth is not None:
        handles.append((TRUE_MARKS, "true place"))
    axes.axis("off")
    axes.legend(
        [handle for handle, _ in handles],
        [label for _, label in handles],
        loc="center left",
        frameon=False,
        fontsize=10 if len(handles) <= MOST_LARGE_ENTRIES else 8,
        labelspacing=0.65 if len(handles) <= MOST_LARGE_ENTRIES else 0.3,
    )
