"""The skyline of a camera, computed without a picture."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim.world.contour import skyline_contour, undistorted
from sim.world.mechanics import camera_in_world
from sim.world.scenario import CameraOptics
from sim.world.truth import World

ALL_COLUMNS = np.arange(640.0)
STRONG = CameraOptics(distortion=(-0.25, 0.06, 0.001, -0.0015, 0.01))


def matrix(optics: CameraOptics) -> np.ndarray:
    return np.array([[optics.fx_px, 0.0, optics.cx_px], [0.0, optics.fy_px, optics.cy_px], [0.0, 0.0, 1.0]])


def projected_horizon(world: World, optics: CameraOptics, rotation: np.ndarray) -> np.ndarray:
    """Pixels (n, 2) of the horizon at many azimuths, projected by OpenCV."""
    middle = np.degrees(np.arctan2(rotation[0, 2], rotation[1, 2]))
    azimuth_deg = middle + np.linspace(-45.0, 45.0, 18001)
    elevation = np.radians(world.surface.horizon(world.observer, azimuth_deg)[0])
    azimuth = np.radians(azimuth_deg)
    level = np.cos(elevation)
    sight = np.column_stack([np.sin(azimuth) * level, np.cos(azimuth) * level, np.sin(elevation)]) @ rotation
    seen, _ = cv2.projectPoints(
        sight[:, None, :], np.zeros(3), np.zeros(3), matrix(optics), np.array(optics.distortion)
    )
    return seen[:, 0]


@settings(max_examples=12)
@given(
    azimuth=st.floats(0.0, 360.0),
    tilt=st.floats(0.0, 15.0),
    roll=st.floats(-10.0, 10.0),
    optics=st.sampled_from([CameraOptics(), STRONG]),
)
def test_it_is_the_horizon_through_the_lens(
    world: World, azimuth: float, tilt: float, roll: float, optics: CameraOptics
) -> None:
    rotation = camera_in_world(azimuth, tilt, roll)
    rows = skyline_contour(world.surface, world.observer, optics, rotation, ALL_COLUMNS)
    u, v = projected_horizon(world, optics, rotation).T
    inside = (u > -30.0) & (u < 670.0) & (v > -60.0) & (v < 540.0)
    expected = np.interp(ALL_COLUMNS, u[inside], v[inside], left=np.nan, right=np.nan)
    found = np.isfinite(rows) & np.isfinite(expected)
    # the reference is interpolated between azimuths, which cuts the corners of ridges
    np.testing.assert_allclose(rows[found], expected[found], atol=0.02)
    well_inside = (expected > 0.0) & (expected < 479.0)
    assert np.isfinite(rows[well_inside]).all()


def test_columns_may_be_any_numbers(world: World) -> None:
    rotation = camera_in_world(40.0, 6.0, 2.0)
    columns = np.array([17.25, 300.0, 300.0, -0.5])
    rows = skyline_contour(world.surface, world.observer, CameraOptics(), rotation, columns)
    alone = [
        skyline_contour(world.surface, world.observer, CameraOptics(), rotation, np.array([u]))[0]
        for u in columns
    ]
    np.testing.assert_allclose(rows, alone, atol=0.002)


@pytest.mark.parametrize("tilt", [60.0, -40.0])
def test_a_skyline_out_of_the_frame_is_nan(world: World, tilt: float) -> None:
    rotation = camera_in_world(0.0, tilt, 0.0)
    assert np.isnan(
        skyline_contour(world.surface, world.observer, CameraOptics(), rotation, ALL_COLUMNS)
    ).all()


@given(u=st.floats(0.0, 639.0), v=st.floats(0.0, 479.0), optics=st.sampled_from([CameraOptics(), STRONG]))
def test_the_inverse_of_the_lens_is_inverse(u: float, v: float, optics: CameraOptics) -> None:
    intrinsics = np.array([optics.fx_px, optics.fy_px, optics.cx_px, optics.cy_px, *optics.distortion])
    x, y = undistorted(intrinsics, u, v)
    back, _ = cv2.projectPoints(
        np.array([[x, y, 1.0]]), np.zeros(3), np.zeros(3), matrix(optics), np.array(optics.distortion)
    )
    assert tuple(back.ravel()) == pytest.approx((u, v), abs=1e-7)
