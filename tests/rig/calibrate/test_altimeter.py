"""The reference pressure is believed where it is steady and can be that of the altitude; trust in it fades."""

from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from rig.calibrate.altimeter import KnownAltitude, fit_pressure
from rig.capture.averaged_readings import MeanPressure, altitude_from
from rig.clock import Instant
from rig.config.calibration_files import CalibrationError
from rig.config.sections import I2cAltimeterSection, SerialAltimeterSection
from rig.devices.readings import PressureReading
from rig.devices.sensors.nmea import parse_pressure, parse_sentence
from rig.fault_notes import collecting

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


B01 = Path(__file__).parents[2] / "logs" / "nmea" / "b01-xdr-two-decimals.nmea"


def test_the_step_of_what_a_talker_sends_is_in_the_sigma() -> None:
    """Two decimals of bar are 85 m: a rounded value scatters by nothing, and is that much worse."""
    section = SerialAltimeterSection(
        kind="nmea",
        port="/dev/ttyUSB0",
        reference_pressure_hpa=1013.25,
        reference_altitude_m=0.0,
        sigma_m=5.0,
    )
    reading = parse_pressure(parse_sentence(B01.read_bytes()), Instant(0.0, NOON))
    assert reading is not None
    rough = altitude_from(
        MeanPressure("b", NOON, reading.pressure_hpa, 0.0, None, 10, reading.resolution_hpa), section
    )
    assert rough.sigma_m == pytest.approx(25.2, abs=0.5)
    assert rough.raw["resolution_hpa"] == 10.0
    fine = altitude_from(MeanPressure("b", NOON, 968.7, 0.0, None, 10, 0.1), section)
    assert fine.sigma_m == pytest.approx(5.0, abs=0.02)
    fit = fit_pressure([reading] * 4, KnownAltitude(360.0, 1.0))
    assert fit.sigma_m == pytest.approx(25.0, abs=1.0), "a reference of such steps is no better"


def test_a_clock_that_is_wrong_leaves_the_altitude_as_unsure_as_the_weather() -> None:
    section = I2cAltimeterSection(
        kind="bmp390", bus="/dev/i2c-1", address=0x76, reference_pressure_hpa=954.6, reference_altitude_m=500.0,
        sigma_m=1.5, reference_time=NOON, drift_m_h=4.0,
    )  # fmt: skip
    with collecting() as faults:
        read = altitude_from(
            MeanPressure("b", datetime(1970, 1, 1, 0, 2, tzinfo=UTC), 954.6, 0.0, 20.0, 10), section
        )
    assert read.sigma_m == pytest.approx(150.0, abs=0.1)
    assert [note.problem for note in faults.all()] == ["the computer's clock says 1970-01-01 00:02 UTC"]
