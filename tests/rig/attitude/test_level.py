"""Tilt and roll of the head, and the base's attitude, from accelerometer readings."""

import numpy as np
import pytest
from fakes.acceleration import STRAIGHT, Sample
from hypothesis import given
from hypothesis import strategies as st

from rig.attitude.kinematics import Attitude, JointAngles, body_attitude, body_rotation, head_rotation
from rig.attitude.level import (
    BaseLevel,
    HeadLevel,
    LevelReading,
    LevelSigmas,
    base_level,
    head_level,
    in_axes,
    tilt_roll_deg,
)
from rig.errors import DeviceError

SIGMAS = LevelSigmas(tilt_deg=0.01, roll_deg=0.02, zero_deg=0.02, joint_deg=0.1)
PANS_DEG = (-135.0, -45.0, 45.0, 135.0)


def samples(up: np.ndarray, count: int, noise_g: float, seed: int = 1) -> list[Sample]:
    noisy = up + np.random.default_rng(seed).normal(0.0, noise_g, (count, 3))
    return [Sample(*row) for row in noisy.tolist()]


def up_in_head(tilt_deg: float, roll_deg: float) -> np.ndarray:
    return body_rotation(Attitude(0.0, tilt_deg, roll_deg)).T @ np.array([0.0, 0.0, 1.0])


def level(tilt_deg: float, roll_deg: float) -> HeadLevel:
    return HeadLevel((0.0, 0.0, 1.0), tilt_deg, roll_deg, 0.001, 0.001, 100)


def readings(
    base: Attitude,
    pans_deg: tuple[float, ...] = PANS_DEG,
    tilt_zero_deg: float = 0.0,
    roll_zero_deg: float = 0.0,
    joint_deg: float = 0.0,
) -> list[LevelReading]:
    found = []
    for pan_deg in pans_deg:
        head = body_attitude(head_rotation(base, JointAngles(pan_deg, 0.1 + joint_deg)))
        shown = level(head.tilt_deg + tilt_zero_deg, head.roll_deg + roll_zero_deg)
        found.append(LevelReading(JointAngles(pan_deg, 0.1), shown))
    return found


@given(st.floats(-80.0, 80.0), st.floats(-170.0, 170.0), st.floats(0.5, 2.0))
def test_tilt_and_roll_of_a_gravity_vector(tilt_deg: float, roll_deg: float, length: float) -> None:
    tilt, roll = tilt_roll_deg(length * up_in_head(tilt_deg, roll_deg))
    assert tilt == pytest.approx(tilt_deg, abs=1e-9)
    assert roll == pytest.approx(roll_deg, abs=1e-9)


def test_chip_axes() -> None:
    np.testing.assert_array_equal(in_axes(np.array([1.0, 2.0, 3.0]), ("-y", "+x", "+z")), [-2.0, 1.0, 3.0])


def test_a_second_of_samples_is_averaged_to_millidegrees() -> None:
    # 22.5 ug/sqrt(Hz) at a bandwidth of 31 Hz, 125 samples a second.
    average = head_level(samples(up_in_head(3.0, -2.0), 125, 125e-6), STRAIGHT, "chip")
    assert average.tilt_deg == pytest.approx(3.0, abs=0.005)
    assert average.roll_deg == pytest.approx(-2.0, abs=0.005)
    assert 0.0002 < average.tilt_noise_deg < 0.003
    assert average.samples == 125


def test_a_knock_does_not_count() -> None:
    quiet = samples(up_in_head(3.0, -2.0), 120, 100e-6)
    knock = samples(up_in_head(20.0, 15.0), 12, 0.05)
    average = head_level([*quiet[:50], *knock, *quiet[50:]], STRAIGHT, "chip")
    assert average.tilt_deg == pytest.approx(3.0, abs=0.01)
    assert average.roll_deg == pytest.approx(-2.0, abs=0.01)


def test_a_two_axis_chip_does_as_well() -> None:
    flat = [Sample(s.x_g, s.y_g, None) for s in samples(up_in_head(5.0, 4.0), 50, 1e-5)]
    average = head_level(flat, STRAIGHT, "chip")
    assert average.tilt_deg == pytest.approx(5.0, abs=0.002)
    assert average.roll_deg == pytest.approx(4.0, abs=0.002)


def test_what_cannot_be_gravity_is_an_error() -> None:
    with pytest.raises(
        DeviceError, match=r"adxl355: measures 0\.500 g where gravity is 1 g; keep the vehicle still"
    ):
        head_level([Sample(0.0, 0.0, 0.5)] * 3, STRAIGHT, "adxl355")
    with pytest.raises(DeviceError, match="gravity"):
        head_level([Sample(0.9, 0.9, None)] * 3, STRAIGHT, "iis2iclx")


@given(st.floats(-12.0, 12.0), st.floats(-12.0, 12.0))
def test_the_base_is_found_from_four_pan_angles(pitch_deg: float, roll_deg: float) -> None:
    found = base_level(readings(Attitude(0.0, pitch_deg, roll_deg)), SIGMAS)
    assert found.pitch_deg == pytest.approx(pitch_deg, abs=1e-4)
    assert found.roll_deg == pytest.approx(roll_deg, abs=1e-4)
    assert found.residual_deg < 1e-4


def test_the_zero_error_in_roll_is_measured_by_turning() -> None:
    sigmas = LevelSigmas(0.01, 0.02, zero_deg=1.0, joint_deg=0.1)
    found = base_level(readings(Attitude(0.0, 3.0, -4.0), roll_zero_deg=0.7), sigmas)
    assert found.roll_zero_deg == pytest.approx(0.7, abs=0.005)
    assert found.roll_zero_sigma_deg < 0.02
    assert (found.pitch_deg, found.roll_deg) == pytest.approx((3.0, -4.0), abs=0.02)


def test_an_inclinometer_that_was_never_zeroed_is_zeroed_by_the_tilt_joint() -> None:
    sigmas = LevelSigmas(0.01, 0.02, zero_deg=2.0, joint_deg=0.1)
    found = base_level(readings(Attitude(0.0, 3.0, -4.0), tilt_zero_deg=1.3), sigmas)
    assert found.tilt_zero_deg == pytest.approx(1.3, abs=0.02)
    assert found.tilt_zero_sigma_deg == pytest.approx(0.11, abs=0.03)
    assert (found.pitch_deg, found.roll_deg) == pytest.approx((3.0, -4.0), abs=0.02)


def test_a_zeroed_inclinometer_is_not_spoilt_by_play_in_the_tilt_joint() -> None:
    found = base_level(readings(Attitude(0.0, 3.0, -4.0), joint_deg=0.15), SIGMAS)
    assert abs(found.tilt_zero_deg) < 0.01
    assert found.tilt_zero_sigma_deg <= SIGMAS.zero_deg
    assert (found.pitch_deg, found.roll_deg) == pytest.approx((3.0, -4.0), abs=0.02)


EVEN_DEG = (0.0, 90.0, 180.0, 270.0)
DISTINCT = LevelSigmas(tilt_deg=0.03, roll_deg=0.2, zero_deg=0.5, joint_deg=0.04)


def test_the_sigmas_of_an_even_turn_are_those_of_the_closed_form() -> None:
    """Level: a head at pan a leans by p cos a + r sin a ahead and by r cos a - p sin a to the side.

    Over four even angles the sums of squares of sine and cosine are 2 each, and slope and zero are uncorrelated.
    """
    found = base_level(readings(Attitude(0.0, 0.0, 0.0), EVEN_DEG), DISTINCT)
    tilt_2, roll_2 = 0.03**2 + 0.04**2, 0.2**2
    slope_2 = 1.0 / (2.0 / tilt_2 + 2.0 / roll_2)  # of pitch, and of roll
    assert found.sigma_deg == pytest.approx(np.sqrt(2.0 * slope_2), rel=1e-3)
    assert found.roll_zero_sigma_deg == pytest.approx(np.sqrt(1.0 / (1.0 / 0.5**2 + 4.0 / roll_2)), rel=1e-3)
    # The zero in tilt, known to 0.5, from a mean of four that also has the joint's error of 0.04.
    tilt_zero_2 = 0.5**2 - 0.5**4 / (0.5**2 + 0.04**2 + tilt_2 / 4.0)
    assert found.tilt_zero_sigma_deg == pytest.approx(np.sqrt(tilt_zero_2), rel=1e-3)


def test_a_slope_across_few_pan_angles_is_the_less_certain_part() -> None:
    """Ahead and 20 degrees to both sides: pitch is nearly the tilt's zero, roll nearly the roll's."""
    pans_deg = (-20.0, 0.0, 20.0)
    found = base_level(readings(Attitude(0.0, 0.0, 0.0), pans_deg), DISTINCT)
    c, s = np.cos(np.radians(pans_deg)), np.sin(np.radians(pans_deg))
    one, none = np.ones(3), np.zeros(3)
    # Unknowns: pitch, roll, zero of tilt, zero of roll, tilt joint; a joint error adds to the tilt.
    rows = np.vstack(
        [
            np.column_stack([c, s, one, none, one]) / np.hypot(0.03, 0.04),
            np.column_stack([-s, c, none, one, none]) / 0.2,
            np.column_stack([np.zeros((3, 2)), np.diag([1 / 0.5, 1 / 0.5, 1 / 0.04])]),
        ]
    )
    deviations = np.sqrt(np.diag(np.linalg.inv(rows.T @ rows)))
    assert found.sigma_deg == pytest.approx(np.hypot(deviations[0], deviations[1]), rel=1e-3)
    assert found.tilt_zero_sigma_deg == pytest.approx(deviations[2], rel=1e-3)
    assert found.roll_zero_sigma_deg == pytest.approx(deviations[3], rel=1e-3)


def test_the_residual_is_the_rms_of_the_rolls() -> None:
    """Rolls that alternate by 0.03 around an even turn: a slope or a zero explains none of it, nor does a tilt."""
    shown = readings(Attitude(0.0, 0.0, 0.0), (0.0, 45.0, 90.0, 135.0, 180.0, 225.0, 270.0, 315.0))
    off = [
        LevelReading(r.joints, level(r.level.tilt_deg + 0.02, r.level.roll_deg + 0.03 * (-1) ** i))
        for i, r in enumerate(shown)
    ]
    assert base_level(off, SIGMAS).residual_deg == pytest.approx(0.03, rel=1e-3)


def test_the_noise_of_the_average_is_that_of_a_median_of_nine_means() -> None:
    """1 mg of white noise in 900 samples: 1 mg / 30 of a mean, 1.2533 times that of a median, 0.0024 deg."""
    expected_deg = np.degrees(1e-3 / np.sqrt(900.0)) * 1.2533
    shown = [
        head_level(samples(up_in_head(0.0, 0.0), 900, 1e-3, seed), STRAIGHT, "chip") for seed in range(60)
    ]
    for told, found in (
        ([one.tilt_noise_deg for one in shown], [one.tilt_deg for one in shown]),
        ([one.roll_noise_deg for one in shown], [one.roll_deg for one in shown]),
    ):
        assert np.sqrt(np.mean(np.square(told))) == pytest.approx(expected_deg, rel=0.1)
        assert np.std(found) == pytest.approx(expected_deg, rel=0.25)


def test_one_sample_tells_no_noise() -> None:
    alone = head_level([Sample(0.0, 0.0, 1.0)], STRAIGHT, "chip")
    assert (alone.tilt_noise_deg, alone.roll_noise_deg, alone.samples) == (np.inf, np.inf, 1)


@pytest.mark.parametrize(("size_g", "is_gravity"), [(0.89, False), (0.91, True), (1.09, True), (1.11, False)])
def test_gravity_is_within_a_tenth_of_1_g(size_g: float, is_gravity: bool) -> None:
    shown = [Sample(0.0, 0.6 * size_g, 0.8 * size_g)] * 9
    if is_gravity:
        assert head_level(shown, STRAIGHT, "chip").tilt_deg == pytest.approx(36.8699, abs=1e-4)
        return
    with pytest.raises(DeviceError, match=rf"measures {size_g:.3f} g where gravity is 1 g"):
        head_level(shown, STRAIGHT, "chip")


@pytest.mark.parametrize(("off_deg", "is_refused"), [(0.49, False), (0.51, True)])
def test_readings_may_be_half_a_degree_apart_from_one_attitude(off_deg: float, is_refused: bool) -> None:
    shown = readings(Attitude(0.0, 0.0, 0.0), (0.0, 45.0, 90.0, 135.0, 180.0, 225.0, 270.0, 315.0))
    apart = [
        LevelReading(r.joints, level(r.level.tilt_deg, r.level.roll_deg + off_deg * (-1) ** i))
        for i, r in enumerate(shown)
    ]
    if is_refused:
        with pytest.raises(DeviceError, match=r"fit no one attitude of the vehicle \(0\.5 deg apart\)"):
            base_level(apart, SIGMAS)
    else:
        base_level(apart, SIGMAS)


def test_noisy_readings_may_be_five_sigmas_apart() -> None:
    noisy = LevelSigmas(tilt_deg=0.3, roll_deg=0.2, zero_deg=0.02, joint_deg=0.4)  # hypot 0.5: to 2.5 deg
    shown = readings(Attitude(0.0, 0.0, 0.0), (0.0, 45.0, 90.0, 135.0, 180.0, 225.0, 270.0, 315.0))

    def apart(off_deg: float) -> list[LevelReading]:
        return [
            LevelReading(r.joints, level(r.level.tilt_deg, r.level.roll_deg + off_deg * (-1) ** i))
            for i, r in enumerate(shown)
        ]

    base_level(apart(2.4), noisy)
    with pytest.raises(DeviceError, match=r"\(2\.6 deg apart\)"):
        base_level(apart(2.6), noisy)


def test_a_vehicle_that_moved_is_noticed() -> None:
    before = readings(Attitude(0.0, 3.0, -4.0))
    after = readings(Attitude(0.0, 3.0, 1.0))
    with pytest.raises(
        DeviceError, match=r"fit no one attitude of the vehicle .*; measure while the vehicle stands"
    ):
        base_level([*before[:2], *after[2:]], SIGMAS)


def test_a_wrong_pan_direction_is_noticed() -> None:
    mirrored = [
        LevelReading(JointAngles(-r.joints.pan_deg, r.joints.tilt_deg), r.level)
        for r in readings(Attitude(0.0, 5.0, 2.0))
    ]
    with pytest.raises(DeviceError, match=r"\[pan_tilt\.pan\] zero_tick, direction"):
        base_level(mirrored, SIGMAS)


def test_the_level_takes_a_heading() -> None:
    base_estimate = BaseLevel(1.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    assert base_estimate.attitude(30.0) == Attitude(30.0, 1.0, 2.0)
