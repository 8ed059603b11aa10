"""The command ``localizer predict``."""

import json
import math
from pathlib import Path

import click

from localizer.commands.command_line import FiniteRange
from localizer.commands.dem_options import dem_choice, dem_option
from localizer.dem.choice import DemChoice
from localizer.dem.crs import wrapped_lon_deg
from localizer.errors import SkyfixError
from localizer.output_files import check_picture_path, writing
from localizer.show.output_parts import OutputParts

MAIN_DIRECTIONS_DEG = (0.0, 90.0, 180.0, 270.0)
PANORAMA_DEG = (180.0,)
"""A full panorama is one view, from north to north."""
USUAL_WIDTH_DEG = 66.0
"""Of the contract's example camera."""


def parse_place(text: str) -> tuple[float, float]:
    """Latitude and longitude in degrees, the latter wrapped to -180 <= lon < 180. Raises ``SkyfixError``."""
    try:
        lat_deg, lon_deg = (float(part) for part in text.split(","))
    except ValueError:
        raise SkyfixError(f"--at: {text!r} is not LAT,LON; write it as --at 37.20,-122.10") from None
    if not (abs(lat_deg) <= 90.0 and abs(lon_deg) <= 360.0):  # NaN is not either
        raise SkyfixError(
            f"--at: {text}: latitude lies within 90 and longitude within 180 degrees (or 0 to 360); the latitude comes first"
        )
    return lat_deg, wrapped_lon_deg(lon_deg)


@click.command()
@dem_option
@click.option("--at", "place_text", metavar="LAT,LON", required=True, help="The place, WGS84 degrees.")
@click.option(
    "--azimuth",
    "azimuths_deg",
    metavar="A",
    type=float,
    multiple=True,
    help="True direction of the view's middle in degrees; repeat it for more views. Default: 0, 90, 180, 270; "
    "of a panorama 180.",
)
@click.option(
    "--mast-height",
    "mast_height_m",
    metavar="M",
    type=FiniteRange(0.0, 1000.0),
    default=2.0,
    show_default=True,
    help="Metres of the camera above the ground.",
)
@click.option(
    "--fov-deg",
    "width_deg",
    metavar="F",
    type=FiniteRange(1.0, 360.0),
    help=f"Width of a view; {USUAL_WIDTH_DEG:g} unless given. 360 makes a panorama.",
)
@click.option(
    "--camera",
    "camera_path",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="Draw what this camera would see: a bundle, or a JSON file with its intrinsics.",
)
@click.option(
    "--out",
    "picture_path",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="Draw it (.png, .svg, .pdf).",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object (skyfix.predict/1).")
@dem_choice
def predict(
    chosen_dem: DemChoice,
    place_text: str,
    azimuths_deg: tuple[float, ...],
    mast_height_m: float,
    width_deg: float | None,
    camera_path: Path | None,
    picture_path: Path | None,
    as_json: bool,
) -> None:
    """Say what skyline a camera would see from a place, and how far away it is.

    For planning a trip and for checking an elevation model against what one sees. Warns where the skyline comes from the
    edge of the model or lies nearer than the model can resolve.

    Example: localizer predict --dem terrain.tif --at 37.25,-122.15 --azimuth 0 --azimuth 135 --out view.png
    """
    from localizer.predict import lens
    from localizer.predict.text import fields, text
    from localizer.predict.views import standpoint, view

    lat_deg, lon_deg = parse_place(place_text)
    if not all(math.isfinite(azimuth_deg) for azimuth_deg in azimuths_deg):
        raise SkyfixError("--azimuth: is a direction in degrees, as 135")
    if picture_path is not None:
        check_picture_path("--out", picture_path)
    if camera_path is not None and width_deg is not None:
        raise SkyfixError("--fov-deg: the camera has a width of its own; give one of --camera and --fov-deg")
    camera = lens.load_camera(camera_path) if camera_path is not None else None
    dem = chosen_dem.load_to_search("localizer")
    try:
        place = standpoint(dem, lat_deg, lon_deg, mast_height_m)
    except SkyfixError as error:
        raise SkyfixError(f"--at: {error}") from None

    from localizer.dem.horizon import prepare_terrain

    terrain = prepare_terrain(dem)
    usual_deg = PANORAMA_DEG if width_deg == 360.0 else MAIN_DIRECTIONS_DEG
    directions_deg = [azimuth_deg % 360.0 for azimuth_deg in azimuths_deg or usual_deg]
    if camera is not None:
        width_deg = lens.width_deg(camera)
    views = [view(terrain, place, a, width_deg or USUAL_WIDTH_DEG) for a in directions_deg]
    cameras = None
    notes: list[list[str]] = [[] for _ in views]
    if camera is not None:
        cameras = [lens.pointed_at(camera, seen) for seen in views]
        both = list(zip(cameras, views, strict=True))
        views = [view(terrain, place, p.azimuth_deg, lens.whole_width_deg(p, seen)) for p, seen in both]
        notes = [lens.notes(pointed, seen) for pointed, seen in zip(cameras, views, strict=True)]
    click.echo(json.dumps(fields(place, views, notes)) if as_json else text(place, views, notes))
    if picture_path is not None:
        from localizer.predict.picture import draw_views

        parts = OutputParts()
        with parts.part(f"--out: {picture_path}"), writing("--out", picture_path):
            draw_views(picture_path, terrain, place, views, cameras)
        parts.end()
