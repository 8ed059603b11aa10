"""The average of accelerometer samples: temperature, samples that are no gravity, knocks, and few samples."""

import numpy as np
import pytest
from fakes.acceleration import STRAIGHT, Sample

from rig.attitude.accelerometer import AccelerometerCorrection
from rig.attitude.kinematics import Attitude, JointAngles, body_attitude, head_rotation
from rig.attitude.level import HeadLevel, LevelReading, LevelSigmas, base_level, head_level
from rig.errors import DeviceError


def test_the_drift_is_that_of_the_mean_temperature() -> None:
    """Of those samples that tell one: 25 and 35, 10 above the calibration's; 1 mg of 10 degrees is 0.0573 deg."""
    drifting = AccelerometerCorrection(drift_mg_c=(0.0, 0.1, 0.0), zero_temperature_c=20.0)
    shown = [Sample(0.0, 0.001, 1.0, t) for t in (25.0, 35.0, np.nan)]
    found = head_level(shown, STRAIGHT, "chip", drifting)
    assert found.temperature_c == pytest.approx(30.0)
    assert found.tilt_deg == pytest.approx(0.0, abs=1e-9)
    assert found.mean_g == pytest.approx((0.0, 0.001, 1.0)), "uncorrected"


def test_a_drift_needs_a_temperature() -> None:
    silent = [Sample(0.0, 0.0, 1.0, np.nan)] * 3
    drifting = AccelerometerCorrection(drift_mg_c=(0.0, 0.1, 0.0))
    with pytest.raises(
        DeviceError, match=r"chip: does not tell its temperature, and \[inclinometer\] drift_mg_c"
    ):
        head_level(silent, STRAIGHT, "chip", drifting)
    assert head_level(silent, STRAIGHT, "chip").temperature_c is None


def test_one_sample_of_two_axes_beyond_1_g_is_enough_to_refuse() -> None:
    shown = [Sample(0.1, 0.2, None)] * 20 + [Sample(0.8, 0.7, None)]
    with pytest.raises(DeviceError, match=r"measures 1\.063 g where gravity is 1 g"):
        head_level(shown, STRAIGHT, "chip")


@pytest.mark.parametrize(
    ("y_g", "scale", "is_gravity"),
    [(0.95, 1.0, True), (0.95, 0.94, False), (1.02, 1.1, False), (1.02, 1.0, False)],
)
def test_two_axes_must_be_below_1_g_with_the_correction_and_without(
    y_g: float, scale: float, is_gravity: bool
) -> None:
    corrected = AccelerometerCorrection(scale=(1.0, scale, 1.0))
    shown = [Sample(0.0, y_g, None)] * 9
    if is_gravity:
        assert head_level(shown, STRAIGHT, "chip", corrected).tilt_deg == pytest.approx(71.805, abs=0.001)
        return
    with pytest.raises(DeviceError, match=rf"measures {y_g:.3f} g where gravity is 1 g"):
        head_level(shown, STRAIGHT, "chip", corrected)


def test_knocks_in_four_of_nine_parts_of_the_time_do_not_count() -> None:
    level, knocked = Sample(0.0, 0.0, 1.0), Sample(0.0, 0.1, 0.995)
    found = head_level([knocked] * 40 + [level] * 50, STRAIGHT, "chip")
    assert found.tilt_deg == pytest.approx(0.0, abs=1e-9)
    assert head_level([knocked] * 50 + [level] * 40, STRAIGHT, "chip").tilt_deg > 5.0


def test_two_samples_have_a_noise() -> None:
    """0 and 0.1 deg: a standard deviation of 0.0707, over the root of 2, 1.2533 times that of a mean."""
    s, c = np.sin(np.radians(0.1)), np.cos(np.radians(0.1))
    tilted = head_level([Sample(0.0, 0.0, 1.0), Sample(0.0, s, c)], STRAIGHT, "chip")
    assert tilted.tilt_noise_deg == pytest.approx(0.1 / np.sqrt(2.0) / np.sqrt(2.0) * 1.2533, rel=1e-6)
    rolled = head_level([Sample(0.0, 0.0, 1.0), Sample(-s, 0.0, c)], STRAIGHT, "chip")
    assert rolled.roll_noise_deg == pytest.approx(0.1 / 2.0 * 1.2533, rel=1e-6)
    assert rolled.roll_deg == pytest.approx(0.05, abs=1e-6)


EIGHT_DEG = (0.0, 45.0, 90.0, 135.0, 180.0, 225.0, 270.0, 315.0)


def readings(off_deg: np.ndarray) -> list[LevelReading]:
    """Of a level base, by a head whose rolls are off by so much."""
    found = []
    for pan_deg, off in zip(EIGHT_DEG, off_deg, strict=True):
        head = body_attitude(head_rotation(Attitude(0.0, 0.0, 0.0), JointAngles(pan_deg, 0.0)))
        shown = HeadLevel((0.0, 0.0, 1.0), head.tilt_deg, head.roll_deg + float(off), 0.001, 0.001, 100)
        found.append(LevelReading(JointAngles(pan_deg, 0.0), shown))
    return found


ROLLS_COUNT = LevelSigmas(tilt_deg=1.0, roll_deg=0.02, zero_deg=1.0, joint_deg=0.1)


def test_the_residual_is_an_rms_and_not_the_largest() -> None:
    """A third harmonic of 0.03, which neither slope nor zero has."""
    off_deg = 0.03 * np.cos(3.0 * np.radians(EIGHT_DEG) + 0.2)
    assert base_level(readings(off_deg), ROLLS_COUNT).residual_deg == pytest.approx(
        0.03 / np.sqrt(2.0), rel=1e-3
    )


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_one_reading_that_is_off_to_either_side_is_noticed(sign: float) -> None:
    """3 of 8 parts of it go into zero and slope: 12 deg leave 7.5, and the limit is 5 sigmas of 1 deg."""
    base_level(readings(sign * 7.0 * np.eye(8)[2]), ROLLS_COUNT)
    with pytest.raises(DeviceError, match="fit no one attitude of the vehicle"):
        base_level(readings(sign * 12.0 * np.eye(8)[2]), ROLLS_COUNT)
