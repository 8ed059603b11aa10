"""Drawing of predicted skylines: shaded terrain that fades with distance, and the skyline coloured by distance."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap, LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, MaxNLocator
from numpy.typing import NDArray

from localizer.dem.horizon import Terrain
from localizer.predict.depth import panorama
from localizer.predict.lens import Pointed
from localizer.predict.text import name_of
from localizer.predict.views import Standpoint, View

Floats = NDArray[np.float64]

LAND = LinearSegmentedColormap.from_list("land", ["#5a6b3c", "#7f8a5c", "#9aa58c", "#aebbc0", "#c3d0de"])
"""From near to far, as in haze."""
DISTANCE = LinearSegmentedColormap.from_list("distance", ["#c1121f", "#f07d00", "#7a3db8", "#1d3fbb"])
SKY_TOP, SKY_BOTTOM = np.array([0.80, 0.89, 0.97]), np.array([0.96, 0.98, 1.0])
RIDGE = 1.18
"""Two neighbouring pixels whose distances differ by this factor lie on two ridges."""
EDGE_COLOUR, NEAR_COLOUR = "#ff00c8", "#111111"
MARGIN_DEG = (2.5, 1.6)
"""Below the skyline's lowest and above its highest point."""
WIDTH_INCHES = 13.0
MOST_LABELS = 6
FEWEST_TICKS = 3
LABEL_SPACING = 0.06
"""Of a view's width, so that no label covers another."""


class Shading:
    """Colour scale of distances, from the nearest to the farthest skyline of a picture."""

    def __init__(self, nearest_m: float, farthest_m: float) -> None:
        self.nearest_m, self.farthest_m = nearest_m, farthest_m
        self.norm = LogNorm(nearest_m, farthest_m)

    def share(self, distance_m: Floats) -> Floats:
        """0 at the nearest and nearer, 1 at the farthest and in the sky."""
        known_m = np.where(np.isfinite(distance_m), distance_m, self.farthest_m)
        return np.asarray(np.clip(np.asarray(self.norm(known_m), float), 0.0, 1.0))


def draw_views(
    path: Path,
    terrain: Terrain,
    place: Standpoint,
    views: Sequence[View],
    cameras: Sequence[Pointed] | None = None,
) -> None:
    """Draw each view into ``path``, in the format that its suffix names.

    ``cameras``: with them each view is drawn as that camera's picture, else over azimuth and elevation.
    """
    met_m = np.concatenate([v.distance_m[np.isfinite(v.distance_m)] for v in views])
    nearest_m, farthest_m = (met_m.min(), met_m.max()) if met_m.size else (100.0, 1000.0)
    shading = Shading(max(float(nearest_m), 10.0), max(float(farthest_m), 100.0))
    across = 1 if cameras is None or len(views) == 1 else 2
    down = -(-len(views) // across)
    tall = 2.7
    if cameras is not None:
        camera = cameras[0].camera
        tall = (WIDTH_INCHES / across - 0.6) * camera.height_px / camera.width_px
    figure = Figure(figsize=(WIDTH_INCHES, down * (tall + 0.65) + 1.0), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    title = f"Skyline from {place.lat_deg:.5f}°, {place.lon_deg:.5f}°, camera at {place.altitude_m:.0f} m"
    figure.suptitle(title, fontsize=13, x=0.01, ha="left")
    axes = figure.subplots(down, across, squeeze=False).ravel()
    for i, seen in enumerate(views):
        if cameras is None:
            _draw_angles(axes[i], terrain, place, seen, shading)
        else:
            _draw_pixels(axes[i], terrain, place, seen, cameras[i], shading)
    for spare in axes[len(views) :]:
        spare.axis("off")
    _draw_key(figure, axes, shading, views)
    figure.savefig(path)


def _draw_key(figure: Figure, axes: NDArray[np.object_], shading: Shading, views: Sequence[View]) -> None:
    bar = figure.colorbar(
        ScalarMappable(shading.norm, DISTANCE),
        ax=list(axes),
        orientation="horizontal",
        aspect=70,
        pad=0.01,
        shrink=0.7,
    )
    bar.set_label("distance of the skyline, km", fontsize=9)
    ticks = [v for v in _ROUND_M if shading.nearest_m <= v <= shading.farthest_m]
    if len(ticks) < FEWEST_TICKS:
        between = MaxNLocator(5).tick_values(shading.nearest_m, shading.farthest_m)
        ticks = [v for v in between if shading.nearest_m <= v <= shading.farthest_m]
    bar.set_ticks(ticks, labels=[f"{v / 1000.0:g}" for v in ticks])
    bar.ax.minorticks_off()
    handles = []
    if any(v.at_edge.any() for v in views):
        handles.append(
            Line2D([], [], color=EDGE_COLOUR, lw=3, label="edge of the DEM: terrain beyond unknown")
        )
    if any(v.too_near.any() for v in views):
        handles.append(Line2D([], [], color=NEAR_COLOUR, lw=3, label="nearer than two cells: shape unknown"))
    if handles:
        figure.legend(handles=handles, loc="outside upper right", ncols=2, fontsize=9, frameon=False)


_ROUND_M = [m * 10.0**e for e in range(1, 6) for m in (1, 2, 5)]


def _draw_angles(axes: Axes, terrain: Terrain, place: Standpoint, seen: View, shading: Shading) -> None:
    bottom_deg, top_deg = _range_deg(seen)
    land = panorama(terrain, place, seen, bottom_deg, top_deg)
    left, right = seen.offset_deg[[0, -1]]
    axes.imshow(
        _coloured(land.distance_m, land.brightness, shading),
        extent=(left, right, bottom_deg, top_deg),
        aspect="auto",
        interpolation="antialiased",
    )
    _draw_skyline(axes, seen, seen.offset_deg, seen.elevation_deg, shading)
    axes.axhline(0.0, color="black", lw=0.6, alpha=0.35, ls=(0, (6, 4)))
    axes.set_xlim(left, right)
    axes.set_ylim(bottom_deg, top_deg)
    step_deg = next(step for step in (1.0, 2.0, 5.0, 10.0, 30.0) if seen.width_deg <= 14.0 * step)
    first = np.ceil((seen.azimuth_deg + left) / step_deg) * step_deg
    ticks = np.arange(first, seen.azimuth_deg + right + 1e-9, step_deg)
    axes.set_xticks(ticks - seen.azimuth_deg, labels=[f"{azimuth % 360.0:g}°" for azimuth in ticks])
    axes.yaxis.set_major_formatter(FuncFormatter(lambda y, _: f"{y:+g}°" if y else "0°"))
    axes.tick_params(labelsize=8)
    axes.set_title(f"{name_of(seen.azimuth_deg)}: true azimuth and elevation", fontsize=10, loc="left")


def _draw_pixels(
    axes: Axes, terrain: Terrain, place: Standpoint, seen: View, pointed: Pointed, shading: Shading
) -> None:
    camera = pointed.camera
    u_px, v_px = np.meshgrid(
        np.linspace(0, camera.width_px - 1, min(camera.width_px, 800)),
        np.linspace(0, camera.height_px - 1, min(camera.height_px, 600)),
    )
    azimuth, elevation = pointed.directions_deg(u_px.ravel(), v_px.ravel())
    offset = (azimuth - seen.azimuth_deg + 180.0) % 360.0 - 180.0
    land = panorama(terrain, place, seen, float(elevation.min()), float(elevation.max()))
    distance_m, brightness = (np.reshape(values, u_px.shape) for values in land.at(offset, elevation))
    axes.imshow(
        _coloured(distance_m, brightness, shading),
        extent=(-0.5, camera.width_px - 0.5, camera.height_px - 0.5, -0.5),
        interpolation="antialiased",
    )
    u, v = pointed.pixels(seen.azimuths_deg, seen.elevation_deg)
    _draw_skyline(axes, seen, u, v, shading)
    axes.set_xlim(-0.5, camera.width_px - 0.5)
    axes.set_ylim(camera.height_px - 0.5, -0.5)
    axes.tick_params(labelsize=8)
    _azimuth_ticks(axes, seen, pointed)
    axes.set_title(
        f"{name_of(seen.azimuth_deg)}: tilted {pointed.tilt_deg:+.1f}°; true azimuth in the middle row",
        fontsize=10,
        loc="left",
    )


def _azimuth_ticks(axes: Axes, seen: View, pointed: Pointed) -> None:
    """Azimuths below the columns where the middle row shows them."""
    whole = np.arange(np.ceil(seen.azimuth_deg - 90.0), seen.azimuth_deg + 90.0)
    u_px, _ = pointed.pixels(whole, np.full(len(whole), pointed.tilt_deg))
    inside = (u_px > 0.0) & (u_px < pointed.camera.width_px - 1.0) & (whole % 10.0 == 0.0)
    axes.set_xticks(u_px[inside], labels=[f"{azimuth % 360.0:g}°" for azimuth in whole[inside]])


def _range_deg(seen: View) -> tuple[float, float]:
    lowest_deg, highest_deg = seen.range_deg
    return lowest_deg - MARGIN_DEG[0], highest_deg + MARGIN_DEG[1]


def _coloured(distance_m: Floats, brightness: Floats, shading: Shading) -> Floats:
    """(rows, columns, 3): haze and hillshade, ridges outlined, over a sky that pales downwards."""
    rows, columns = distance_m.shape
    fade = np.linspace(0.0, 1.0, rows)[:, None, None]
    sky = np.broadcast_to(SKY_TOP * (1.0 - fade) + SKY_BOTTOM * fade, (rows, columns, 3))
    land = np.isfinite(distance_m)
    far_share = shading.share(distance_m)[..., None]
    contrast = 0.75 * (1.0 - 0.55 * far_share)
    shade = 1.0 + contrast * (np.where(land, brightness, 0.7)[..., None] - 0.7)
    colour = np.clip(LAND(far_share[..., 0])[..., :3] * shade, 0.0, 1.0)
    ridge = np.zeros_like(land)
    ridge[1:] = land[1:] & land[:-1] & (distance_m[:-1] > RIDGE * distance_m[1:])
    colour = np.where(ridge[..., None], colour * 0.62, colour)
    return np.where(land[..., None], colour, sky)


def _draw_skyline(axes: Axes, seen: View, x: Floats, y: Floats, shading: Shading) -> None:
    """The skyline coloured by distance, its doubtful parts, and the summits' distances above it."""
    met = np.isfinite(seen.distance_m) & np.isfinite(x) & np.isfinite(y)
    points = np.column_stack([x, y])
    pieces = list(np.stack([points[:-1], points[1:]], axis=1)[met[:-1] & met[1:]])
    axes.add_collection(LineCollection(pieces, colors="white", linewidths=4.0, capstyle="round"))
    lines = LineCollection(pieces, cmap=DISTANCE, norm=shading.norm, linewidths=2.2, capstyle="round")
    lines.set_array(seen.distance_m[:-1][met[:-1] & met[1:]])
    axes.add_collection(lines)
    for doubtful, colour in ((seen.at_edge, EDGE_COLOUR), (seen.too_near, NEAR_COLOUR)):
        there = doubtful & met
        axes.plot(np.where(there, x, np.nan), np.where(there, y, np.nan), color=colour, lw=3.2)
    highest = sorted(seen.summits, key=lambda s: -s.elevation_deg)[:MOST_LABELS]
    labelled: list[float] = []
    for summit in highest:
        offset = (summit.azimuth_deg - seen.azimuth_deg + 180.0) % 360.0 - 180.0
        at = int(np.argmin(np.abs(seen.offset_deg - offset)))
        if not met[at] or any(abs(x[at] - other) < LABEL_SPACING * abs(x[-1] - x[0]) for other in labelled):
            continue
        labelled.append(x[at])
        share = (x[at] - x[0]) / (x[-1] - x[0])  # at the sides the label stays in the picture
        axes.annotate(
            _distance(summit.distance_m),
            (x[at], y[at]),
            xytext=(0.0, 9.0),
            textcoords="offset points",
            ha="left" if share < 0.03 else "right" if share > 0.97 else "center",
            fontsize=8.5,
            annotation_clip=True,
            bbox={"boxstyle": "round,pad=0.15", "fc": "white", "ec": "none", "alpha": 0.75},
        )
        axes.plot(x[at], y[at], marker="v", color="black", ms=4.0)


def _distance(distance_m: float) -> str:
    return f"{distance_m / 1000.0:.1f} km" if distance_m >= 950.0 else f"{distance_m:.0f} m"
