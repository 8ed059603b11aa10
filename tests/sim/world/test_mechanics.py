"""Axes and signs of the contract, from the ground to the camera."""

import threading

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.world.mechanics import Attitude, Head, JointState, Mechanics, body_in_world, camera_in_world

EAST, NORTH, UP = np.eye(3)
LEVEL = Attitude(0.0, 0.0, 0.0)
angles = st.floats(-180.0, 180.0)
tilts = st.floats(-80.0, 80.0)


def test_a_level_camera_to_the_north_sees_east_on_its_right() -> None:
    np.testing.assert_allclose(
        camera_in_world(0.0, 0.0, 0.0), np.column_stack([EAST, -UP, NORTH]), atol=1e-15
    )


def test_azimuth_turns_clockwise_tilt_up_and_roll_clockwise_from_behind() -> None:
    np.testing.assert_allclose(camera_in_world(90.0, 0.0, 0.0)[:, 2], EAST, atol=1e-15)
    np.testing.assert_allclose(
        camera_in_world(0.0, 30.0, 0.0)[:, 2], np.cos(np.pi / 6) * NORTH + 0.5 * UP, atol=1e-15
    )
    right, _, _ = camera_in_world(0.0, 0.0, 10.0).T
    assert right[2] < 0.0  # the right side sinks, so that a level horizon rises to the right in the picture


@given(azimuth=angles, tilt=tilts, roll=angles)
def test_rotations_are_rotations(azimuth: float, tilt: float, roll: float) -> None:
    for rotation in (camera_in_world(azimuth, tilt, roll), body_in_world(azimuth, tilt, roll)):
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(rotation) == pytest.approx(1.0)


@given(heading=angles, pan=angles, tilt=tilts)
def test_on_a_level_base_pan_adds_to_the_heading(heading: float, pan: float, tilt: float) -> None:
    mechanics = Mechanics(Attitude(heading, 0.0, 0.0), LEVEL)
    np.testing.assert_allclose(
        mechanics.camera_in_world(pan, tilt), camera_in_world(heading + pan, tilt, 0.0), atol=1e-12
    )


def test_on_a_nose_up_base_the_head_looks_up_ahead_and_rolls_to_the_side() -> None:
    mechanics = Mechanics(Attitude(0.0, 5.0, 0.0), LEVEL)
    np.testing.assert_allclose(
        mechanics.camera_in_world(0.0, 0.0), camera_in_world(0.0, 5.0, 0.0), atol=1e-12
    )
    right, forward, _ = mechanics.head_in_world(90.0, 0.0).T
    np.testing.assert_allclose(forward, EAST, atol=1e-12)
    assert right[2] == pytest.approx(
        -np.sin(np.radians(5.0))
    )  # its right is the vehicle's rear, which is low


def test_a_boresight_offset_moves_the_camera_in_the_head() -> None:
    mechanics = Mechanics(LEVEL, Attitude(0.3, -0.2, 0.1))
    np.testing.assert_allclose(
        mechanics.camera_in_world(0.0, 0.0), camera_in_world(0.3, -0.2, 0.1), atol=1e-12
    )


def test_readers_of_the_head_never_see_half_a_change() -> None:
    head = Head()
    stop = threading.Event()
    torn: list[JointState] = []

    def read() -> None:
        while not stop.is_set():
            state = head.state()
            if state.pan_deg != state.tilt_deg:
                torn.append(state)

    reader = threading.Thread(target=read)
    reader.start()
    for step in range(2000):
        head.set(float(step), float(step), moving=True)
    stop.set()
    reader.join()
    assert not torn
    assert (head.pan_deg, head.tilt_deg, head.moving) == (1999.0, 1999.0, True)
