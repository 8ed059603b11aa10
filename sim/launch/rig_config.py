"""Writes the rig configuration for the fake devices, as an installer would."""

import json
import math
import socket
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from sim.world.scenario import Scenario
from sim.world.truth import World

METRES_PER_HPA = 8.7
TICK_DEG = 360.0 / 4096.0
ALIGNMENT_DEG = 0.003  # mounting accuracy of camera and chip
USUAL_TEMPERATURE_SPAN_C = 10.0
USUAL_HEIGHT_SPAN_M = 300.0
COLUMN_ERROR_PER_C = 1.0 / 288.0  # of a height difference, for one degree of error in the air's temperature


def toml(sections: Mapping[str, Mapping[str, Any]]) -> str:
    """TOML text of sections of strings, numbers and arrays of these; None leaves a key out."""
    lines: list[str] = []
    for name, section in sections.items():
        lines.append(f"[{name}]")
        lines += [f"{key} = {json.dumps(value)}" for key, value in section.items() if value is not None]
        lines.append("")
    return "\n".join(lines)


def rig_config(
    world: World,
    *,
    pan_tilt: Mapping[str, Any],
    joints: Mapping[str, Mapping[str, Any]],
    inclinometer: Mapping[str, Any],
    compass: Mapping[str, Any],
    altimeter: Mapping[str, Any],
    camera_source: str,
    camera_exposure_url: str | None,
    bundle_dir: Path,
    calibration: Mapping[str, str],
    run: Mapping[str, Mapping[str, Any]],
) -> str:
    """The whole configuration, as TOML.

    Device keys come from the caller; what an installer measures or estimates (lens, sigmas, reference pressure) comes
    from the world. The truth is not revealed: the place is rounded to half a degree, sufficient for a declination only.
    """
    scenario, camera = world.scenario, world.scenario.camera
    return toml(
        {
            "rig": {
                "name": f"simulated-{world.seed}",
                "mast_height_m": scenario.vehicle.mast_height_m,
                "bundle_dir": str(bundle_dir),
            },
            "place": {
                "lat_deg": round(world.place.lat_deg * 2) / 2,
                "lon_deg": round(world.place.lon_deg * 2) / 2,
                "altitude_m": world.reference.altitude_m,
            },
            "pan_tilt": {**pan_tilt, "azimuth_sigma_deg": round(_azimuth_sigma_deg(scenario), 4)},
            **{f"pan_tilt.{name}": keys for name, keys in joints.items()},
            "inclinometer": {
                **inclinometer,
                "tilt_sigma_deg": 0.01,
                "roll_sigma_deg": round(_zero_sigma_deg(scenario), 4),
                "tilt_bias_sigma_deg": round(_zero_sigma_deg(scenario), 4),
            },
            "compass": {**compass, "azimuth_bias_sigma_deg": round(_compass_sigma_deg(world), 2)},
            "altimeter": {
                **altimeter,
                "reference_pressure_hpa": round(world.reference.pressure_hpa, 2),
                "reference_altitude_m": world.reference.altitude_m,
                "reference_temperature_c": round(world.reference.temperature_c, 1),
                "sigma_m": round(_altitude_sigma_m(scenario), 1),
            },
            "camera": {
                "source": camera_source,
                "exposure_url": camera_exposure_url,
                "width_px": camera.width_px,
                "height_px": camera.height_px,
                "boresight_tilt_sigma_deg": scenario.boresight.tilt_sigma_deg,
                "boresight_roll_sigma_deg": scenario.boresight.roll_sigma_deg,
                **_configured_intrinsics(world),
            },
            "calibration": calibration,
            **run,
        }
    )


def run_tables(dem_paths: Sequence[Path], spool_dir: Path) -> dict[str, dict[str, Any]]:
    """``[run]`` for a daemon on this computer: captures on request only, all publishers on ports that are free now."""
    ports = iter(_free_ports(3))
    return {
        "run": {"dem": [str(path.absolute()) for path in dem_paths]},
        "run.spool": {"dir": str(spool_dir)},
        "run.odometry": {"listen": f"127.0.0.1:{next(ports)}"},
        "run.nmea": {"tcp": f"127.0.0.1:{next(ports)}"},
        "run.http": {"listen": f"127.0.0.1:{next(ports)}"},
    }


def _free_ports(count: int) -> list[int]:
    """Different free ports of the loopback interface, TCP and UDP."""
    ports: list[int] = []
    with ExitStack() as open_sockets:
        while len(ports) < count:
            tcp = open_sockets.enter_context(socket.socket(socket.AF_INET, socket.SOCK_STREAM))
            udp = open_sockets.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            tcp.bind(("127.0.0.1", 0))
            try:
                udp.bind(tcp.getsockname())
            except OSError:
                continue
            ports.append(tcp.getsockname()[1])
    return ports


def _configured_intrinsics(world: World) -> dict[str, Any]:
    """The configured intrinsics: from the maker or a calibration, with the errors of the scenario."""
    camera, biases = world.scenario.camera, world.biases
    return {
        "fx_px": camera.fx_px * biases.told_focal[0],
        "fy_px": camera.fy_px * biases.told_focal[1],
        "cx_px": camera.cx_px + biases.told_centre_px[0],
        "cy_px": camera.cy_px + biases.told_centre_px[1],
        "distortion": [0.0] * 5 if camera.told_without_distortion else list(camera.distortion),
    }


def _azimuth_sigma_deg(scenario: Scenario) -> float:
    """Sigma between frames: quantisation, backlash, settling."""
    servo = scenario.servo
    return math.hypot(TICK_DEG / math.sqrt(12), servo.backlash_deg / 2, servo.settle_sigma_deg)


def _zero_sigma_deg(scenario: Scenario) -> float:
    """Sigma of the accelerometer's zero: zero error, drift over the usual temperature span, and mounting."""
    chip = scenario.inclinometer
    drift_mg = chip.temperature_drift_sigma_mg_c * USUAL_TEMPERATURE_SPAN_C
    zero_deg = math.degrees(math.hypot(chip.zero_offset_sigma_mg, drift_mg) / 1000)
    return math.hypot(zero_deg, chip.mounting_sigma_deg, scenario.servo.zero_sigma_deg, ALIGNMENT_DEG)


def _compass_sigma_deg(world: World) -> float:
    """Sigma of the heading: declination anomaly, and hard-iron calibration error as an angle in the horizontal field.

    A level error adds part of the vertical field; the mount's azimuth error is included, and the sum rounded up
    slightly, as a careful installer does.
    """
    compass = world.scenario.compass
    horizontal_ut = math.hypot(*world.field.enu_ut[:2])
    iron_deg = math.degrees(compass.hard_iron_calibration_sigma_ut / horizontal_ut)
    vehicle_deg = math.degrees(compass.vehicle_hard_iron_sigma_ut / horizontal_ut)
    soft_deg = math.degrees(math.hypot(compass.soft_iron_sigma, compass.vehicle_soft_iron_sigma))
    iron_deg = math.hypot(iron_deg, vehicle_deg, soft_deg)
    mount_deg = math.hypot(world.scenario.boresight.azimuth_sigma_deg, world.scenario.servo.zero_sigma_deg)
    noise_deg = 0.0 if compass.kind == "mmc5983ma" else compass.talker_noise_deg
    return 1.2 * math.hypot(compass.declination_anomaly_sigma_deg, iron_deg, mount_deg, noise_deg, 0.1)


def _altitude_sigma_m(scenario: Scenario) -> float:
    """Sigma of the altitude: barometer, reference, weather since then, and air temperature between reference and rig."""
    altimeter = scenario.altimeter
    weather_hpa = altimeter.weather_drift_sigma_hpa_h * altimeter.reference_age_h
    pressure_m = METRES_PER_HPA * math.hypot(
        altimeter.bias_sigma_hpa, altimeter.reference_sigma_hpa, altimeter.noise_hpa, weather_hpa
    )
    column_m = altimeter.reference_temperature_sigma_c * COLUMN_ERROR_PER_C * USUAL_HEIGHT_SPAN_M
    return math.hypot(pressure_m, column_m, 0.5)
