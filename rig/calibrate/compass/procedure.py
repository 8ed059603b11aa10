"""Compass calibration: turn the pan at several vehicle headings, compare with torque on and off, fit, show."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from rig import clock
from rig.attitude.kinematics import JointAngles
from rig.attitude.level import LevelReading, LevelSigmas, base_level, in_axes
from rig.attitude.magnetic_model import ModelField, model_field
from rig.calibrate.compass.earth_field import dip_deg
from rig.calibrate.compass.fit import CompassFit, fit_compass
from rig.calibrate.compass.model import EarthField, VehicleStop
from rig.calibrate.compass.torque import TorqueField, read_with_torque_on_and_off, torque_field
from rig.calibrate.figures import new_figure
from rig.calibrate.run import CalibrationRun
from rig.capture.base_attitude import Stop, read_stop
from rig.config.calibration_files import CalibrationError, CompassCalibration
from rig.config.model import RigConfig
from rig.config.sections import Mmc5983maSection
from rig.devices.connect import Rig, connect

Vector = NDArray[np.float64]

READING_S = 0.6
FROM_LIMIT_DEG = 4.0
TORQUE_LIMIT_DEG = 3.0


def calibrate_compass(run: CalibrationRun, headings: int, angles: int) -> None:
    """Guide the operator, measure, fit and write. ``CalibrationError`` says why a result is rejected."""
    config, guide = run.config, run.guide
    section, model = _section(config), _model(config)
    guide.ready(
        "Drive to open ground, 20 m from vehicles, fences and power lines; keep iron and phones away from the mast."
    )
    vehicle_stops, held_and_free = [], []
    with connect(config) as rig:
        assert rig.compass is not None
        device = rig.compass.identify()
        for number in range(1, headings + 1):
            if number > 1:
                turn = f"turn the vehicle by about {360.0 / headings:.0f} deg to the right and stop."
                guide.ready(f"Heading {number} of {headings}: {turn}")
            pans_deg = _pan_angles(rig, angles)
            let_go_at = _spread(angles) if number == headings else ()
            stops = []
            for index, pan_deg in enumerate(pans_deg):
                stops.append(read_stop(rig, JointAngles(pan_deg, 0.0), READING_S))
                if index in let_go_at:
                    held_and_free.append(read_with_torque_on_and_off(rig, stops[-1], section, READING_S))
            vehicle_stops.append(vehicle_stop(config, section, stops))
            guide.say(f"heading {number} of {headings}: read at {len(stops)} pan angles")
    earth = EarthField(model.horizontal_ut, model.down_ut, model.declination_sigma_deg)
    fit = fit_compass(vehicle_stops, earth)
    torque = torque_field(
        held_and_free,
        fit.iron.stage_hard_ut,
        earth.horizontal_ut,
        len(config.capture.base_attitude_pan_angles_deg),
    )
    for warning in [*fit.warnings, *_torque_warnings(torque)]:
        guide.say(f"warning: {warning}")
    sigma_deg = float(np.hypot(fit.heading_sigma_deg, torque.varying_deg))
    iron, field = fit.iron, fit.field
    document = CompassCalibration(
        **run.header("compass", device),
        compass=section.kind,
        axes=section.axes,
        hard_iron_ut=iron.stage_hard_ut,
        soft_iron=iron.stage_soft,
        vehicle_hard_iron_ut=iron.vehicle.hard_ut,
        vehicle_soft_iron=iron.vehicle.soft,
        azimuth_bias_sigma_deg=sigma_deg,
        fit={
            "headings": headings,
            "pan_angles": angles,
            "rms_ut": fit.rms_ut,
            "horizontal_ut": field.horizontal_ut,
            "horizontal_sigma_ut": field.horizontal_sigma_ut,
            "dip_deg": field.dip_deg,
            "dip_sigma_deg": field.dip_sigma_deg,
            "model_horizontal_ut": earth.horizontal_ut,
            "model_dip_deg": dip_deg(earth),
            "torque_field_ut": torque.field_ut.tolist(),
            "torque_varies_ut": torque.varies_ut,
            "torque_heading_deg": torque.heading_deg,
        },
    )
    dip = (
        f"{field.dip_deg:.1f} +- {field.dip_sigma_deg:.1f}"
        if field.dip_is_measured
        else "even ground does not tell it"
    )
    rows = [
        ("pan stage, hard iron, uT", _numbers(iron.stage_hard_ut), ""),
        ("pan stage, soft iron", f"up to {_softness(iron.stage_soft):.1%}", ""),
        ("vehicle, hard iron, uT", _numbers(iron.vehicle.hard_ut), ""),
        ("vehicle, soft iron", f"up to {_softness(iron.vehicle.soft):.1%}", ""),
        (
            "horizontal field measured, uT",
            f"{field.horizontal_ut:.1f} +- {field.horizontal_sigma_ut:.1f}",
            f"World Magnetic Model: {earth.horizontal_ut:.1f}",
        ),
        ("dip measured, deg", dip, f"World Magnetic Model: {dip_deg(earth):.1f}"),
        (
            "servos' torque adds, uT",
            f"{_numbers(torque.field_ut)}, varying by {torque.varies_ut:.2f}",
            f"{torque.heading_deg:.2f} deg of heading, taken out; {torque.varying_deg:.2f} deg left",
        ),
        ("heading, deg", "", f"{sigma_deg:.2f}"),
        ("residual rms, uT", f"{fit.rms_ut:.3f}", f"{headings} headings x {angles} pan angles"),
    ]
    run.finish(document, rows, draw(fit, vehicle_stops, sigma_deg))


def vehicle_stop(config: RigConfig, section: Mmc5983maSection, stops: Sequence[Stop]) -> VehicleStop:
    """One position of the vehicle as input of the fit: its slope, and the fields in axes of the pan stage."""
    inclinometer = config.inclinometer
    sigmas = LevelSigmas(
        inclinometer.tilt_sigma_deg,
        inclinometer.roll_sigma_deg,
        inclinometer.tilt_bias_sigma_deg,
        config.pan_tilt.azimuth_sigma_deg,
    )
    level = base_level([LevelReading(stop.joints, stop.level) for stop in stops], sigmas)
    fields = [in_axes(np.array(stop.field.mean_ut), section.axes) for stop in stops if stop.field is not None]
    pans_deg = np.array([stop.joints.pan_deg for stop in stops])
    return VehicleStop(level.pitch_deg, level.roll_deg, pans_deg, np.array(fields))


def draw(fit: CompassFit, stops: Sequence[VehicleStop], heading_sigma_deg: float) -> Figure:
    """Residuals over the pan angle, and the measured horizontal field."""
    figure, (left, circle) = new_figure(
        f"compass: {fit.rms_ut:.3f} uT rms, heading to {heading_sigma_deg:.2f} deg", 2
    )
    for residual_ut, stop, heading_deg in zip(fit.residuals_ut, stops, fit.headings_deg, strict=True):
        left.plot(stop.pan_deg, np.linalg.norm(residual_ut, axis=1), ".-", label=f"{heading_deg:.0f}", lw=0.8)
        circle.plot(stop.field_ut[:, 0], stop.field_ut[:, 1], ".-", lw=0.8)
    left.set_xlabel("pan, deg")
    left.set_ylabel("left after the fit, uT")
    left.set_ylim(bottom=0.0)
    left.legend(title="heading, deg", fontsize=8, ncols=2)
    circle.plot([0.0], [0.0], "k+")
    circle.set_aspect("equal")
    circle.set_xlabel("field of the pan stage, right, uT")
    circle.set_ylabel("ahead, uT")
    return figure


def _pan_angles(rig: Rig, angles: int) -> list[float]:
    """Pan angles over the full range, starting at the nearer end."""
    pan = rig.config.pan_tilt.pan
    pans_deg: list[float] = np.linspace(
        pan.min_deg + FROM_LIMIT_DEG, pan.max_deg - FROM_LIMIT_DEG, angles
    ).tolist()
    here_deg = rig.pan_tilt.state().pan_deg
    return pans_deg if abs(here_deg - pans_deg[0]) <= abs(here_deg - pans_deg[-1]) else pans_deg[::-1]


def _spread(angles: int) -> tuple[int, ...]:
    """Indices of the first, middle and last pan angle: there the torque is switched off. Not at each, as the head may
    sink.
    """
    return 0, angles // 2, angles - 1


def _torque_warnings(torque: TorqueField) -> list[str]:
    if torque.heading_deg <= TORQUE_LIMIT_DEG:
        return []
    return [
        f"The servos' holding current turns the compass by {torque.heading_deg:.1f} deg: a capture takes that out, but move "
        "the compass away from the motors where you can."
    ]


def _section(config: RigConfig) -> Mmc5983maSection:
    if config.compass is None:
        raise CalibrationError("compass: the configuration has no [compass]; add it first")
    if not isinstance(config.compass, Mmc5983maSection):
        raise CalibrationError(
            "compass: one that talks headings keeps its calibration itself; calibrate it as its manual says"
        )
    return config.compass


def _model(config: RigConfig) -> ModelField:
    if config.place is None:
        raise CalibrationError("compass: the strength of the Earth's field is looked up at [place]; add that")
    model = model_field(config.place, clock.utc_now())
    if model.problem:
        raise CalibrationError(f"compass: {model.problem}; set the clock")
    return model


def _softness(matrix: Sequence[Sequence[float]]) -> float:
    return float(np.abs(np.array(matrix) - np.eye(3)).max())


def _numbers(values: Sequence[float] | Vector) -> str:
    return ", ".join(f"{value:.2f}" for value in values)
