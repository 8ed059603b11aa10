"""``rig calibrate``: what a field crew does before the rig is worth its sensors."""

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from rig.cli_options import config_option
from rig.signals import stopping_cleanly

if TYPE_CHECKING:
    from rig.calibrate.place import KnownPlace

out_option = click.option(
    "--out",
    "out_dir",
    metavar="DIR",
    type=click.Path(path_type=Path, file_okay=False),
    help="Where the calibration goes; by default the folder calibration beside the configuration.",
)
json_option = click.option("--json", "as_json", is_flag=True, help="Print the result as one JSON object.")
yes_option = click.option("--yes", is_flag=True, help="Ask nothing: all is ready, and the result is used.")

at_option = click.option(
    "--at", metavar="LAT,LON", help="The known place where the vehicle stands, WGS84 degrees."
)
dem_option = click.option(
    "--dem",
    "dem_paths",
    metavar="FILE",
    type=click.Path(path_type=Path),
    multiple=True,
    help="Elevation file for --at; repeat it for files that adjoin.",
)

# What fits and draws is slow to import: the commands import it.


@click.group()
def calibrate() -> None:
    """Find the rig's own errors, in this order: camera, inclinometer, compass, altimeter, boresight.

    Each writes a dated file that the configuration names from then on, and a picture of its residuals beside it.

    Example: rig calibrate inclinometer --config vehicle.toml
    """


@calibrate.command()
@config_option
@out_option
@yes_option
@json_option
@click.option(
    "--angles", type=click.IntRange(6, 36), default=8, show_default=True, help="Pan angles to read at."
)
@click.option(
    "--temperature-log",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="CSV of rig calibrate temperature-log: gives the drift of the zero with temperature.",
)
def inclinometer(
    config_file: Path | None,
    out_dir: Path | None,
    yes: bool,
    as_json: bool,
    angles: int,
    temperature_log: Path | None,
) -> None:
    """Zero, scale and mounting of the inclinometer, by turning the head; the vehicle's slope comes with it.

    Example: rig calibrate inclinometer --angles 12
    """
    from rig.calibrate.inclinometer import calibrate_inclinometer
    from rig.calibrate.session import Session

    session = Session.open(config_file, out_dir, yes, as_json)
    with stopping_cleanly():
        calibrate_inclinometer(session, angles, temperature_log)


@calibrate.command("temperature-log")
@config_option
@click.option(
    "--out", "path", metavar="FILE", type=click.Path(path_type=Path), required=True, help="CSV to add to."
)
@click.option("--minutes", type=click.FloatRange(0.0), default=60.0, show_default=True)
@json_option
def temperature_log_(config_file: Path | None, path: Path, minutes: float, as_json: bool) -> None:
    """Log the inclinometer of a head that does not move while the day warms or cools it.

    Example: rig calibrate temperature-log --out drift.csv --minutes 240
    """
    from contextlib import closing

    from rig.calibrate.temperature import record_temperature_log
    from rig.config import config_path, load_config
    from rig.connect import open_inclinometer

    section = load_config(config_path(config_file)).inclinometer
    with stopping_cleanly(), closing(open_inclinometer(section)) as chip:
        count = record_temperature_log(chip, section, path, 60.0 * minutes)
    click.echo(json.dumps({"file": str(path), "readings": count}) if as_json else f"{path}: {count} readings")


@calibrate.command()
@config_option
@out_option
@yes_option
@json_option
@at_option
@dem_option
@click.option(
    "--altitude", "altitude_m", type=float, metavar="M", help="Known altitude of the camera, instead of --at."
)
@click.option(
    "--sigma",
    "sigma_m",
    type=click.FloatRange(0.1),
    default=1.5,
    show_default=True,
    help="How well it is known, metres.",
)
@click.option(
    "--air", "air_c", type=click.FloatRange(-60.0, 60.0), metavar="C", help="Temperature of the air."
)
@click.option(
    "--drift",
    "drift_m_h",
    type=click.FloatRange(0.0),
    default=4.0,
    show_default=True,
    help="Metres an hour that the weather may move it from then on.",
)
def altimeter(
    config_file: Path | None,
    out_dir: Path | None,
    yes: bool,
    as_json: bool,
    at: str | None,
    dem_paths: tuple[Path, ...],
    altitude_m: float | None,
    sigma_m: float,
    air_c: float | None,
    drift_m_h: float,
) -> None:
    """The air pressure at a known altitude, or at a known place on a DEM; its trust fades from then on.

    \b
    Examples:
      rig calibrate altimeter --altitude 812.5 --air 14
      rig calibrate altimeter --at 37.2012,-122.1034 --dem terrain.tif --air 14
    """
    if (altitude_m is None) == (at is None):
        raise click.UsageError("Give either --altitude, or --at with --dem.")

    from rig.calibrate.altimeter import KnownAltitude, calibrate_altimeter
    from rig.calibrate.session import Session

    session = Session.open(config_file, out_dir, yes, as_json)
    if at is not None:
        altitude_m = known_place_of(at, dem_paths).ground_m + session.config.rig.mast_height_m
    assert altitude_m is not None
    with stopping_cleanly():
        calibrate_altimeter(session, KnownAltitude(altitude_m, sigma_m), air_c, drift_m_h)


def known_place_of(at: str, dem_paths: tuple[Path, ...], option: str = "--at") -> "KnownPlace":
    from rig.calibrate.place import known_place, parse_place

    if not dem_paths:
        raise click.UsageError(f"{option} needs --dem FILE.")
    try:
        lat_deg, lon_deg = parse_place(at)
    except ValueError as error:
        raise click.UsageError(f"{option}: {error}.") from error
    return known_place(lat_deg, lon_deg, dem_paths, option)


@calibrate.command()
@config_option
@out_option
@yes_option
@json_option
@click.option(
    "--headings",
    type=click.IntRange(1, 36),
    default=8,
    show_default=True,
    help="Of the vehicle. 1: it is not turned, and its iron stays unknown.",
)
@click.option(
    "--angles", type=click.IntRange(4, 36), default=6, show_default=True, help="Pan angles at each heading."
)
def compass(
    config_file: Path | None, out_dir: Path | None, yes: bool, as_json: bool, headings: int, angles: int
) -> None:
    """Hard and soft iron of the pan stage, by turning the pan, and of the vehicle, by turning the vehicle.

    \b
    Examples:
      rig calibrate compass
      rig calibrate compass --headings 1
    """
    if yes and headings > 1:
        raise click.UsageError("--yes goes with --headings 1 only: somebody has to turn the vehicle.")

    from rig.calibrate.compass import calibrate_compass
    from rig.calibrate.session import Session

    session = Session.open(config_file, out_dir, yes, as_json)
    with stopping_cleanly():
        calibrate_compass(session, headings, angles)


place_sigma_option = click.option(
    "--place-sigma",
    "place_sigma_m",
    type=click.FloatRange(0.1),
    default=4.0,
    show_default=True,
    help="How well the place is known, metres.",
)
dem_sigma_option = click.option(
    "--dem-sigma",
    "dem_sigma_m",
    type=click.FloatRange(0.0),
    default=1.5,
    show_default=True,
    help="How far the DEM's ridges are off in height, metres.",
)


@calibrate.command()
@config_option
@out_option
@yes_option
@json_option
@at_option
@dem_option
@place_sigma_option
@dem_sigma_option
@click.option(
    "--directions", type=click.IntRange(4, 24), default=8, show_default=True, help="To look in, all round."
)
def boresight(
    config_file: Path | None,
    out_dir: Path | None,
    yes: bool,
    as_json: bool,
    at: str | None,
    dem_paths: tuple[Path, ...],
    place_sigma_m: float,
    dem_sigma_m: float,
    directions: int,
) -> None:
    """How the camera sits against head and sensors, from the skyline that the DEM has at a known place.

    Example: rig calibrate boresight --at 37.2012,-122.1034 --dem terrain.tif
    """
    if at is None:
        raise click.UsageError(
            "Give --at LAT,LON and --dem FILE: the boresight is measured at a known place."
        )

    from rig.calibrate.boresight import calibrate_boresight
    from rig.calibrate.boresight_fit import PlaceSigmas
    from rig.calibrate.session import Session

    session = Session.open(config_file, out_dir, yes, as_json)
    place = known_place_of(at, dem_paths)
    with stopping_cleanly():
        sigmas = PlaceSigmas(place_sigma_m, dem_sigma_m, dem_sigma_m)
        calibrate_boresight(session, place, sigmas, directions)


@calibrate.command()
@click.option(
    "--near", "near", metavar="LAT,LON", required=True, help="Where to look for places, WGS84 degrees."
)
@dem_option
@click.option(
    "--within", "within_km", type=click.FloatRange(0.05), default=5.0, show_default=True, help="Kilometres."
)
@click.option(
    "--mast",
    "mast_m",
    type=click.FloatRange(0.1),
    default=2.0,
    show_default=True,
    help="Camera above ground, metres.",
)
@place_sigma_option
@dem_sigma_option
@click.option("--count", type=click.IntRange(1, 50), default=5, show_default=True, help="How many to name.")
@click.option("--json", "as_json", is_flag=True, help="Print a JSON list instead of lines.")
def sites(
    near: str,
    dem_paths: tuple[Path, ...],
    within_km: float,
    mast_m: float,
    place_sigma_m: float,
    dem_sigma_m: float,
    count: int,
    as_json: bool,
) -> None:
    """Where to calibrate the boresight: places whose skyline is far and rugged, best first.

    \b
    Examples:
      rig calibrate sites --near 37.2012,-122.1034 --dem terrain.tif
      rig calibrate sites --near 37.2012,-122.1034 --dem terrain.tif --within 2 --json
    """
    import json
    from dataclasses import asdict

    from rig.calibrate.boresight_fit import PlaceSigmas
    from rig.calibrate.sites import best_sites

    place = known_place_of(near, dem_paths, "--near")
    sigmas = PlaceSigmas(place_sigma_m, dem_sigma_m, dem_sigma_m)
    found = best_sites(place, 1000.0 * within_km, mast_m, sigmas, count)
    if as_json:
        click.echo(json.dumps([asdict(site) for site in found], indent=2))
        return
    for site in found:
        click.echo(
            f"{site.lat_deg:.5f},{site.lon_deg:.5f}  ground {site.ground_m:.0f} m  tilt +- {site.tilt_sigma_deg:.3f} deg  "
            f"azimuth +- {site.azimuth_sigma_deg:.3f} deg  {site.far_share:.0%} of the ridges farther than 1 km"
        )


board_option = click.option(
    "--board",
    "board_text",
    default="charuco:9x7:30:22",
    show_default=True,
    metavar="TEXT",
    help="charuco:COLUMNSxROWS:SQUARE_MM:MARKER_MM or chessboard:COLUMNSxROWS:SQUARE_MM (inner corners).",
)


@calibrate.command()
@config_option
@out_option
@yes_option
@json_option
@board_option
@click.option(
    "--images", metavar="GLOB", help="Pictures of the board instead of the live camera; quote the pattern."
)
@click.option("--views", type=click.IntRange(10, 200), default=25, show_default=True, help="To take live.")
def camera(
    config_file: Path | None,
    out_dir: Path | None,
    yes: bool,
    as_json: bool,
    board_text: str,
    images: str | None,
    views: int,
) -> None:
    """Intrinsics and distortion of the camera, from views of a board (see rig calibrate board).

    \b
    Examples:
      rig calibrate camera
      rig calibrate camera --images "shots/*.png" --board chessboard:9x6:25
    """
    from rig.calibrate.board import parse_board
    from rig.calibrate.camera import calibrate_camera
    from rig.calibrate.session import Session

    try:
        board = parse_board(board_text)
    except ValueError as error:
        raise click.UsageError(f"--board: {error}.") from error
    session = Session.open(config_file, out_dir, yes, as_json)
    with stopping_cleanly():
        calibrate_camera(session, board, images, views)


@calibrate.command("board")
@board_option
@click.option(
    "--out", "path", metavar="FILE", type=click.Path(path_type=Path), required=True, help="PNG to write."
)
@json_option
def board_(board_text: str, path: Path, as_json: bool) -> None:
    """Draw the board for the printer: 300 dots an inch, true size. Glue it to something flat and measure a square.

    Example: rig calibrate board --out board.png
    """
    from rig.calibrate.board import parse_board, print_board

    try:
        parse_board(board_text)
    except ValueError as error:
        raise click.UsageError(f"--board: {error}.") from error
    print_board(board_text, path)
    click.echo(json.dumps({"file": str(path), "board": board_text}) if as_json else path)
