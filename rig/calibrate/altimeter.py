"""Altimeter calibration: the air pressure at a known altitude."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from rig import clock
from rig.attitude.altitude import PressureReference, altitude_m, metres_per_hpa
from rig.calibrate.figures import new_figure
from rig.calibrate.run import CalibrationRun
from rig.config.calibration_files import AltimeterCalibration, CalibrationError
from rig.devices.bus.retry import retry
from rig.devices.connect import open_altimeter
from rig.devices.readings import PressureReading

DURATION_S = 5.0
NOISE_LIMIT_M = 1.0
IMPLAUSIBLE_HPA = 60.0  # difference from the standard atmosphere beyond any weather


@dataclass(frozen=True)
class KnownAltitude:
    """Altitude of the camera above the DEM's datum, and its sigma."""

    altitude_m: float
    sigma_m: float


@dataclass(frozen=True)
class PressureFit:
    """Mean pressure, and the combined sigma of the mean and of the known altitude, as metres."""

    pressure_hpa: float
    sigma_m: float
    noise_m: float


def fit_pressure(readings: Sequence[PressureReading], known: KnownAltitude) -> PressureFit:
    """The reference pressure. ``CalibrationError`` if it drifts or is impossible at that altitude."""
    pressures = np.array([reading.pressure_hpa for reading in readings])
    mean_hpa = float(pressures.mean())
    here = PressureReference(mean_hpa, known.altitude_m)
    metres = metres_per_hpa(mean_hpa, here)
    halves = [part.mean() for part in np.array_split(pressures, 2)] if len(pressures) > 1 else [mean_hpa]
    noise_m = max(
        float(pressures.std()) / math.sqrt(len(pressures)) * metres, float(np.ptp(halves)) / 2.0 * metres
    )
    standard_m = altitude_m(mean_hpa, PressureReference(1013.25, 0.0, 15.0))
    off_hpa = (known.altitude_m - standard_m) / metres
    if abs(off_hpa) > IMPLAUSIBLE_HPA:
        raise CalibrationError(
            f"altimeter: {mean_hpa:.1f} hPa is not the air of {known.altitude_m:.0f} m "
            f"(the standard atmosphere has it at {standard_m:.0f} m); check the place, then the sensor"
        )
    if noise_m > NOISE_LIMIT_M:
        raise CalibrationError(
            f"altimeter: the pressure changed by {noise_m:.1f} m while it was read; close the doors, shelter it from "
            "the wind, and calibrate again"
        )
    rounding_m = min(reading.resolution_hpa for reading in readings) / math.sqrt(12.0) * metres
    return PressureFit(mean_hpa, math.hypot(known.sigma_m, noise_m, rounding_m), noise_m)


def calibrate_altimeter(
    run: CalibrationRun, known: KnownAltitude, air_c: float | None, drift_m_h: float
) -> None:
    """Read, check and write. The altitude's sigma then grows by ``drift_m_h`` an hour.

    ``air_c`` is the air temperature; None uses the standard atmosphere's.
    """
    section = run.config.altimeter
    if section is None:
        raise CalibrationError("altimeter: the configuration has no [altimeter]; add it first")
    run.guide.ready("Stand still with doors and windows closed.")
    altimeter = open_altimeter(section)
    try:
        device = altimeter.identify()
        readings = retry(lambda: altimeter.read_many(DURATION_S))
    finally:
        altimeter.close()
    if wrong := clock.problem(readings[-1].utc):
        raise CalibrationError(
            f"altimeter: {wrong}; set it first, for the time of the reference goes into the calibration"
        )
    fit = fit_pressure(readings, known)
    document = AltimeterCalibration(
        **run.header("altimeter", device),
        altimeter=section.kind,
        reference_pressure_hpa=fit.pressure_hpa,
        reference_altitude_m=known.altitude_m,
        reference_temperature_c=air_c,
        reference_time=readings[-1].utc,
        sigma_m=fit.sigma_m,
        drift_m_h=drift_m_h,
        fit={"readings": len(readings), "noise_m": fit.noise_m},
    )
    before = PressureReference(
        section.reference_pressure_hpa, section.reference_altitude_m, section.reference_temperature_c
    )
    off_m = altitude_m(fit.pressure_hpa, before) - known.altitude_m
    rows = [
        ("pressure, hPa", f"{fit.pressure_hpa:.2f}", f"{fit.noise_m:.2f} m"),
        ("altitude, m", f"{known.altitude_m:.1f}", f"{fit.sigma_m:.1f}"),
        ("drift, m an hour", "", f"{drift_m_h:.1f}"),
        ("the reference so far was off by, m", f"{off_m:.1f}", ""),
    ]
    run.finish(document, rows, draw(readings, fit))


def draw(readings: Sequence[PressureReading], fit: PressureFit) -> Figure:
    """Pressure over time, as metres from its mean."""
    figure, (axes,) = new_figure(f"altimeter: {fit.pressure_hpa:.2f} hPa, {len(readings)} readings", 1)
    metres = metres_per_hpa(fit.pressure_hpa, PressureReference(fit.pressure_hpa, 0.0))
    seconds = [reading.monotonic_s - readings[0].monotonic_s for reading in readings]
    axes.plot(seconds, [-(reading.pressure_hpa - fit.pressure_hpa) * metres for reading in readings], ".")
    axes.axhline(0.0, color="0.5", lw=0.8)
    axes.set_xlabel("s")
    axes.set_ylabel("altitude by this pressure, m from the mean")
    return figure
