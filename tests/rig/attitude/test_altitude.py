"""Altitude from pressure."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.attitude.altitude import PressureReference, altitude_m, metres_per_hpa, plausible_altitude_m
from rig.errors import DeviceError

STANDARD = PressureReference(1013.25, 0.0)


def test_golden_value_of_the_standard_atmosphere() -> None:
    golden = altitude_m(1008.760063, PressureReference(1019.1314, 0.0))
    assert golden == pytest.approx(86.1908, abs=1e-3)


@pytest.mark.parametrize(
    ("pressure_hpa", "altitude"), [(898.745, 1000.0), (701.085, 3000.0), (540.199, 5000.0)]
)
def test_table_of_the_standard_atmosphere(pressure_hpa: float, altitude: float) -> None:
    # ISO 2533, geopotential altitudes.
    assert altitude_m(pressure_hpa, STANDARD) == pytest.approx(altitude, abs=0.5)


def test_one_hectopascal_at_sea_level() -> None:
    assert metres_per_hpa(1013.25, STANDARD) == pytest.approx(8.32, abs=0.01)


@given(st.floats(0.0, 3000.0), st.floats(600.0, 1050.0))
def test_a_reference_in_the_same_air_gives_the_same_altitude(reference_m: float, pressure_hpa: float) -> None:
    ratio = 1.0 - reference_m * 0.0065 / 288.15
    there = PressureReference(1013.25 * ratio ** (1 / 0.190263), reference_m)
    assert altitude_m(pressure_hpa, there) == pytest.approx(altitude_m(pressure_hpa, STANDARD), abs=1e-6)


def test_warm_air_is_thicker() -> None:
    warm = PressureReference(1013.25, 0.0, temperature_c=30.0)
    assert altitude_m(850.0, warm) / altitude_m(850.0, STANDARD) == pytest.approx(303.15 / 288.15)


@given(st.floats(500.0, 1050.0), st.floats(-20.0, 40.0))
def test_the_slope_is_that_of_air_in_balance(pressure_hpa: float, temperature_c: float) -> None:
    """R T / (g p) of dry air in balance: R = 287.05287 J/(kg K), g = 9.80665 m/s^2 (ISO 2533)."""
    air = PressureReference(1000.0, 200.0, temperature_c)
    exponent = 287.05287 * 0.0065 / 9.80665
    air_k = (temperature_c + 273.15) * (pressure_hpa / 1000.0) ** exponent
    assert metres_per_hpa(pressure_hpa, air) == pytest.approx(
        287.05287 * air_k / (9.80665 * pressure_hpa), rel=1e-5
    )


@pytest.mark.parametrize(
    ("pressure_hpa", "altitude", "is_plausible"),
    [
        (1071.0, -470.0, True),  # below the shore of the Dead Sea, -430 m
        (1077.0, -517.6, False),
        (314.5, 8846.7, True),  # Everest, 8849 m
        (306.0, 9031.2, False),
    ],
)
def test_ground_lies_between_minus_500_and_9000_m(
    pressure_hpa: float, altitude: float, is_plausible: bool
) -> None:
    """Altitudes by 288.15 / 0.0065 (1 - (p / 1013.25)^(1 / 5.25588))."""
    if is_plausible:
        assert plausible_altitude_m(pressure_hpa, STANDARD, "bmp390") == pytest.approx(altitude, abs=0.5)
        return
    with pytest.raises(
        DeviceError, match=rf"bmp390: {pressure_hpa} hPa would be an altitude of {altitude:.0f} m"
    ):
        plausible_altitude_m(pressure_hpa, STANDARD, "bmp390")


def test_a_wrong_reference_is_noticed() -> None:
    with pytest.raises(
        DeviceError, match=r"bmp390: 300\.0 hPa would be an altitude of 9\d\d\d m; check \[altimeter\]"
    ):
        plausible_altitude_m(300.0, STANDARD, "bmp390")
    assert plausible_altitude_m(1013.25, STANDARD, "bmp390") == 0.0
