"""Recomputes a bundle from its raw readings with better calibrations. The original stays as it is."""

import json
from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from localizer.bundle import Altitude, Bundle, Frame, frame_image, load_bundle
from rig.attitude.accelerometer import AccelerometerCorrection
from rig.attitude.kinematics import JointAngles
from rig.attitude.level import HeadLevel, tilt_roll_deg
from rig.bundle.writer import Measurement, require_writable, write_bundle
from rig.capture import derive
from rig.capture.averaged_readings import MeanPressure, altitude_from
from rig.capture.base_attitude import MeanField, Stop, estimate_base
from rig.config.calibration_files import AppliedCalibration, CalibrationError, parse_calibration
from rig.config.model import RigConfig, with_calibrations
from rig.config.sections import InclinometerSection
from rig.devices.readings import HeadingReading

JsonObject = dict[str, Any]


def recalibrate(directory: Path, calibrations: Sequence[AppliedCalibration], out_dir: Path) -> Path:
    """Write a new bundle into ``out_dir``, complete or absent, and return its directory.

    What ``calibrations`` do not replace keeps the bundle's values. ``BundleError`` if the bundle cannot be read,
    ``CalibrationError`` if it holds no raw readings or a calibration is for another rig.
    """
    require_writable(out_dir)
    bundle = load_bundle(directory)
    try:
        measurement = _measurement(bundle, with_calibrations(recorded_config(bundle), calibrations))
    except (KeyError, TypeError, IndexError, AttributeError, ValueError, ArithmeticError) as error:
        raise CalibrationError(
            f"{directory}: its raw readings are not all there ({error}); only bundles of rig capture can be recalibrated"
        ) from error
    return write_bundle(out_dir, measurement)


def recorded_config(bundle: Bundle) -> RigConfig:
    """The configuration of the capture, calibrations included. ``CalibrationError`` if the bundle has none."""
    calibration = (bundle.model_extra or {}).get("calibration")
    if not isinstance(calibration, dict) or "configuration" not in calibration:
        raise CalibrationError(
            f"{bundle.directory}: says nothing of its configuration; only bundles of rig capture can be recalibrated"
        )
    tables = dict(calibration["configuration"])
    pan = tables["pan_tilt"]["pan"]
    # The directions are in the readings; the configuration only has to be valid.
    angles_deg = [pan["min_deg"], (pan["min_deg"] + pan["max_deg"]) / 2.0, pan["max_deg"]]
    tables["capture"] = {"base_attitude_pan_angles_deg": angles_deg}
    tables["camera"] = {**tables["camera"], "source": "recorded"}
    try:
        config = RigConfig.model_validate(tables)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(str(part) for part in first["loc"])
        raise CalibrationError(
            f"{bundle.directory}: calibration.configuration.{where}: {first['msg']}"
        ) from error
    return with_calibrations(config, recorded_calibrations(calibration.get("files", {})))


def recorded_calibrations(files: JsonObject) -> list[AppliedCalibration]:
    """The calibrations that were in force at the capture."""
    return [
        AppliedCalibration(
            parse_calibration(json.dumps(record["content"]), record["file"]), record["file"], record["sha256"]
        )
        for record in files.values()
    ]


def _measurement(bundle: Bundle, config: RigConfig) -> Measurement:
    extra = bundle.model_extra or {}
    raw: JsonObject = extra["raw"]
    shots = [_shot_of(bundle, frame, config) for frame in bundle.frames]
    stops = [_stop(record, config) for record in raw["stops"]]
    base_estimate = estimate_base(config, stops, raw["compass"], [shot.stop for shot in shots])
    altitude = None
    if raw["altimeter"] is not None and config.altimeter is not None:
        read = altitude_from(_pressure(raw["altimeter"]), config.altimeter)
        altitude = Altitude(value_m=read.altitude_m, sigma_m=read.sigma_m)
    return Measurement(
        created=bundle.created,
        camera=derive.bundle_camera(config),
        mast_height_m=bundle.mast_height_m,
        altitude=altitude,
        azimuth_bias_sigma_deg=derive.azimuth_bias_sigma_deg(config, base_estimate),
        tilt_bias_sigma_deg=derive.tilt_bias_sigma_deg(config, base_estimate),
        frames=[derive.frame_record(config, base_estimate, shot) for shot in shots],
        raw={**raw, "recalibrated_from": bundle.id},
        calibration=derive.calibration_record(config, base_estimate),
    )


def _shot_of(bundle: Bundle, frame: Frame, config: RigConfig) -> derive.Shot:
    raw: JsonObject = (frame.model_extra or {})["raw"]
    after = _joints(raw["ticks"], config)
    before = _joints(raw["ticks_before"] if "ticks_before" in raw else raw["ticks"], config)
    joints = JointAngles((before.pan_deg + after.pan_deg) / 2.0, (before.tilt_deg + after.tilt_deg) / 2.0)
    stop = _read_at(raw, joints, frame.time, config)
    return derive.Shot(frame.label, frame_image(bundle, frame), frame.time, stop, raw)


def _stop(record: JsonObject, config: RigConfig) -> Stop:
    return _read_at(record, _joints(record["ticks"], config), datetime.fromisoformat(record["time"]), config)


def _read_at(record: JsonObject, joints: JointAngles, time: datetime, config: RigConfig) -> Stop:
    """The readings at a stop or at a picture. Old bundles have no compass reading in the latter."""
    field = None
    if "field_ut" in record:
        field = MeanField(
            _triple(record["field_ut"]),
            _triple(record["field_scatter_ut"]),
            record["field_readings"],
            record["compass_temperature_c"],
        )
    headings = tuple(
        HeadingReading(
            h["heading_deg"],
            h["reference"],
            h["variation_deg"],
            None,
            None,
            0.0,
            time,
            **{key: h[key] for key in ("source", "deviation_deg", "resolution_deg", "estimated") if key in h},
        )
        for h in record.get("headings", [])
    )
    level = _level(record["inclinometer"], config.inclinometer)
    pan, tilt = record["ticks"]
    return Stop((pan, tilt), joints, level, field, headings, time)


def _level(record: JsonObject, section: InclinometerSection) -> HeadLevel:
    """The head's level from the recorded uncorrected average, with today's correction."""
    level = HeadLevel(**{**record, "mean_g": _triple(record["mean_g"])})
    measured = np.array([level.mean_g])
    if section.chip == "iis2iclx":  # its z was what is left of 1 g
        measured[0, 2] = np.nan
    warm_c = np.nan if level.temperature_c is None else level.temperature_c
    up = AccelerometerCorrection.from_section(section).up_in_head(measured, warm_c)
    tilt_deg, roll_deg = tilt_roll_deg(up)
    return replace(level, tilt_deg=float(tilt_deg[0]), roll_deg=float(roll_deg[0]))


def _pressure(record: JsonObject) -> MeanPressure:
    return MeanPressure(
        record["device"],
        datetime.fromisoformat(record["time"]),
        record["pressure_hpa"],
        record["pressure_scatter_hpa"],
        record["temperature_c"],
        record["readings"],
        record.get("resolution_hpa", 0.0),
        record.get("source", ""),
    )


def _joints(ticks: Sequence[int], config: RigConfig) -> JointAngles:
    pan, tilt = config.pan_tilt.pan, config.pan_tilt.tilt
    return JointAngles(pan.angle_deg(ticks[0]), tilt.angle_deg(ticks[1]))


def _triple(values: Sequence[float]) -> tuple[float, float, float]:
    x, y, z = values
    return x, y, z
