"""What the search refuses to be given."""

from dataclasses import replace

import numpy as np
import pytest

from localizer.bundle import Camera
from localizer.observation import FrameObservation, Observation

CAMERA = Camera(width_px=64, height_px=48, fx_px=60.0, fy_px=60.0, cx_px=31.5, cy_px=23.5)
FRAME = FrameObservation(
    "N", CAMERA, 0.0, 0.1, 5.0, 0.02, 0.0, 0.05, np.arange(5.0), np.full(5, 20.0), np.full(5, 0.5)
)
SCENE = Observation((FRAME,), 2.0, 1200.0, 5.0, 1.0, 0.02)


@pytest.mark.parametrize(
    "change",
    [
        {"sigma_px": np.zeros(5)},
        {"sigma_px": np.full(5, np.inf)},
        {"sigma_px": np.full(5, -1.0)},
        {"sigma_px": np.full(4, 0.5)},
        {"v_px": np.full(5, np.nan)},
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
