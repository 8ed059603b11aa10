"""The correction undoes ``measured = zero + drift (T - T0) + scale (R^T up)``, written out here."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from rig.attitude.accelerometer import NO_CORRECTION, AccelerometerCorrection
from rig.config.sections import InclinometerSection

ERRORS = AccelerometerCorrection(
    zero_mg=(21.0, -17.0, 8.0),
    scale=(1.004, 0.996, 1.002),
    mounting_deg=(1.8, -2.4, 1.1),
    drift_mg_c=(0.15, -0.1, 0.05),
    zero_temperature_c=18.0,
)


def measured_g(up: np.ndarray, temperature_c: float) -> np.ndarray:
    """What a chip with these errors measures of a direction up in the head's axes."""
    zero_g = np.array([0.021, -0.017, 0.008]) + np.array([0.15e-3, -0.1e-3, 0.05e-3]) * (temperature_c - 18.0)
    turn = Rotation.from_rotvec([1.8, -2.4, 1.1], degrees=True).as_matrix()
    return np.asarray(zero_g + np.array([1.004, 0.996, 1.002]) * (turn.T @ up))


@given(st.floats(-60.0, 60.0), st.floats(-60.0, 60.0), st.floats(-30.0, 60.0))
def test_all_errors_of_a_chip_go(tilt_deg: float, roll_deg: float, temperature_c: float) -> None:
    t, r = np.radians([tilt_deg, roll_deg])
    up = np.array([-np.sin(r) * np.cos(t), np.sin(t), np.cos(r) * np.cos(t)])
    found = ERRORS.up_in_head(np.array([measured_g(up, temperature_c)]), temperature_c)
    assert found[0] == pytest.approx(up, abs=1e-9)


@pytest.mark.parametrize(("temperature_c", "y_g"), [(38.0, 0.003), (18.0, 0.0), (8.0, -0.0015)])
def test_a_zero_that_rises_as_it_warms_is_taken_off(temperature_c: float, y_g: float) -> None:
    """0.15 mg to the degree from 18 degrees on: 3 mg at 38, 0.17 deg of tilt."""
    drifting = AccelerometerCorrection(drift_mg_c=(0.0, 0.15, 0.0), zero_temperature_c=18.0)
    found = drifting.up_in_head(np.array([[0.0, y_g, 1.0]]), temperature_c)
    assert found[0] == pytest.approx([0.0, 0.0, 1.0], abs=1e-12)


def test_a_chip_without_a_thermometer_is_taken_to_be_as_warm_as_when_it_was_calibrated() -> None:
    up = np.array([0.0, 0.0, 1.0])
    found = ERRORS.up_in_head(np.array([measured_g(up, 18.0)]), np.nan)
    assert found[0] == pytest.approx(up, abs=1e-9)


@pytest.mark.parametrize("temperature_c", [-30.0, 20.0, 60.0])
def test_without_a_correction_nothing_changes(temperature_c: float) -> None:
    vectors = np.array([[0.1, -0.2, 0.9], [0.6, 0.0, 0.8]])
    assert NO_CORRECTION.up_in_head(vectors, temperature_c) == pytest.approx(vectors, abs=1e-15)
    drifting = AccelerometerCorrection(drift_mg_c=(1.0, 0.0, 0.0))
    found = drifting.up_in_head(vectors, temperature_c)
    assert found[:, 0] == pytest.approx(vectors[:, 0] - 0.001 * (temperature_c - 20.0)), "from 20 degrees on"


def test_the_third_axis_of_a_chip_of_two_makes_the_length_1_g() -> None:
    found = NO_CORRECTION.up_in_head(
        np.array([[0.6, 0.0, np.nan], [0.48, 0.64, np.nan], [0.6, 0.0, 0.7]]), 20.0
    )
    assert found == pytest.approx(np.array([[0.6, 0.0, 0.8], [0.48, 0.64, 0.6], [0.6, 0.0, 0.7]]))
    beyond = NO_CORRECTION.up_in_head(np.array([[0.8, 0.61, np.nan], [1.0, 0.0, np.nan]]), 20.0)
    assert np.isnan(beyond[:, 2]).all(), "that is not gravity"


def test_the_configuration_is_taken_key_by_key() -> None:
    section = InclinometerSection(
        chip="adxl355",
        bus="/dev/i2c-1",
        address=0x1D,
        axes=("+x", "+y", "+z"),
        zero_mg=(21.0, -17.0, 8.0),
        scale=(1.004, 0.996, 1.002),
        mounting_deg=(1.8, -2.4, 1.1),
        drift_mg_c=(0.15, -0.1, 0.05),
        zero_temperature_c=18.0,
    )
    assert AccelerometerCorrection.from_section(section) == ERRORS
