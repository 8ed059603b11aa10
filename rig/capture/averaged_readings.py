"""Averaged sensor readings of a stationary head, with their uncertainty."""

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from typing import Any

import numpy as np

from rig import clock, timebase
from rig.attitude.accelerometer import AccelerometerCorrection
from rig.attitude.altitude import PressureReference, metres_per_hpa, plausible_altitude_m
from rig.attitude.altitude_plausibility import AltitudeBounds, bounds_by_reference, require_plausible_altitude
from rig.attitude.level import HeadLevel, head_level
from rig.config.sections import AltimeterSection, InclinometerSection
from rig.devices.bus.deadline import Deadline
from rig.devices.bus.retry import retry
from rig.devices.connect import Altimeter, Inclinometer, Rig
from rig.devices.pan_tilt import HeadState
from rig.errors import DeviceError
from rig.fault_notes import note_fault

_log = logging.getLogger(__name__)

DRIFT_SIGMAS = 3.0
ALTIMETER_AVERAGE_S = 0.5
MOVED_TICKS = 4
TWO_PRESSURES_HPA = 3.0  # 25 m of altitude, within half a second
MAX_DRIFT_M = 150.0  # from a deep low to a strong high


@dataclass(frozen=True)
class AltitudeReading:
    """Altitude in the datum of the reference, its sigma, and ``raw`` for the bundle."""

    altitude_m: float
    sigma_m: float
    utc: datetime
    raw: dict[str, Any]


@dataclass(frozen=True)
class MeanPressure:
    """Mean and scatter of a number of readings, and the time of the last."""

    device: str
    utc: datetime
    pressure_hpa: float
    pressure_scatter_hpa: float
    temperature_c: float | None
    readings: int
    resolution_hpa: float = 0.0
    """One unit of a talker's last digit: averaging does not remove rounding."""
    source: str = ""


def still_level(rig: Rig, duration_s: float) -> tuple[HeadLevel, float]:
    """Tilt and roll of the head over ``duration_s``, once the mast is still, and since when it is (monotonic).

    A stopped servo does not mean a still mast: the reading must be as steady as the configured sigmas. ``DeviceError``
    if it is not within ``settle_timeout_s``.
    """
    section = rig.config.inclinometer
    deadline = Deadline.after(rig.config.pan_tilt.settle_timeout_s)
    while True:
        last_try = deadline.expired
        begun_s = timebase.monotonic_s()
        whole, early, late = read_level(rig.inclinometer, section, duration_s)
        # Both are needed: a slow swing shows as drift, a fast one as scatter.
        drift_deg = max(abs(late.tilt_deg - early.tilt_deg), abs(late.roll_deg - early.roll_deg))
        noise_deg = max(whole.tilt_noise_deg, whole.roll_noise_deg)
        sigma_deg = max(section.tilt_sigma_deg, section.roll_sigma_deg)
        if drift_deg <= DRIFT_SIGMAS * sigma_deg and noise_deg <= sigma_deg:
            return whole, begun_s
        if last_try:
            raise DeviceError(
                rig.inclinometer.identify(),
                f"the head does not come to rest: it drifts by {drift_deg:.2f} deg, {noise_deg:.3f} deg of noise",
                "stop the engine, shelter it from the wind, or raise [inclinometer] average_s",
            )
        _log.info("the head still swings: %.3f deg of drift, %.3f deg of noise", drift_deg, noise_deg)


def require_stationary(before: HeadState, after: HeadState, what: str) -> None:
    """Raise ``DeviceError`` if the head moved between two states, while ``what``: the reading is invalid."""
    moved_ticks = max(abs(a - b) for a, b in zip(before.ticks, after.ticks, strict=True))
    if moved_ticks > MOVED_TICKS or after.moving:
        raise DeviceError(
            "pan and tilt head", f"moved by {moved_ticks} ticks while {what}", "look for what pushes it"
        )


def read_level(
    inclinometer: Inclinometer, section: InclinometerSection, duration_s: float
) -> tuple[HeadLevel, HeadLevel, HeadLevel]:
    """Averages over ``duration_s``, its first half and its second half."""
    samples = retry(partial(inclinometer.read_many, duration_s))
    middle = (len(samples) + 1) // 2
    device, correction = inclinometer.identify(), AccelerometerCorrection.from_section(section)
    whole, early, late = (
        head_level(s, section.axes, device, correction)
        for s in (samples, samples[:middle], samples[-middle:])
    )
    return whole, early, late


def read_altitude(
    altimeter: Altimeter, section: AltimeterSection, bounds: Sequence[AltitudeBounds] | None = None
) -> AltitudeReading:
    """Altitude from the mean pressure of half a second. ``DeviceError`` outside the bounds or where no ground lies.

    Without bounds those of the reference apply, for a chip with a lookalike.
    """
    mean = read_pressure(altimeter, ALTIMETER_AVERAGE_S)
    read = altitude_from(mean, section)
    known = bounds_by_reference(section) if bounds is None else bounds
    require_plausible_altitude(read.altitude_m, mean.pressure_hpa, section, mean.device, known)
    return read


def read_pressure(altimeter: Altimeter, duration_s: float) -> MeanPressure:
    """Mean over some seconds. ``DeviceError`` if two pressures alternate: their mean is neither."""
    readings = retry(partial(altimeter.read_many, duration_s))
    pressures_hpa = np.array([reading.pressure_hpa for reading in readings])
    two = two_pressures(pressures_hpa.tolist())
    if two:
        raise DeviceError(
            altimeter.identify(),
            f"says {two[0]:.1f} and {two[1]:.1f} hPa in turns, perhaps the pressure here and that of sea level (QNH)",
            "set the instrument to send the pressure at the sensor only",
        )
    return MeanPressure(
        altimeter.identify(),
        readings[-1].utc,
        float(pressures_hpa.mean()),
        float(pressures_hpa.std()),
        readings[-1].temperature_c,
        len(readings),
        min(reading.resolution_hpa for reading in readings),
        readings[-1].source,
    )


def two_pressures(pressures_hpa: Sequence[float]) -> tuple[float, float] | None:
    """The means of two groups further apart than weather and noise explain; None for a single group."""
    ordered = np.sort(np.asarray(pressures_hpa, float))
    if len(ordered) < 2:
        return None
    gaps = np.diff(ordered)
    widest = int(np.argmax(gaps))
    low, high = ordered[: widest + 1], ordered[widest + 1 :]
    within = max(float(np.ptp(low)), float(np.ptp(high)))
    if gaps[widest] < TWO_PRESSURES_HPA or gaps[widest] < 4.0 * within:
        return None
    return float(low.mean()), float(high.mean())


def altitude_from(mean: MeanPressure, section: AltimeterSection) -> AltitudeReading:
    """Altitude from a pressure. ``DeviceError`` if no ground lies that high or low.

    Its sigma grows with the age of the reference, at the configured rate, as the weather changes.
    """
    reference = PressureReference(
        section.reference_pressure_hpa, section.reference_altitude_m, section.reference_temperature_c
    )
    metres = metres_per_hpa(mean.pressure_hpa, reference)
    noise_m = mean.pressure_scatter_hpa / math.sqrt(mean.readings) * metres
    rounding_m = mean.resolution_hpa / math.sqrt(12.0) * metres
    drift_m = 0.0
    if section.reference_time is not None:
        if wrong := clock.problem(mean.utc):
            note_fault(
                mean.device, wrong, "the age of its reference is not known: as unsure as the weather goes"
            )
        hours = abs((mean.utc - section.reference_time).total_seconds()) / 3600.0
        drift_m = min(section.drift_m_h * hours, MAX_DRIFT_M)
    return AltitudeReading(
        plausible_altitude_m(mean.pressure_hpa, reference, mean.device),
        math.hypot(section.sigma_m, noise_m, rounding_m, drift_m),
        mean.utc,
        {
            "device": mean.device,
            "time": utc_text(mean.utc),
            "pressure_hpa": mean.pressure_hpa,
            "pressure_scatter_hpa": mean.pressure_scatter_hpa,
            "temperature_c": mean.temperature_c,
            "readings": mean.readings,
            "resolution_hpa": mean.resolution_hpa,
            "source": mean.source,
        },
    )


def utc_text(time: datetime) -> str:
    """ISO 8601 to the millisecond, with a Z."""
    return time.isoformat(timespec="milliseconds").replace("+00:00", "Z")
