"""How the vehicle stands: level and heading of the base, measured by turning the head to several pan angles."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from localizer.observation import NO_COMPASS_SIGMA_DEG
from rig.attitude import BaseLevel, HeadLevel, LevelReading, LevelSigmas, base_level, in_axes
from rig.bus.retry import retry
from rig.config import CompassSection, Mmc5983maSection, NmeaCompassSection, Place
from rig.connect import Rig
from rig.declination import Declination, declination
from rig.heading import (
    FieldAtPan,
    HeadingsAtPan,
    TrueHeading,
    heading_from_field,
    heading_from_talker,
    true_heading,
)
from rig.kinematics import Attitude, JointAngles
from rig.measure import still_level, utc_text
from rig.pan_tilt import HeadState
from rig.readings import FieldReading, HeadingReading

READING_SHARE = 0.4  # of average_s at each pan angle: there are several of them
NO_COMPASS = TrueHeading(0.0, NO_COMPASS_SIGMA_DEG, None)


@dataclass(frozen=True)
class Standing:
    """Attitude of the base and what is known about its errors; ``raw`` and ``calibration`` for the bundle."""

    attitude: Attitude
    level: BaseLevel
    heading: TrueHeading
    raw: dict[str, Any]
    calibration: dict[str, Any]


@dataclass(frozen=True)
class Stop:
    """What was read at one pan angle; fields or headings, as the compass gives the one or the other."""

    state: HeadState
    level: HeadLevel
    fields: tuple[FieldReading, ...]
    headings: tuple[HeadingReading, ...]
    utc: datetime


def measure_standing(rig: Rig) -> Standing:
    """Turn the head through the configured pan angles, at tilt 0, and read inclinometer and compass at each.

    Without a compass the heading is 0 with a sigma of 180: azimuths then count from the vehicle's bow.
    """
    config = rig.config
    stops = [_stop(rig, pan_deg) for pan_deg in _in_passing(rig)]
    sigmas = LevelSigmas(
        config.inclinometer.tilt_sigma_deg,
        config.inclinometer.roll_sigma_deg,
        config.inclinometer.tilt_bias_sigma_deg,
        config.pan_tilt.azimuth_sigma_deg,
    )
    level = base_level([LevelReading(_joints(stop), stop.level) for stop in stops], sigmas)
    heading: TrueHeading = NO_COMPASS
    details: dict[str, Any] | None = None
    if config.compass:
        heading, details = base_heading(config.compass, config.place, stops, level)
    return Standing(
        level.attitude(heading.heading_deg),
        level,
        heading,
        {"compass": rig.compass.identify() if rig.compass else None, "stops": [_record(s) for s in stops]},
        {"level": asdict(level), "heading": asdict(heading), "compass": details},
    )


def base_heading(
    section: CompassSection, place: Place | None, stops: Sequence[Stop], level: BaseLevel
) -> tuple[TrueHeading, dict[str, Any]]:
    """True heading of the base from what a compass read at the stops, and details for the record.

    ``ConfigError`` where it gives magnetic headings and there is no declination.
    """
    if isinstance(section, Mmc5983maSection):
        fields = [FieldAtPan(stop.state.pan_deg, _stage_fields_ut(stop, section)) for stop in stops]
        measured = heading_from_field(fields, level)
        to_true = declination(section.declination_deg, None, place, stops[0].utc)
        return true_heading(measured, section.azimuth_bias_sigma_deg, to_true), asdict(measured)
    headings, to_true_used = [], None
    for stop in stops:
        true_deg = []
        for reading in stop.headings:
            used = _talkers_declination(reading, section, place)
            true_deg.append(reading.heading_deg + (used.declination_deg if used else 0.0))
            to_true_used = used or to_true_used
        headings.append(HeadingsAtPan(stop.state.pan_deg, tuple(true_deg)))
    spoken = heading_from_talker(headings, level)
    # The readings are true already: a talker may send both kinds, and its own variation with each.
    return replace(
        true_heading(spoken, section.azimuth_bias_sigma_deg, None), declination=to_true_used
    ), asdict(spoken)


def _talkers_declination(
    reading: HeadingReading, section: NmeaCompassSection, place: Place | None
) -> Declination | None:
    if reading.reference == "true":
        return None
    return declination(section.declination_deg, reading.variation_deg, place, reading.utc)


def _stage_fields_ut(stop: Stop, section: Mmc5983maSection) -> NDArray[np.float64]:
    """The field (n, 3) in axes of the pan stage, without its calibrated hard iron."""
    chip = np.array([[reading.x_ut, reading.y_ut, reading.z_ut] for reading in stop.fields])
    return np.asarray(in_axes(chip, section.axes) - np.array(section.hard_iron_ut))


def _stop(rig: Rig, pan_deg: float) -> Stop:
    duration_s = rig.config.inclinometer.average_s * READING_SHARE
    rig.pan_tilt.move_to(pan_deg, 0.0)
    state = rig.pan_tilt.wait_settled()
    levelling = rig.readers.submit(still_level, rig, duration_s)
    readings = retry(partial(rig.compass.read_many, duration_s)) if rig.compass else ()
    level, _ = levelling.result()
    fields = tuple(reading for reading in readings if isinstance(reading, FieldReading))
    headings = tuple(reading for reading in readings if isinstance(reading, HeadingReading))
    return Stop(state, level, fields, headings, datetime.now(UTC))


def _in_passing(rig: Rig) -> list[float]:
    """The configured pan angles in one sweep, from the end that is nearer."""
    angles_deg = sorted(rig.config.capture.base_attitude_pan_angles_deg)
    here_deg = rig.pan_tilt.state().pan_deg
    return angles_deg if abs(here_deg - angles_deg[0]) <= abs(here_deg - angles_deg[-1]) else angles_deg[::-1]


def _joints(stop: Stop) -> JointAngles:
    return JointAngles(stop.state.pan_deg, stop.state.tilt_deg)


def _record(stop: Stop) -> dict[str, Any]:
    """A stop as JSON values: the head's average in head axes, the compass's in its own."""
    record: dict[str, Any] = {
        "time": utc_text(stop.utc),
        "ticks": list(stop.state.ticks),
        "inclinometer": asdict(stop.level),
    }
    if stop.fields:
        chip_ut = np.array([[reading.x_ut, reading.y_ut, reading.z_ut] for reading in stop.fields])
        record["field_ut"] = chip_ut.mean(axis=0).tolist()
        record["field_scatter_ut"] = chip_ut.std(axis=0).tolist()
        record["field_readings"] = len(chip_ut)
        record["compass_temperature_c"] = stop.fields[-1].temperature_c
    if stop.headings:
        record["headings"] = [
            {"heading_deg": r.heading_deg, "reference": r.reference, "variation_deg": r.variation_deg}
            for r in stop.headings
        ]
    return record
