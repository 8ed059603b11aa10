"""The camera's geometry keeps the contract's axes and signs."""

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from localizer.camera import azimuth_elevation_deg, camera_to_world, direction_vectors, pixel_rays, project


@dataclass(frozen=True)
class Lens:
    fx_px: float = 492.8
    fy_px: float = 490.0
    cx_px: float = 319.5
    cy_px: float = 239.5
    distortion: tuple[float, float, float, float, float] = (-0.12, 0.03, 0.0006, -0.0004, 0.002)


def looking_at(azimuth_deg, tilt_deg, roll_deg, u, v):
    rays = pixel_rays(Lens(distortion=(0.0,) * 5), [u], [v])
    azimuth, elevation = azimuth_elevation_deg(rays @ camera_to_world(azimuth_deg, tilt_deg, roll_deg).T)
    return azimuth[0], elevation[0]


def test_the_principal_point_looks_along_azimuth_and_tilt():
    assert looking_at(123.0, 7.5, 20.0, 319.5, 239.5) == pytest.approx((123.0, 7.5))


def test_right_in_the_image_is_clockwise_and_down_is_lower():
    assert looking_at(0.0, 0.0, 0.0, 400.0, 239.5)[0] == pytest.approx(np.degrees(np.arctan2(80.5, 492.8)))
    assert looking_at(0.0, 0.0, 0.0, 319.5, 300.0)[1] < 0.0


def test_a_camera_rolled_clockwise_sees_the_level_horizon_turned_counter_clockwise():
    u, v = project(Lens(distortion=(0.0,) * 5), camera_to_world(90.0, 0.0, 10.0), [80.0, 100.0], [0.0, 0.0])
    left, right = v
    assert u[0] < u[1]
    assert right < left  # its right end has risen


def test_a_rotation_is_a_rotation():
    rotation = camera_to_world(200.0, -15.0, 33.0)
    assert rotation.T @ rotation == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)


@given(
    st.floats(0.0, 359.9),
    st.floats(-40.0, 60.0),
    st.floats(-30.0, 30.0),
    st.floats(0.0, 639.0),
    st.floats(0.0, 479.0),
)
def test_a_pixel_comes_back_from_its_direction_through_a_distorting_lens(azimuth, tilt, roll, u, v):
    rotation = camera_to_world(azimuth, tilt, roll)
    direction = azimuth_elevation_deg(pixel_rays(Lens(), [u], [v]) @ rotation.T)
    back = project(Lens(), rotation, *direction)
    assert (back[0][0], back[1][0]) == pytest.approx((u, v), abs=1e-3)


def test_what_lies_behind_the_camera_has_no_pixel():
    u, v = project(Lens(), camera_to_world(0.0, 0.0, 0.0), [180.0], [0.0])
    assert np.isnan(u[0])
    assert np.isnan(v[0])


@given(st.floats(0.0, 359.99), st.floats(-89.0, 89.0))
def test_directions_and_vectors_are_inverse(azimuth, elevation):
    back = azimuth_elevation_deg(direction_vectors(np.array([azimuth]), np.array([elevation])))
    assert (back[0][0], back[1][0]) == pytest.approx((azimuth, elevation), abs=1e-9)
