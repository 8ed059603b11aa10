"""``rig calibrate inclinometer``, ``temperature-log``, ``compass`` and ``altimeter``: calibrations without a skyline."""

import json
from pathlib import Path

import click

from localizer.commands.command_line import FiniteRange
from rig.commands.calibrate_options import (
    CommonOptions,
    at_option,
    calibration_run_options,
    dem_option,
    json_option,
    known_place_of,
)
from rig.commands.options import config_option
from rig.commands.signals import stopping_cleanly


@click.command()
@calibration_run_options
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
    common: CommonOptions,
    angles: int,
    temperature_log: Path | None,
) -> None:
    """Calibrate zero, scale and mounting of the inclinometer by moving the head; the vehicle may stand on a slope.

    Example: rig calibrate inclinometer --angles 12
    """
    from rig.calibrate.inclinometer.procedure import calibrate_inclinometer

    with common.calibration_run() as calibration_run:
        calibrate_inclinometer(calibration_run, angles, temperature_log)


@click.command("temperature-log")
@config_option
@click.option(
    "--out", "path", metavar="FILE", type=click.Path(path_type=Path), required=True, help="CSV to add to."
)
@click.option(
    "--minutes", type=FiniteRange(0.0), default=60.0, show_default=True, help="How long to log, minutes."
)
@json_option
def temperature_log_(config_file: Path | None, path: Path, minutes: float, as_json: bool) -> None:
    """Log the inclinometer of a stationary head while the temperature changes.

    Example: rig calibrate temperature-log --out drift.csv --minutes 240
    """
    from contextlib import closing

    from rig.calibrate.inclinometer.temperature import record_temperature_log
    from rig.config.load import config_path, load_config
    from rig.devices.connect import open_inclinometer

    section = load_config(config_path(config_file)).inclinometer
    with stopping_cleanly(), closing(open_inclinometer(section)) as chip:
        count = record_temperature_log(chip, section, path, 60.0 * minutes)
    click.echo(json.dumps({"file": str(path), "readings": count}) if as_json else f"{path}: {count} readings")


@click.command()
@calibration_run_options
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
def compass(common: CommonOptions, headings: int, angles: int) -> None:
    """Calibrate hard and soft iron of the pan stage, by turning the pan, and of the vehicle, by turning the vehicle.

    \b
    Examples:
      rig calibrate compass
      rig calibrate compass --headings 1
    """
    if common.yes and headings > 1:
        raise click.UsageError("--yes goes with --headings 1 only: somebody has to turn the vehicle.")

    from rig.calibrate.compass.procedure import calibrate_compass

    with common.calibration_run() as calibration_run:
        calibrate_compass(calibration_run, headings, angles)


@click.command()
@calibration_run_options
@at_option
@dem_option
@click.option(
    "--altitude", "altitude_m", type=float, metavar="M", help="Known altitude of the camera, instead of --at."
)
@click.option(
    "--sigma",
    "sigma_m",
    type=FiniteRange(0.1),
    default=1.5,
    show_default=True,
    help="How well it is known, metres.",
)
@click.option("--air", "air_c", type=FiniteRange(-60.0, 60.0), metavar="C", help="Temperature of the air.")
@click.option(
    "--drift",
    "drift_m_h",
    type=FiniteRange(0.0),
    default=4.0,
    show_default=True,
    help="Metres an hour that the weather may move it from then on.",
)
def altimeter(
    common: CommonOptions,
    at: str | None,
    dem_paths: tuple[Path, ...],
    altitude_m: float | None,
    sigma_m: float,
    air_c: float | None,
    drift_m_h: float,
) -> None:
    """Calibrate the reference pressure at a known altitude, or at a known place on a DEM; the altitude's sigma then
    grows with time.

    \b
    Examples:
      rig calibrate altimeter --altitude 812.5 --air 14
      rig calibrate altimeter --at 37.2012,-122.1034 --dem terrain.tif --air 14
    """
    if (altitude_m is None) == (at is None):
        raise click.UsageError("Give either --altitude, or --at with --dem.")

    from rig.calibrate.altimeter import KnownAltitude, calibrate_altimeter

    with common.calibration_run() as calibration_run:
        if at is not None:
            altitude_m = known_place_of(at, dem_paths).ground_m + calibration_run.config.rig.mast_height_m
        assert altitude_m is not None
        calibrate_altimeter(calibration_run, KnownAltitude(altitude_m, sigma_m), air_c, drift_m_h)
