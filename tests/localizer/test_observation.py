"""What the search refuses to be given."""

from dataclasses import replace

import numpy as np
import pytest

from localizer.bundle import Camera
from localizer.observation import NO_COMPASS_SIGMA_DEG, FrameObservation, Observation, PriorCircle

CAMERA = Camera(width_px=64, height_px=48, fx_px=60.0, fy_px=60.0, cx_px=31.5, cy_px=23.5)
FRAME = FrameObservation(
    "N", CAMERA, 0.0, 0.1, 5.0, 0.02, 0.0, 0.05, np.arange(5.0), np.full(5, 20.0), np.full(5, 0.5)
)
SCENE = Observation((FRAME,), 2.0, 1200.0, 5.0, 1.0, 0.02)


@pytest.mark.parametrize(
    "change",
    [
        {"sigma_px": np.zeros(5)},
        {"sigma_px": np.array([0.5, 0.5, 0.0, 0.5, 0.5])},
        {"sigma_px": np.full(5, np.inf)},
        {"sigma_px": np.full(5, -1.0)},
        {"sigma_px": np.full(4, 0.5)},
        {"v_px": np.full(5, np.nan)},
        {"u_px": np.full(5, np.inf)},
        {"u_px": np.arange(4.0)},
        {"u_px": np.zeros((5, 1)), "v_px": np.zeros((5, 1)), "sigma_px": np.ones((5, 1))},
        {"azimuth_deg": np.inf},
        {"roll_deg": np.nan},
        {"azimuth_sigma_deg": -0.1},
        {"tilt_sigma_deg": -0.1},
        {"tilt_deg": np.nan},
        {"roll_sigma_deg": -0.1},
        {"azimuth_sigma_deg": np.nan},
    ],
)
def test_points_and_angles_without_a_meaning_are_refused_by_the_frames_name(change):
    with pytest.raises(ValueError, match="frame N"):
        replace(FRAME, **change)


@pytest.mark.parametrize(
    "change",
    [
        {"altitude_sigma_m": 0.0},
        {"altitude_m": np.nan},
        {"altitude_m": np.inf},
        {"altitude_sigma_m": np.nan},
        {"tilt_bias_sigma_deg": -1.0},
        {"azimuth_bias_sigma_deg": np.nan},
        {"azimuth_bias_sigma_deg": -1.0},
        {"tilt_bias_sigma_deg": np.nan},
    ],
)
def test_readings_without_a_meaning_are_refused(change):
    with pytest.raises(ValueError, match="sigma"):
        replace(SCENE, **change)


def test_a_sensor_may_be_exact():
    replace(FRAME, azimuth_sigma_deg=0.0, tilt_sigma_deg=0.0, roll_sigma_deg=0.0)
    replace(SCENE, altitude_m=None, altitude_sigma_m=np.inf, azimuth_bias_sigma_deg=0.0)
    replace(SCENE, altitude_sigma_m=1e-3, tilt_bias_sigma_deg=0.0)


def test_180_degrees_say_that_there_is_no_compass():
    """As the format of a bundle has it."""
    assert NO_COMPASS_SIGMA_DEG == 180.0


@pytest.mark.parametrize(
    "circle",
    [
        (90.1, 0.0, 10.0),
        (-90.1, 0.0, 10.0),
        (np.nan, 0.0, 10.0),
        (0.0, np.inf, 10.0),
        (0.0, 0.0, 0.0),
        (0.0, 0.0, -1.0),
        (0.0, 0.0, np.inf),
        (0.0, 0.0, np.nan),
    ],
)
def test_a_circle_that_is_none_is_refused(circle):
    with pytest.raises(ValueError, match=r"^circle of .* m around .*radius above 0$"):
        PriorCircle(*circle)


def test_a_circle_may_lie_at_a_pole():
    assert PriorCircle(90.0, 500.0, 0.1).radius_m == 0.1
