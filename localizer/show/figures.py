"""The figures of the HTML report, each as a WebP image."""

from collections.abc import Sequence
from io import BytesIO

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from numpy.typing import NDArray

from localizer.dem.geodesy import rowcol_to_metric
from localizer.dem.ground import ground_distance_m
from localizer.dem.lattice import Dem
from localizer.search.details import FrameDetail, LocateResult
from localizer.show.candidates import CandidatePlace, ellipse_ring_m
from localizer.show.plot import (
    DOUBTFUL,
    PLACE,
    draw_frame,
    draw_map,
    few_ticks,
    outline_cells,
    stage1_steps_of,
)
from localizer.show.posterior import Posterior
from localizer.show.relief import dem_bounds_m, draw_relief
from localizer.show.text import CHI2_95
from localizer.truth import Truth

Floats = NDArray[np.float64]

DPI = 110
QUALITY = 88
FRAME_INCHES = 7.4
MAPS_ACROSS = 3
MAP_PIXELS = 420
MOST_DETAIL_MAPS = 6
CELLS_AROUND = 3.5
LEAST_RESIDUAL_RANGE_PX = 2.0
PROBABILITY_COLOURS = LinearSegmentedColormap.from_list(
    "probability", [(0.55, 0.1, 0.75, 0.0), (0.6, 0.1, 0.7, 0.55), (0.85, 0.0, 0.25, 0.85)]
)


def residuals_px(frame: FrameDetail) -> Floats:
    """By how many pixels the skyline found lies above the predicted one, (n,); NaN where none is predicted."""
    if len(frame.predicted_u_px) < 2:
        return np.full(len(frame.found_u_px), np.nan)
    column_px, row_px = frame.turned_px(frame.predicted_u_px, frame.predicted_v_px)
    found_column_px, found_row_px = frame.turned_px(frame.found_u_px, frame.found_v_px)
    order = np.argsort(column_px)
    predicted_row_px = np.interp(found_column_px, column_px[order], row_px[order], left=np.nan, right=np.nan)
    return np.asarray(predicted_row_px - found_row_px)


def frame_picture(image: NDArray[np.uint8], frame: FrameDetail, rms_px: float | None) -> bytes:
    """A frame with its skylines, and below it the residuals."""
    height_px, width_px = image.shape[:2]
    wide = FRAME_INCHES * min(1.0, width_px / height_px)
    tall = wide * height_px / width_px
    placed = len(frame.predicted_u_px) > 1
    below = 1.55 if placed else 0.0
    whole = tall + 0.35 + below
    figure = _figure(wide, whole)
    axes = figure.add_axes((0.075, below / whole, 0.915, 0.915 * tall / whole))
    draw_frame(axes, image, frame, rms_px)
    if placed:
        below_picture = figure.add_axes((0.075, 0.42 / whole, 0.915, 1.05 / whole))
        _draw_residuals(below_picture, frame, height_px, width_px, rms_px)
    return _webp(figure)


def _draw_residuals(
    axes: Axes, frame: FrameDetail, height_px: int, width_px: int, rms_px: float | None
) -> None:
    column_px = frame.turned_px(frame.found_u_px, frame.found_v_px, height_px, width_px)[0]
    residual_px = residuals_px(frame)
    if rms_px is not None:
        axes.axhspan(-rms_px, rms_px, color="#e6eef5", lw=0.0)
    axes.axhline(0.0, color="#8a8f98", lw=0.8)
    for chosen, colour in ((~frame.used, DOUBTFUL), (frame.used, "#0086a8")):
        axes.plot(column_px[chosen], residual_px[chosen], ".", color=colour, ms=2.5)
    known = np.abs(residual_px[frame.used & np.isfinite(residual_px)])
    # outliers must not determine the scale
    reach_px = max(LEAST_RESIDUAL_RANGE_PX, 1.3 * float(np.percentile(known, 98)) if known.size else 0.0)
    axes.set_xlim(-0.5, (height_px if frame.quarter_turns % 2 else width_px) - 0.5)
    axes.set_ylim(-reach_px, reach_px)
    axes.set_xlabel("column, px", fontsize=9, labelpad=1)
    axes.set_ylabel("found above\npredicted, px", fontsize=8, labelpad=1)
    axes.tick_params(labelsize=8)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def stage1_maps(result: LocateResult, dem: Dem) -> bytes:
    """A small map for each step of stage 1, with the cells left."""
    steps = stage1_steps_of(result.details)
    across = len(steps) if len(steps) <= MAPS_ACROSS + 1 else MAPS_ACROSS
    down = -(-len(steps) // across)
    bounds_m = dem_bounds_m(dem)
    aspect = (bounds_m[3] - bounds_m[2]) / (bounds_m[1] - bounds_m[0])
    wide = 10.0 / across
    figure = _figure(10.0, down * (wide * aspect + 0.35))
    grid = figure.add_gridspec(
        down, across, left=0.005, right=0.995, bottom=0.005, top=1.0 - 0.3 / (down * (wide * aspect + 0.35))
    )
    grid.update(wspace=0.03, hspace=0.35 / (wide * aspect))
    for i, (name, cells, colour, area) in enumerate(steps):
        axes = figure.add_subplot(grid[i // across, i % across])
        draw_relief(axes, dem, bounds_m, unit_m=1000.0, pixels=MAP_PIXELS)
        easting_m, northing_m = rowcol_to_metric(dem, cells[:, 0], cells[:, 1])
        axes.scatter(easting_m / 1000.0, northing_m / 1000.0, s=area, c=colour, marker="s", lw=0.0)
        axes.set_title(f"after {name}: {len(cells):,} cells", fontsize=10, loc="left", pad=3)
        axes.set_xticks([])
        axes.set_yticks([])
    return _webp(figure)


def map_picture(
    result: LocateResult, places: Sequence[CandidatePlace], dem: Dem, truth: Truth | None
) -> bytes:
    """The whole DEM with all steps on one map, the fix or the numbered candidates."""
    west_m, east_m, south_m, north_m = dem_bounds_m(dem)
    figure = _figure(10.0, 1.0 + 9.0 * (north_m - south_m) / (east_m - west_m))
    axes = figure.add_subplot()
    draw_map(axes, result, dem, truth)
    if len(places) > 1:
        for place in places:
            axes.annotate(
                str(place.rank),
                (place.easting_m / 1000.0, place.northing_m / 1000.0),
                xytext=(7, 5),
                textcoords="offset points",
                fontsize=11,
                fontweight="bold",
                bbox={"boxstyle": "round,pad=0.15", "fc": "white", "ec": "none", "alpha": 0.8},
            )
    figure.tight_layout(pad=0.4)
    return _webp(figure)


def posterior_picture(
    places: Sequence[CandidatePlace], posterior: Posterior, dem: Dem, truth: Truth | None
) -> bytes:
    """Maps around the most probable places, with the probability of each cell and the 95 % ellipses."""
    shown = places[:MOST_DETAIL_MAPS]
    cell_m = max(dem.spacing_ns_m, dem.spacing_ew_m)
    views = [(place, max(_reach_m(place), CELLS_AROUND * cell_m)) for place in shown]
    if len(shown) == 1 and _reach_m(shown[0]) < 0.5 * views[0][1]:
        views.append((shown[0], _reach_m(shown[0])))  # otherwise the marker would cover the ellipse
    across = 1 if len(views) == 1 else 2 if len(views) in (2, 4) else 3
    down = -(-len(views) // across)
    size = 6.0 if across == 1 else 10.0 / across
    figure = _figure(size * across, (size + 0.1) * down)
    for i, (place, half_m) in enumerate(views):
        axes = figure.add_subplot(down, across, i + 1)
        _draw_surroundings(axes, place, half_m, places, posterior, dem, truth)
    figure.tight_layout(pad=0.5)
    return _webp(figure)


def _reach_m(place: CandidatePlace) -> float:
    return float(1.4 * np.sqrt(CHI2_95) * place.axes.major_m)


def _draw_surroundings(
    axes: Axes,
    place: CandidatePlace,
    half_m: float,
    places: Sequence[CandidatePlace],
    posterior: Posterior,
    dem: Dem,
    truth: Truth | None,
) -> None:
    origin_m = (place.easting_m, place.northing_m)
    unit_m = place.here.axis_scales  # the axes count metres of the ground
    true_m = truth.metric(dem) if truth is not None else None
    if true_m is not None:
        off_m = ground_distance_m(dem.metric_crs, origin_m, true_m)
        # a distant true place would make the ellipse invisible
        half_m = max(half_m, 1.2 * off_m) if off_m < 8.0 * half_m else half_m
    bounds_m = (
        origin_m[0] - half_m * unit_m[0],
        origin_m[0] + half_m * unit_m[0],
        origin_m[1] - half_m * unit_m[1],
        origin_m[1] + half_m * unit_m[1],
    )
    draw_relief(axes, dem, bounds_m, origin_m=origin_m, unit_m=unit_m, pixels=500)
    rows, cols = posterior.probability.shape
    easting_m, northing_m = rowcol_to_metric(
        dem,
        posterior.first_row - 0.5 + np.arange(rows + 1)[:, None],
        posterior.first_col - 0.5 + np.arange(cols + 1)[None, :],
    )
    probability = np.clip(posterior.probability, 0.0, None)
    near = _largest_nearby(posterior, place, probability)
    axes.pcolormesh(
        (easting_m - origin_m[0]) / unit_m[0],
        (northing_m - origin_m[1]) / unit_m[1],
        probability,
        cmap=PROBABILITY_COLOURS,
        vmin=0.0,
        vmax=near,
        shading="flat",
    )
    outline_cells(axes, dem, bounds_m, origin_m, unit_m)
    for other in places:
        ring_e_m, ring_n_m = ellipse_ring_m(other)
        axes.fill(
            (ring_e_m - origin_m[0]) / unit_m[0],
            (ring_n_m - origin_m[1]) / unit_m[1],
            fc="none",
            ec="black",
            lw=1.6 if other is place else 0.9,
        )
    axes.plot(0.0, 0.0, "*", mfc=PLACE, mec="black", mew=0.9, ms=15.0)
    if true_m is not None:
        axes.plot(
            (true_m[0] - origin_m[0]) / unit_m[0],
            (true_m[1] - origin_m[1]) / unit_m[1],
            "o",
            mfc="none",
            mec="white",
            mew=2.2,
            ms=14.0,
        )
    axes.set_xlim(-half_m, half_m)
    axes.set_ylim(-half_m, half_m)
    axes.set_title(
        f"{place.rank}: probability {place.probability:.3f},  ± {place.axes.major_m:.1f} x {place.axes.minor_m:.1f} m",
        fontsize=10,
        loc="left",
        pad=4,
    )
    axes.set_xlabel("metres east of it (grid)", fontsize=9, labelpad=2)
    few_ticks(axes, 5)


def _largest_nearby(posterior: Posterior, place: CandidatePlace, probability: NDArray[np.float32]) -> float:
    """The highest probability around a place: colours are each map's own."""
    row, col = round(place.row) - posterior.first_row, round(place.col) - posterior.first_col
    part = probability[max(row - 3, 0) : max(row + 4, 0), max(col - 3, 0) : max(col + 4, 0)]
    return max(float(part.max()) if part.size else 0.0, 1e-9)


def _figure(width_inches: float, height_inches: float) -> Figure:
    figure = Figure(figsize=(width_inches, height_inches), dpi=DPI, facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def _webp(figure: Figure) -> bytes:
    buffer = BytesIO()
    figure.savefig(
        buffer, format="webp", bbox_inches="tight", pad_inches=0.04, pil_kwargs={"quality": QUALITY}
    )
    return buffer.getvalue()
