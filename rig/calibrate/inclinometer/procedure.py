"""Inclinometer calibration: move the head through many pan and tilt angles, read, fit, show."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from rig.attitude.accelerometer import Triple
from rig.attitude.kinematics import JointAngles
from rig.attitude.level import HeadLevel
from rig.calibrate.figures import new_figure
from rig.calibrate.inclinometer.fit import InclinometerFit, TiltReading, fit_inclinometer
from rig.calibrate.inclinometer.temperature import read_drift
from rig.calibrate.run import CalibrationRun
from rig.capture.averaged_readings import still_level
from rig.config.calibration_files import CalibrationError, InclinometerCalibration
from rig.config.sections import PanTiltSection
from rig.devices.connect import Rig, connect

TILTS_DEG = (-40.0, 45.0, 60.0)  # far apart: errors of scale and mounting grow with the tilt
FROM_LIMIT_DEG = 4.0
MOVED_LIMIT_DEG = 0.03


def calibrate_inclinometer(run: CalibrationRun, angles: int, temperature_log: Path | None) -> None:
    """Guide the operator, measure, fit and write. ``CalibrationError`` says why a result is rejected."""
    config, guide = run.config, run.guide
    drift_mg_c: Triple = config.inclinometer.drift_mg_c
    if temperature_log is not None:
        drift = read_drift(temperature_log)
        drift_mg_c = drift.drift_mg_c
        guide.say(
            f"drift by the log: {_numbers(drift_mg_c, 4)} +- {_numbers(drift.sigma_mg_c, 4)} mg/C over {drift.span_c:.0f} C"
        )
    guide.ready(
        "Park where the vehicle stands firm, stop the engine and let everybody get off; a slope does no harm."
    )
    with connect(config) as rig:
        readings = measure(rig, angles, guide.say)
        device = rig.inclinometer.identify()
    fit = fit_inclinometer(readings, config.pan_tilt.azimuth_sigma_deg, drift_mg_c)
    correction = fit.correction
    document = InclinometerCalibration(
        **run.header("inclinometer", device),
        chip=config.inclinometer.chip,
        axes=config.inclinometer.axes,
        zero_mg=correction.zero_mg,
        scale=correction.scale,
        mounting_deg=correction.mounting_deg,
        drift_mg_c=drift_mg_c,
        zero_temperature_c=correction.zero_temperature_c,
        tilt_bias_sigma_deg=fit.tilt_sigma_deg,
        roll_sigma_deg=float(np.hypot(config.inclinometer.tilt_sigma_deg, fit.roll_sigma_deg)),
        fit={
            "readings": len(readings),
            "rms_deg": fit.rms_deg,
            "roll_sigma_deg": fit.roll_sigma_deg,
            "base_pitch_deg": fit.base_pitch_deg,
            "base_roll_deg": fit.base_roll_deg,
        },
    )
    rows = [
        ("zero, mg (right, forward, up)", _numbers(correction.zero_mg, 2), ""),
        ("scale", _numbers(correction.scale, 5), ""),
        ("mounting, deg", _numbers(correction.mounting_deg, 3), ""),
        ("drift, mg/C", _numbers(drift_mg_c, 4), ""),
        ("tilt, deg", "", f"{fit.tilt_sigma_deg:.4f}"),
        ("roll, deg", "", f"{fit.roll_sigma_deg:.4f}"),
        ("vehicle: pitch, roll, deg", f"{fit.base_pitch_deg:.3f}, {fit.base_roll_deg:.3f}", ""),
        ("residual rms, deg", f"{fit.rms_deg:.4f}", f"{len(readings)} readings"),
    ]
    run.finish(document, rows, draw(fit))


def measure(rig: Rig, angles: int, say: Callable[[str], None]) -> list[TiltReading]:
    """Read the head at ``angles`` pan angles, each at tilt 0 and another tilt; the first position again at the end.

    ``CalibrationError`` if that reading has changed: the vehicle has moved.
    """
    section = rig.config.inclinometer
    positions = stations(rig.config.pan_tilt, angles)
    readings, levels = [], []
    for number, joints in enumerate([*positions, positions[0]], start=1):
        state = rig.pan_tilt.go_to(joints.pan_deg, joints.tilt_deg)
        level, _ = still_level(rig, section.average_s)
        levels.append(level)
        readings.append(reading_of(JointAngles(state.pan_deg, state.tilt_deg), level, section.chip))
        say(
            f"{number} of {len(positions) + 1}: pan {state.pan_deg:.0f}, tilt {state.tilt_deg:.0f}: "
            f"reads tilt {level.tilt_deg:.3f}, roll {level.roll_deg:.3f} deg"
        )
    moved_deg = abs(levels[-1].roll_deg - levels[0].roll_deg)
    if moved_deg > MOVED_LIMIT_DEG:
        raise CalibrationError(
            f"inclinometer: the vehicle moved meanwhile, by {moved_deg:.2f} deg; "
            "let nobody board it and calibrate again"
        )
    return readings


def reading_of(joints: JointAngles, level: HeadLevel, chip: str) -> TiltReading:
    """A reading as input of the fit; a two-axis chip has no z of its own."""
    x, y, z = level.mean_g
    return TiltReading(joints, (x, y, np.nan if chip == "iis2iclx" else z), level.temperature_c)


def stations(section: PanTiltSection, angles: int) -> list[JointAngles]:
    """Joint positions: pan angles over the full range, each with tilt 0 and one of ``TILTS_DEG`` within the limits."""
    pan, tilt = section.pan, section.tilt
    pans_deg = np.linspace(pan.min_deg + FROM_LIMIT_DEG, pan.max_deg - FROM_LIMIT_DEG, angles)
    tilts_deg = [
        float(np.clip(t, tilt.min_deg + FROM_LIMIT_DEG, tilt.max_deg - FROM_LIMIT_DEG)) for t in TILTS_DEG
    ]
    found = []
    for i, pan_deg in enumerate(pans_deg.tolist()):
        pair = [JointAngles(pan_deg, 0.0), JointAngles(pan_deg, tilts_deg[i % len(tilts_deg)])]
        found += pair if i % 2 == 0 else pair[::-1]  # alternating, so that backlash enters from both sides
    return found


def draw(fit: InclinometerFit) -> Figure:
    """Residuals over pan and over tilt."""
    figure, (by_pan, by_tilt) = new_figure(
        f"inclinometer: {fit.rms_deg:.4f} deg rms of {len(fit.pan_deg)} readings", 2
    )
    for axes, angle_deg, name in ((by_pan, fit.pan_deg, "pan"), (by_tilt, fit.tilt_deg, "tilt")):
        for axis, label in enumerate(("right", "forward", "up")):
            axes.plot(angle_deg, 1000.0 * fit.residuals_deg[:, axis], "o", label=label, alpha=0.8)
        axes.axhline(0.0, color="0.5", lw=0.8)
        axes.set_xlabel(f"{name}, deg")
        axes.set_ylabel("left after the fit, thousandths of a degree")
    by_pan.legend()
    return figure


def _numbers(values: Triple, digits: int) -> str:
    return ", ".join(f"{value:.{digits}f}" for value in values)
