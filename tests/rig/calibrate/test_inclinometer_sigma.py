"""The sigmas of tilt and roll after a calibration of the inclinometer: closed forms for one error at a time."""

from dataclasses import replace

import numpy as np
import pytest

from rig.attitude.accelerometer import AccelerometerCorrection
from rig.attitude.kinematics import Attitude, JointAngles, head_rotation
from rig.calibrate.inclinometer.fit import (
    InclinometerFit,
    TiltReading,
    _require_plausible,
    _require_turn,
    _sigmas_deg,
    fit_inclinometer,
)
from rig.config.calibration_files import CalibrationError

ZERO_X, ZERO_Y, ZERO_Z, SCALE_X, SCALE_Y, SCALE_Z, ABOUT_X, ABOUT_Y, ABOUT_Z = range(9)
SIN, COS = np.sin(np.radians(20.0)), np.cos(np.radians(20.0))  # of the steepest tilt of use


@pytest.mark.parametrize(
    ("unknown", "three_axes", "of_tilt", "of_roll"),
    [
        # atan2 of three axes: a zero error counts across up. tilt: y cos t - z sin t; roll: x / cos t.
        (ZERO_Y, True, 1.0, 0.0),
        (ZERO_Z, True, SIN, 0.0),
        (ZERO_X, True, 0.0, 1.0 / COS),
        (SCALE_Y, True, SIN * COS, 0.0),
        (SCALE_Z, True, SIN * COS, 0.0),
        (SCALE_X, True, 0.0, 0.0),
        # asin of two: the tilt's error grows with the tilt, and the third axis has none.
        (ZERO_Y, False, 1.0 / COS, 0.0),
        (ZERO_X, False, 0.0, 1.0 / COS),
        (ZERO_Z, False, 0.0, 0.0),
        (SCALE_Y, False, SIN / COS, 0.0),
        # The mounting turns the head's axes.
        (ABOUT_X, True, 1.0, 0.0),
        (ABOUT_Y, True, 0.0, 1.0),
        (ABOUT_Z, True, 0.0, SIN / COS),
    ],
)
def test_one_uncertain_unknown_shows_in_tilt_and_roll_at_the_tilts_of_use(
    unknown: int, three_axes: bool, of_tilt: float, of_roll: float
) -> None:
    covariance = np.zeros((9, 9))
    covariance[unknown, unknown] = 1e-3**2
    sigmas_deg = _sigmas_deg(np.zeros(9), covariance, three_axes)
    assert np.radians(sigmas_deg) == pytest.approx(1e-3 * np.array([of_tilt, of_roll]), abs=1e-8)


def still(noise_g: float) -> list[TiltReading]:
    """A perfect chip on a perfect head, read at eight pan angles level and tilted."""
    rng = np.random.default_rng(5)
    found = []
    for i, pan_deg in enumerate(np.linspace(-170.0, 170.0, 8).tolist()):
        for tilt_deg in (0.0, (-25.0, 25.0, 45.0)[i % 3]):
            joints = JointAngles(pan_deg, tilt_deg)
            up = head_rotation(Attitude(0.0, 3.0, -4.0), joints).T @ [0.0, 0.0, 1.0]
            found.append(TiltReading(joints, tuple((up + noise_g * rng.normal(0.0, 1.0, 3)).tolist()), 21.0))
    return found


def test_readings_that_scatter_twice_as_much_leave_the_head_twice_as_uncertain() -> None:
    once, twice = (fit_inclinometer(still(noise_g), 0.1) for noise_g in (1e-4, 2e-4))
    assert twice.roll_sigma_deg / once.roll_sigma_deg == pytest.approx(2.0, rel=0.02)
    assert twice.tilt_sigma_deg / once.tilt_sigma_deg == pytest.approx(2.0, rel=0.02)
    assert twice.rms_deg / once.rms_deg == pytest.approx(2.0, rel=0.02)


def test_readings_quieter_than_can_be_believed_leave_it_as_uncertain_as_supposed() -> None:
    """Noise of 0.003 deg is supposed that no averaging removes."""
    quiet, silent = (fit_inclinometer(still(noise_g), 0.1) for noise_g in (1e-5, 1e-6))
    assert silent.roll_sigma_deg == pytest.approx(quiet.roll_sigma_deg, rel=0.01)
    assert quiet.roll_sigma_deg > 0.001


def test_the_known_drift_and_the_temperature_go_into_the_correction() -> None:
    found = fit_inclinometer(still(1e-5), 0.1, (0.1, 0.2, 0.3)).correction
    assert (found.drift_mg_c, found.zero_temperature_c) == ((0.1, 0.2, 0.3), 21.0)
    cold = [replace(reading, temperature_c=None) for reading in still(1e-5)]
    assert fit_inclinometer(cold, 0.1).correction.zero_temperature_c == 20.0


def test_six_pan_angles_ten_degrees_apart_through_half_a_turn_are_enough() -> None:
    enough = [0.0, 10.1, 20.2, 30.3, 40.4, 180.0]
    _require_turn(enough[::-1])
    with pytest.raises(CalibrationError, match="5 pan angles are too few"):
        _require_turn([0.0, 9.9, 20.2, 30.3, 40.4, 180.0])
    with pytest.raises(
        CalibrationError, match="the pan turned through 179 deg only; turn it through 180 or more"
    ):
        _require_turn([*enough[:-1], 179.0])


GOOD = InclinometerFit(
    AccelerometerCorrection(), 0.02, 0.005, 0.0, 0.0, 0.002, np.zeros((0, 3)), np.zeros(0), np.zeros(0)
)


@pytest.mark.parametrize(
    ("allowed", "refused", "reason"),
    [
        (
            {"rms_deg": 0.0199},
            {"rms_deg": 0.0209},
            r"fit no rigid head: 0\.021 deg are left, 0\.02 are allowed",
        ),
        (
            {"correction": AccelerometerCorrection(mounting_deg=(12.0, -12.0, 10.0))},  # 19.7
            {"correction": AccelerometerCorrection(mounting_deg=(12.0, -12.0, 11.0))},  # 20.2
            "the chip seems to sit 20 deg askew",
        ),
        (
            {"correction": AccelerometerCorrection(scale=(1.14, 0.86, 1.0))},
            {"correction": AccelerometerCorrection(scale=(1.0, 1.0, 0.84))},
            "its scale seems to be 16% off",
        ),
        ({"tilt_sigma_deg": 0.099}, {"tilt_sigma_deg": 0.11}, r"its zero is known to 0\.11 deg only"),
    ],
)
def test_a_calibration_is_believed_up_to_its_limits(
    allowed: dict[str, object], refused: dict[str, object], reason: str
) -> None:
    _require_plausible(replace(GOOD, **allowed))  # type: ignore[arg-type]
    with pytest.raises(CalibrationError, match=reason):
        _require_plausible(replace(GOOD, **refused))  # type: ignore[arg-type]
