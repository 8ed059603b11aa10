"""Base attitude: level and heading of the vehicle, measured by turning the head to several pan angles.

The compass is also read at each picture: the pan encoder's error there is common to heading and picture azimuth and
cancels in their sum.
"""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from datetime import datetime
from functools import partial
from typing import Any

import numpy as np

from localizer.observation import NO_COMPASS_SIGMA_DEG
from rig.attitude.declination import declination
from rig.attitude.heading import (
    FieldAtPan,
    TrueHeading,
    VehicleIron,
    heading_from_field,
    heading_from_talker,
    true_heading,
)
from rig.attitude.kinematics import Attitude, JointAngles
from rig.attitude.level import BaseLevel, HeadLevel, LevelReading, LevelSigmas, base_level, in_axes
from rig.attitude.talker_headings import true_headings
from rig.attitude.tilt_agreement import require_agreement
from rig.capture.averaged_readings import require_stationary, still_level, utc_text
from rig.clock import utc_now
from rig.config.model import RigConfig
from rig.config.sections import CompassSection, Mmc5983maSection, Place
from rig.devices.bus.retry import retry
from rig.devices.connect import Rig
from rig.devices.pan_tilt import HeadState
from rig.devices.readings import FieldReading, HeadingReading
from rig.errors import ConfigError, DeviceError, GoalError
from rig.fault_notes import note_fault

CompassReading = FieldReading | HeadingReading

READING_SHARE = 0.4  # of average_s at each pan angle: there are several of them
CHECK_TILT_DEG, CHECK_READING_S = 10.0, 0.2
TWO_AXES = ("iis2iclx",)
NO_COMPASS = TrueHeading(0.0, NO_COMPASS_SIGMA_DEG, None)
HEADING_OF_STOPS = "heading from the stops before it"
DISTURBED_DEG, DISTURBED_FACTOR = 2.0, 3.0
"""Readings that fit together worse than this, and worse by this factor than those of the stops alone, were disturbed
later.
"""


@dataclass(frozen=True)
class MeanField:
    """Field in the magnetometer's own axes (3,), uT: mean, scatter and number of readings."""

    mean_ut: tuple[float, float, float]
    scatter_ut: tuple[float, float, float]
    readings: int
    temperature_c: float | None


@dataclass(frozen=True)
class Stop:
    """Readings at one pan angle; a field or headings, depending on the compass."""

    ticks: tuple[int, int]
    joints: JointAngles
    level: HeadLevel
    field: MeanField | None
    headings: tuple[HeadingReading, ...]
    utc: datetime

    @property
    def has_compass(self) -> bool:
        """Whether the compass was read here."""
        return self.field is not None or bool(self.headings)


@dataclass(frozen=True)
class BaseEstimate:
    """Attitude of the base with its uncertainty; ``raw`` and ``calibration`` for the bundle."""

    attitude: Attitude
    level: BaseLevel
    heading: TrueHeading
    raw: dict[str, Any]
    calibration: dict[str, Any]
    stops: tuple[Stop, ...]
    """The stops, before any picture, from which level and heading were estimated."""


def measure_base(rig: Rig) -> BaseEstimate:
    """Move to the configured pan angles at tilt 0 and read inclinometer and compass at each."""
    duration_s = rig.config.inclinometer.average_s * READING_SHARE
    pans_deg = _pans_in_sweep_order(rig)
    tilted = _read_tilted_level(rig, pans_deg[0]) if rig.config.inclinometer.chip in TWO_AXES else None
    stops = [read_stop(rig, JointAngles(pan_deg, 0.0), duration_s) for pan_deg in pans_deg]
    base_estimate = estimate_base(rig.config, stops, rig.compass.identify() if rig.compass else None)
    if tilted:
        measured_deg = tilted.level.tilt_deg - base_estimate.level.tilt_zero_deg
        require_agreement(base_estimate.attitude, tilted.joints, measured_deg, rig.inclinometer.identify())
    return base_estimate


def _read_tilted_level(rig: Rig, pan_deg: float) -> LevelReading | None:
    """A level reading at another tilt, which reveals a wrong scale of a two-axis chip.

    None if limits and keep-out zones leave no room.
    """
    tilt = rig.config.pan_tilt.tilt
    for tilt_deg in (min(CHECK_TILT_DEG, tilt.max_deg), max(-CHECK_TILT_DEG, tilt.min_deg)):
        try:
            state = rig.pan_tilt.go_to(pan_deg, tilt_deg)
        except GoalError:
            continue
        level, _ = still_level(rig, CHECK_READING_S)
        return LevelReading(JointAngles(state.pan_deg, state.tilt_deg), level)
    return None


def estimate_base(
    config: RigConfig, stops: Sequence[Stop], compass: str | None, views: Sequence[Stop] = ()
) -> BaseEstimate:
    """Estimate the base attitude: level from the ``stops``, heading from them and from the ``views`` (at the pictures).

    ``compass`` is the device's identity, for the bundle. A view without a compass reading adds nothing to the heading.
    Without a compass the heading is 0 with a sigma of 180: azimuths are then relative to the vehicle's bow.
    """
    sigmas = LevelSigmas(
        config.inclinometer.tilt_sigma_deg,
        config.inclinometer.roll_sigma_deg,
        config.inclinometer.tilt_bias_sigma_deg,
        config.pan_tilt.azimuth_sigma_deg,
    )
    level = base_level([LevelReading(stop.joints, stop.level) for stop in stops], sigmas)
    heading: TrueHeading = NO_COMPASS
    details: dict[str, Any] | None = None
    if config.compass:
        found, details = _heading_with_views(config.compass, config.place, stops, views, level)
        corrected_deg = (found.heading_deg + config.compass.heading_offset_deg) % 360.0
        heading = replace(found, heading_deg=corrected_deg)
    return BaseEstimate(
        level.attitude(heading.heading_deg),
        level,
        heading,
        {"compass": compass, "stops": [stop_record(stop) for stop in stops]},
        {
            "level": asdict(level),
            "heading": asdict(heading)
            | {"declination": heading.declination.record() if heading.declination else None},
            "compass": details,
        },
        tuple(stops),
    )


def _heading_with_views(
    section: CompassSection,
    place: Place | None,
    stops: Sequence[Stop],
    views: Sequence[Stop],
    level: BaseLevel,
) -> tuple[TrueHeading, dict[str, Any]]:
    """``base_heading`` from all readings; from the stops alone, with a note, if the views' readings are implausible.

    The stops suffice for a capture, so bad readings at the views must not spoil it.
    """
    alone = base_heading(section, place, stops, level)
    read = [view for view in views if view.has_compass]
    if not read:
        return alone
    try:
        together = base_heading(section, place, [*stops, *read], level)
    except (DeviceError, ConfigError) as error:
        problem = error.problem if isinstance(error, DeviceError) else str(error)
        note_fault("compass", problem, HEADING_OF_STOPS)
        return alone
    if together[1]["misfit_deg"] > max(DISTURBED_DEG, DISTURBED_FACTOR * alone[1]["misfit_deg"]):
        note_fault("compass", "was disturbed while pictures were taken", HEADING_OF_STOPS)
        return alone
    return together


def base_heading(
    section: CompassSection, place: Place | None, stops: Sequence[Stop], level: BaseLevel
) -> tuple[TrueHeading, dict[str, Any]]:
    """True heading of the base from compass readings at the stops, and details for the bundle.

    ``ConfigError`` for magnetic headings without a declination.
    """
    if isinstance(section, Mmc5983maSection):
        fields = [
            stage_field(stop.joints.pan_deg, stop.field, section) for stop in stops if stop.field is not None
        ]
        vehicle = VehicleIron(section.vehicle_hard_iron_ut, section.vehicle_soft_iron)
        measured = heading_from_field(fields, level, vehicle)
        to_true = declination(section.declination_deg, None, place, stops[0].utc)
        to_true.note()
        trusted_deg = math.hypot(section.azimuth_bias_sigma_deg, to_true.sigma_deg)
        return true_heading(measured, trusted_deg, to_true), asdict(measured)
    true_readings = true_headings([stop for stop in stops if stop.headings], section, place)
    compass_heading = heading_from_talker(true_readings.at_pans, level)
    # The readings are already true headings: a talker may send both kinds, each with its own variation.
    trusted_deg = math.hypot(section.azimuth_bias_sigma_deg, true_readings.sigma_deg)
    return replace(
        true_heading(compass_heading, trusted_deg, None), declination=true_readings.declination
    ), asdict(compass_heading)


def stage_field(pan_deg: float, field: MeanField, section: Mmc5983maSection) -> FieldAtPan:
    """The field in axes of the pan stage, corrected for the stage's calibrated iron."""
    stage_ut = in_axes(np.array([field.mean_ut]), section.axes)[0] - np.array(section.hard_iron_ut)
    noise_ut = max(field.scatter_ut) / math.sqrt(field.readings)
    return FieldAtPan(pan_deg, np.linalg.solve(np.array(section.soft_iron), stage_ut), noise_ut)


def read_stop(rig: Rig, joints: JointAngles, duration_s: float) -> Stop:
    """Move there, wait until the head is still, and read inclinometer and compass for a time."""
    state = rig.pan_tilt.go_to(joints.pan_deg, joints.tilt_deg)
    stop = read_here(rig, state, duration_s)
    require_stationary(state, rig.pan_tilt.state(), "level and heading were read")
    return stop


def read_here(rig: Rig, state: HeadState, duration_s: float) -> Stop:
    """Read inclinometer and compass at the present position for a time."""
    levelling = rig.readers.submit(still_level, rig, duration_s)
    readings: Sequence[CompassReading] = ()
    if rig.compass:
        readings = retry(partial(rig.compass.read_many, duration_s))
    level, _ = levelling.result()
    return stop_of(state.ticks, JointAngles(state.pan_deg, state.tilt_deg), level, readings)


def read_compass_during_picture(rig: Rig, duration_s: float) -> Sequence[CompassReading]:
    """Compass readings while a picture is taken; none, with a note, if it fails.

    Retried only while the inclinometer is read: pictures do not wait for the compass.
    """
    if rig.compass is None:
        return ()
    try:
        return retry(partial(rig.compass.read_many, duration_s), within_s=duration_s, replug_s=0.0)
    except DeviceError as error:
        note_fault(error.device, error.problem, HEADING_OF_STOPS)
        return ()


def stop_of(
    ticks: tuple[int, int], joints: JointAngles, level: HeadLevel, readings: Sequence[CompassReading]
) -> Stop:
    """A stop from an inclinometer reading and the readings of the compass, if any."""
    return Stop(
        ticks,
        joints,
        level,
        mean_field([reading for reading in readings if isinstance(reading, FieldReading)]),
        tuple(reading for reading in readings if isinstance(reading, HeadingReading)),
        utc_now(),
    )


def mean_field(readings: Sequence[FieldReading]) -> MeanField | None:
    """Mean and scatter of magnetometer readings; None of none."""
    if not readings:
        return None
    chip_ut = np.array([[reading.x_ut, reading.y_ut, reading.z_ut] for reading in readings])
    mean_ut, scatter_ut = chip_ut.mean(axis=0).tolist(), chip_ut.std(axis=0).tolist()
    return MeanField(tuple(mean_ut), tuple(scatter_ut), len(readings), readings[-1].temperature_c)


def _pans_in_sweep_order(rig: Rig) -> list[float]:
    """The configured pan angles ordered for one sweep, starting at the nearer end."""
    angles_deg = sorted(rig.config.capture.base_attitude_pan_angles_deg)
    here_deg = rig.pan_tilt.state().pan_deg
    return angles_deg if abs(here_deg - angles_deg[0]) <= abs(here_deg - angles_deg[-1]) else angles_deg[::-1]


def stop_record(stop: Stop) -> dict[str, Any]:
    """A stop as JSON values: the head's average in head axes, the compass's in its own."""
    return {
        "time": utc_text(stop.utc),
        "ticks": list(stop.ticks),
        "inclinometer": asdict(stop.level),
        **compass_record(stop),
    }


def compass_record(stop: Stop) -> dict[str, Any]:
    """Compass readings at a stop or at a picture, as JSON values; empty if it was not read."""
    record: dict[str, Any] = {}
    if stop.field:
        record["field_ut"] = list(stop.field.mean_ut)
        record["field_scatter_ut"] = list(stop.field.scatter_ut)
        record["field_readings"] = stop.field.readings
        record["compass_temperature_c"] = stop.field.temperature_c
    if stop.headings:
        record["headings"] = [
            {
                "heading_deg": r.heading_deg,
                "reference": r.reference,
                "variation_deg": r.variation_deg,
                "source": r.source,
                "deviation_deg": r.deviation_deg,
                "resolution_deg": r.resolution_deg,
                "estimated": r.estimated,
            }
            for r in stop.headings
        ]
    return record
