"""The camera's geometry keeps the contract's axes and signs."""

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from localizer.camera import (
    azimuth_elevation_deg,
    camera_to_world,
    direction_vectors,
    invertible_share,
    pixel_rays,
    project,
)


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


@pytest.mark.parametrize("attitude", [(0.0, 0.0, 0.0), (90.0, 20.0, 30.0), (213.0, -35.0, -80.0)])
def test_the_axes_are_those_of_the_contract(attitude):
    a, t, r = np.radians(attitude)
    forward = np.array([np.sin(a) * np.cos(t), np.cos(a) * np.cos(t), np.sin(t)])
    level_right = np.array([np.cos(a), -np.sin(a), 0.0])
    level_down = np.cross(forward, level_right)
    right = level_right * np.cos(r) + level_down * np.sin(r)
    down = -level_right * np.sin(r) + level_down * np.cos(r)
    assert camera_to_world(*attitude) == pytest.approx(np.column_stack([right, down, forward]), abs=1e-15)


def brown(lens: Lens, x: float, y: float) -> tuple[float, float]:
    """Pixel of the normalised point (x, y): the model in OpenCV's documentation of its calibration functions."""
    k1, k2, p1, p2, k3 = lens.distortion
    square = x * x + y * y
    radial = 1.0 + square * (k1 + square * (k2 + square * k3))
    xd = x * radial + 2.0 * p1 * x * y + p2 * (square + 2.0 * x * x)
    yd = y * radial + p1 * (square + 2.0 * y * y) + 2.0 * p2 * x * y
    return lens.fx_px * xd + lens.cx_px, lens.fy_px * yd + lens.cy_px


@pytest.mark.parametrize(("x", "y"), [(0.0, 0.0), (0.5, -0.3), (-0.6, 0.4), (0.1, 0.45)])
def test_a_direction_has_the_pixel_that_the_distortion_model_gives_it(x, y):
    """Looking east without tilt: x to the right is south, y downwards is below the horizon."""
    vector = np.array([[1.0, -x, -y]])
    u, v = project(Lens(), camera_to_world(90.0, 0.0, 0.0), *azimuth_elevation_deg(vector))
    assert (u[0], v[0]) == pytest.approx(brown(Lens(), x, y), abs=1e-6)
    ray = pixel_rays(Lens(), *([value] for value in brown(Lens(), x, y)))
    assert ray[0] == pytest.approx(np.array([x, y, 1.0]) / np.sqrt(x * x + y * y + 1.0), abs=1e-7)


def test_directions_up_to_87_degrees_off_the_axis_have_a_pixel():
    """0.05 of a unit vector along the axis: 87.13 degrees."""
    u, _ = project(Lens(distortion=(0.0,) * 5), camera_to_world(0.0, 0.0, 0.0), [87.1, 87.2], [0.0, 0.0])
    assert u[0] == pytest.approx(319.5 + 492.8 * np.tan(np.radians(87.1)), rel=1e-9)
    assert np.isnan(u[1])


def test_the_share_of_pixels_that_a_lens_model_gives_back():
    """A barrel of k1 = -0.35 folds over at a radius of 2/3 sqrt(1 / (3 x 0.35)) = 0.65: pixels beyond have no direction."""
    assert invertible_share(Lens(), 640, 480) == 1.0
    folding = Lens(cx_px=800.0, cy_px=600.0, distortion=(-0.35, 0.0, 0.0, 0.0, 0.0))
    u, v = np.meshgrid(np.linspace(0.0, 1599.0, 9), np.linspace(0.0, 1199.0, 9))
    radius = np.hypot((u - 800.0) / 492.8, (v - 600.0) / 490.0)
    within = np.mean(radius < 2.0 / 3.0 * np.sqrt(1.0 / (3.0 * 0.35)))
    assert invertible_share(folding, 1600, 1200) == pytest.approx(within, abs=1.5 / 81.0)


def test_azimuths_are_0_to_360():
    vectors = np.array(
        [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, -2.0, 0.0], [-3.0, 0.0, 0.0], [-1.0, 1.0, -1.0]]
    )
    azimuth, elevation = azimuth_elevation_deg(vectors)
    assert azimuth == pytest.approx([0.0, 90.0, 180.0, 270.0, 315.0])
    assert elevation == pytest.approx([0.0, 0.0, 0.0, 0.0, -np.degrees(np.arctan(np.sqrt(0.5)))])


def test_what_lies_behind_the_camera_has_no_pixel():
    u, v = project(Lens(), camera_to_world(0.0, 0.0, 0.0), [180.0], [0.0])
    assert np.isnan(u[0])
    assert np.isnan(v[0])


@given(st.floats(0.0, 359.99), st.floats(-89.0, 89.0))
def test_directions_and_vectors_are_inverse(azimuth, elevation):
    back = azimuth_elevation_deg(direction_vectors(np.array([azimuth]), np.array([elevation])))
    assert (back[0][0], back[1][0]) == pytest.approx((azimuth, elevation), abs=1e-9)
