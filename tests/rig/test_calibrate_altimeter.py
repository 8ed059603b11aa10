"""The reference pressure is believed where it is steady and can be that of the altitude; trust in it fades."""

from datetime import UTC, datetime, timedelta

import pytest

from rig.calibrate.altimeter import KnownAltitude, fit_pressure
from rig.calibration import CalibrationError
from rig.config import I2cAltimeterSection
from rig.measure import MeanPressure, altitude_from
from rig.readings import PressureReading

NOON = datetime(2026, 11, 24, 12, tzinfo=UTC)


def readings(pressures_hpa: list[float]) -> list[PressureReading]:
    return [PressureReading(p, 20.0, float(i), NOON) for i, p in enumerate(pressures_hpa)]


def test_a_steady_pressure_is_the_reference() -> None:
    fit = fit_pressure(readings([954.6, 954.61, 954.59, 954.6]), KnownAltitude(500.0, 1.5))
    assert fit.pressure_hpa == pytest.approx(954.6)
    assert fit.sigma_m == pytest.approx(1.5, abs=0.01)


def test_the_wrong_altitude_and_a_gust_are_refused() -> None:
    with pytest.raises(CalibrationError, match="is not the air of 1900 m"):
        fit_pressure(readings([954.6] * 4), KnownAltitude(1900.0, 1.5))
    with pytest.raises(CalibrationError, match=r"changed by .* m while it was read"):
        fit_pressure(readings([954.6, 954.6, 955.2, 955.2]), KnownAltitude(500.0, 1.5))


@pytest.mark.parametrize(("hours", "sigma_m"), [(0.0, 1.5), (1.0, (1.5**2 + 4.0**2) ** 0.5), (-1.0, 4.272)])
def test_trust_fades_with_time(hours: float, sigma_m: float) -> None:
    section = I2cAltimeterSection(
        kind="bmp390", bus="/dev/i2c-1", address=0x76, reference_pressure_hpa=954.6, reference_altitude_m=500.0,
        sigma_m=1.5, reference_time=NOON, drift_m_h=4.0,
    )  # fmt: skip
    read = altitude_from(MeanPressure("b", NOON + timedelta(hours=hours), 954.6, 0.0, 20.0, 10), section)
    assert read.altitude_m == pytest.approx(500.0)
    assert read.sigma_m == pytest.approx(sigma_m, abs=1e-3)
