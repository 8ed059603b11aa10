"""The accelerometer's own errors come out of readings at many pan and tilt angles, whatever the slope of the base."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from rig.attitude.kinematics import Attitude, JointAngles, head_rotation
from rig.attitude.level import tilt_roll_deg
from rig.calibrate.inclinometer.fit import InclinometerFit, TiltReading, fit_inclinometer
from rig.calibrate.inclinometer.temperature import read_drift
from rig.config.calibration_files import CalibrationError

ZERO_G = np.array([0.021, -0.017, 0.008])
SCALE = np.array([1.004, 0.996, 1.002])
MOUNTING_DEG = np.array([1.8, -2.4, 1.1])
JOINT_SIGMA_DEG = 0.1


def measured_g(up: np.ndarray) -> np.ndarray:
    """What the chip with these errors reads of a direction up in head axes."""
    return SCALE * (Rotation.from_rotvec(np.radians(MOUNTING_DEG)).as_matrix().T @ up) + ZERO_G


def readings(
    base: Attitude, pans_deg: np.ndarray, play_deg: float = 0.0, two_axes: bool = False
) -> list[TiltReading]:
    rng = np.random.default_rng(5)
    found = []
    for i, pan_deg in enumerate(pans_deg):
        for tilt_deg in (0.0, (-25.0, 25.0, 45.0)[i % 3]):
            true = JointAngles(pan_deg + rng.normal() * play_deg, tilt_deg + rng.normal() * play_deg)
            g = measured_g(head_rotation(base, true).T @ [0.0, 0.0, 1.0]) + rng.normal(0.0, 1e-5, 3)
            g[2] = np.nan if two_axes else g[2]
            found.append(TiltReading(JointAngles(float(pan_deg), tilt_deg), tuple(g.tolist()), 21.0))
    return found


def worst_deg(fit: InclinometerFit, two_axes: bool = False) -> tuple[float, float]:
    """Largest error of tilt and roll after correction, at tilts of use."""
    tilts = np.radians([-10.0, 0.0, 10.0, 20.0])
    read = np.array([measured_g(np.array([0.0, np.sin(t), np.cos(t)])) for t in tilts])
    if two_axes:
        read[:, 2] = np.nan
    tilt_deg, roll_deg = tilt_roll_deg(fit.correction.up_in_head(read, 21.0))
    return float(np.abs(tilt_deg - np.degrees(tilts)).max()), float(np.abs(roll_deg).max())


@settings(max_examples=6, deadline=None)
@given(st.floats(-6.0, 6.0), st.floats(-6.0, 6.0))
def test_degrees_of_error_go_on_any_slope(pitch_deg: float, roll_deg: float) -> None:
    fit = fit_inclinometer(
        readings(Attitude(0.0, pitch_deg, roll_deg), np.linspace(-170, 170, 8)), JOINT_SIGMA_DEG
    )
    tilt_off, roll_off = worst_deg(fit)
    assert tilt_off < 0.01
    assert roll_off < 0.004
    assert fit.base_pitch_deg == pytest.approx(pitch_deg, abs=0.02)
    assert fit.base_roll_deg == pytest.approx(roll_deg, abs=0.02)


@pytest.mark.parametrize("two_axes", [False, True])
def test_play_in_the_joints_is_covered_by_the_sigma(two_axes: bool) -> None:
    base = Attitude(0.0, 3.0, -4.0)
    fit = fit_inclinometer(
        readings(base, np.linspace(-170, 170, 10), play_deg=0.04, two_axes=two_axes), JOINT_SIGMA_DEG
    )
    tilt_off, roll_off = worst_deg(fit, two_axes)
    assert tilt_off < 3.0 * fit.tilt_sigma_deg < 0.15
    assert roll_off < 0.005


def test_too_few_angles_and_too_small_a_turn_are_refused() -> None:
    base = Attitude(0.0, 2.0, 1.0)
    with pytest.raises(CalibrationError, match="5 pan angles are too few"):
        fit_inclinometer(readings(base, np.linspace(-170, 170, 5)), JOINT_SIGMA_DEG)
    with pytest.raises(CalibrationError, match="turned through 105 deg only"):
        fit_inclinometer(readings(base, np.linspace(0, 105, 8)), JOINT_SIGMA_DEG)


def test_a_vehicle_that_rocks_is_refused() -> None:
    still = readings(Attitude(0.0, 2.0, 1.0), np.linspace(-170, 170, 8))
    rocked = readings(Attitude(0.0, 2.0, 1.3), np.linspace(-170, 170, 8))
    with pytest.raises(CalibrationError, match="fit no rigid head"):
        fit_inclinometer([*still[:7], *rocked[7:]], JOINT_SIGMA_DEG)


def test_axes_that_are_named_wrongly_are_refused() -> None:
    turned = [
        TiltReading(r.joints, (r.measured_g[1], -r.measured_g[0], r.measured_g[2]), 21.0)
        for r in readings(Attitude(0.0, 2.0, 1.0), np.linspace(-170, 170, 8))
    ]
    with pytest.raises(CalibrationError, match=r"seems to sit 89 deg askew; check \[inclinometer\] axes"):
        fit_inclinometer(turned, JOINT_SIGMA_DEG)


def write_log(path: Path, span_c: float, moved_g: float = 0.0) -> Path:
    rng = np.random.default_rng(1)
    lines = ["time,temperature_c,x_g,y_g,z_g"]
    for i, t in enumerate(np.linspace(10.0, 10.0 + span_c, 40)):
        x, y, z = (
            np.array([3e-5, -2e-5, 1e-5]) * t + rng.normal(0.0, 1e-5, 3) + [moved_g * (i > 20), 0.0, 1.0]
        )
        lines.append(f"2026-11-24T06:00:00Z,{t},{x},{y},{z}")
    path.write_text("\n".join(lines))
    return path


def test_drift_comes_from_a_log(tmp_path: Path) -> None:
    drift = read_drift(write_log(tmp_path / "log.csv", 20.0))
    assert drift.drift_mg_c == pytest.approx((0.03, -0.02, 0.01), abs=4 * max(drift.sigma_mg_c))
    assert max(drift.sigma_mg_c) < 0.001


def test_a_log_that_tells_nothing_is_refused(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match=r"over 3\.0 C tell no drift"):
        read_drift(write_log(tmp_path / "short.csv", 3.0))
    with pytest.raises(CalibrationError, match="the head moved"):
        read_drift(write_log(tmp_path / "moved.csv", 20.0, moved_g=0.01))
    (tmp_path / "bad.csv").write_text("temperature_c,x_g\n1,2\n")
    with pytest.raises(CalibrationError, match=r"bad\.csv: line 2"):
        read_drift(tmp_path / "bad.csv")
