"""Tilt and roll of the head, and the base's attitude, from accelerometer readings."""

from dataclasses import dataclass

import numpy as np
import pytest
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

STRAIGHT = ("+x", "+y", "+z")
SIGMAS = LevelSigmas(tilt_deg=0.01, roll_deg=0.02, zero_deg=0.02, joint_deg=0.1)
PANS_DEG = (-135.0, -45.0, 45.0, 135.0)


@dataclass(frozen=True)
class Sample:
    x_g: float
    y_g: float
    z_g: float | None
    temperature_c: float = 20.0


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
