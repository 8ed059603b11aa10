"""The kinematic model: the contract's signs, and there and back again."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from localizer.camera import camera_to_world, project
from rig.attitude.kinematics import (
    Attitude,
    Head,
    JointAngles,
    body_attitude,
    body_rotation,
    camera_attitude,
    camera_pointing,
    camera_rotation,
    head_rotation,
    joints_for,
    measured_pointing,
    pan_stage_rotation,
    wrapped_deg,
)
from rig.errors import GoalError

NO_BORESIGHT = Attitude(0.0, 0.0, 0.0)
LEVEL = Attitude(0.0, 0.0, 0.0)
WIDE = Head((-180.0, 180.0), (-60.0, 80.0), NO_BORESIGHT)

azimuths = st.floats(0.0, 359.999)
slopes = st.floats(-15.0, 15.0)
bases = st.builds(Attitude, azimuths, slopes, slopes)
boresights = st.builds(Attitude, st.floats(-5.0, 5.0), st.floats(-5.0, 5.0), st.floats(-10.0, 10.0))
attitudes = st.builds(Attitude, azimuths, st.floats(-89.0, 89.0), st.floats(-179.0, 179.0))


def assert_same(one: Attitude, other: Attitude, tolerance_deg: float = 1e-6) -> None:
    assert wrapped_deg(one.azimuth_deg - other.azimuth_deg) == pytest.approx(0.0, abs=tolerance_deg)
    assert one.tilt_deg == pytest.approx(other.tilt_deg, abs=tolerance_deg)
    assert wrapped_deg(one.roll_deg - other.roll_deg) == pytest.approx(0.0, abs=tolerance_deg)


def test_axes_of_a_level_base_heading_north() -> None:
    np.testing.assert_allclose(body_rotation(LEVEL), np.eye(3), atol=1e-12)


def test_heading_is_clockwise_pitch_is_nose_up_roll_is_right_side_down() -> None:
    right, forward, _ = body_rotation(Attitude(90.0, 0.0, 0.0)).T
    np.testing.assert_allclose(forward, [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(right, [0, -1, 0], atol=1e-12)
    assert body_rotation(Attitude(30.0, 10.0, 0.0))[2, 1] > 0
    assert body_rotation(Attitude(30.0, 0.0, 10.0))[2, 0] < 0


def test_pan_is_clockwise_and_tilt_is_up() -> None:
    pointing = camera_pointing(LEVEL, JointAngles(30.0, 10.0), NO_BORESIGHT)
    assert_same(pointing, Attitude(30.0, 10.0, 0.0))


def test_a_rolled_camera_sees_a_level_horizon_turned_counter_clockwise() -> None:
    class Pinhole:
        fx_px = fy_px = 500.0
        cx_px, cy_px = 319.5, 239.5
        distortion = (0.0, 0.0, 0.0, 0.0, 0.0)

    # Looking north from a base whose right side is down: the camera is turned clockwise seen from behind.
    rotation = camera_rotation(head_rotation(Attitude(0.0, 0.0, 8.0), JointAngles(0.0, 0.0)), NO_BORESIGHT)
    assert camera_attitude(rotation).roll_deg == pytest.approx(8.0)
    _, row = project(Pinhole(), rotation, [-20.0, 20.0], [0.0, 0.0])
    assert row[0] > row[1], "the left end of the horizon lies lower in the image"


def test_an_accelerometer_in_the_head_sees_tilt_and_roll() -> None:
    rotation = head_rotation(Attitude(70.0, 4.0, -7.0), JointAngles(50.0, 12.0))
    fx, fy, fz = rotation.T @ [0.0, 0.0, 1.0]
    attitude = body_attitude(rotation)
    assert np.degrees(np.arcsin(fy)) == pytest.approx(attitude.tilt_deg)
    assert np.degrees(np.arctan2(-fx, fz)) == pytest.approx(attitude.roll_deg)


def test_on_a_slope_the_side_view_is_rolled() -> None:
    # Nose up by 10 deg: looking right, the left of the image (the vehicle's nose) is high, so the camera is
    # rolled clockwise; looking back, it looks down.
    base = Attitude(0.0, 10.0, 0.0)
    assert_same(camera_pointing(base, JointAngles(90.0, 0.0), NO_BORESIGHT), Attitude(90.0, 0.0, 10.0))
    assert_same(camera_pointing(base, JointAngles(180.0, 0.0), NO_BORESIGHT), Attitude(180.0, -10.0, 0.0))


@given(attitudes)
def test_attitude_and_rotation_are_inverse(attitude: Attitude) -> None:
    assert_same(body_attitude(body_rotation(attitude)), attitude)
    as_camera = camera_to_world(attitude.azimuth_deg, attitude.tilt_deg, attitude.roll_deg)
    assert_same(camera_attitude(as_camera), attitude)


@given(bases, st.floats(-180.0, 180.0), st.floats(-60.0, 80.0), boresights)
def test_rotations_are_proper(base: Attitude, pan_deg: float, tilt_deg: float, boresight: Attitude) -> None:
    rotation = camera_rotation(head_rotation(base, JointAngles(pan_deg, tilt_deg)), boresight)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)


@given(bases, azimuths, st.floats(-30.0, 60.0), boresights)
def test_a_request_is_reached_from_any_base(
    base: Attitude, azimuth_deg: float, tilt_deg: float, boresight: Attitude
) -> None:
    head = Head((-180.0, 180.0), (-80.0, 89.0), boresight)
    joints = joints_for(azimuth_deg, tilt_deg, base, head)
    pointing = camera_pointing(base, joints, boresight)
    assert wrapped_deg(pointing.azimuth_deg - azimuth_deg) == pytest.approx(0.0, abs=1e-6)
    assert pointing.tilt_deg == pytest.approx(tilt_deg, abs=1e-6)


@given(bases, st.floats(-179.0, 179.0), st.floats(-40.0, 60.0), boresights)
def test_readings_lead_back_to_the_joints(
    base: Attitude, pan_deg: float, tilt_deg: float, boresight: Attitude
) -> None:
    pointing = camera_pointing(base, JointAngles(pan_deg, tilt_deg), boresight)
    assume(abs(pointing.tilt_deg) < 75.0)
    joints = joints_for(
        pointing.azimuth_deg, pointing.tilt_deg, base, Head((-180.0, 180.0), (-60.0, 80.0), boresight)
    )
    assert wrapped_deg(joints.pan_deg - pan_deg) == pytest.approx(0.0, abs=1e-6)
    assert joints.tilt_deg == pytest.approx(tilt_deg, abs=1e-6)


@given(bases, st.floats(-179.0, 179.0), st.floats(-40.0, 60.0), boresights)
def test_a_true_inclinometer_agrees_with_the_joints(
    base: Attitude, pan_deg: float, tilt_deg: float, boresight: Attitude
) -> None:
    joints = JointAngles(pan_deg, tilt_deg)
    head = body_attitude(head_rotation(base, joints))
    measured = measured_pointing(base, joints, head.tilt_deg, head.roll_deg, boresight)
    assert_same(measured, camera_pointing(base, joints, boresight), 1e-5)


def test_the_inclinometer_overrules_the_joints() -> None:
    measured = measured_pointing(LEVEL, JointAngles(90.0, 5.0), 5.2, -0.3, Attitude(0.0, 1.0, 0.0))
    assert_same(measured, Attitude(90.0, 6.2, -0.3), 0.01)


def test_the_pan_stage_does_not_tilt() -> None:
    np.testing.assert_allclose(pan_stage_rotation(LEVEL, 40.0)[:, 2], [0, 0, 1], atol=1e-12)


def test_beyond_the_limits() -> None:
    narrow = Head((-170.0, 170.0), (-40.0, 60.0), NO_BORESIGHT)
    with pytest.raises(
        GoalError, match=r"azimuth 180\.0, tilt 0\.0 deg: needs pan -180\.0 deg, beyond .* of \[pan_"
    ):
        joints_for(180.0, 0.0, LEVEL, narrow)
    with pytest.raises(GoalError, match=r"needs tilt 70\.0 deg, beyond the limits -40 to 60"):
        joints_for(0.0, 70.0, LEVEL, narrow)


def test_a_range_beyond_half_a_turn_is_used() -> None:
    assert joints_for(
        185.0, 0.0, LEVEL, Head((0.0, 340.0), (-40.0, 60.0), NO_BORESIGHT)
    ).pan_deg == pytest.approx(185.0)


def test_no_way_up_for_a_camera_that_sits_askew() -> None:
    with pytest.raises(GoalError, match="too close to the pan axis"):
        joints_for(0.0, 89.5, LEVEL, Head((-180.0, 180.0), (-80.0, 120.0), Attitude(5.0, 0.0, 0.0)))
