"""Chips that another program has left in a state of its own, and chips that share an identity; on a virtual clock."""

import math
import time
from collections.abc import Callable

import numpy as np
import pytest
from fakes.clock import TRANSFER_S, FakeClock

from rig.devices.sensors import ms5611
from rig.devices.sensors.adxl355 import Adxl355
from rig.devices.sensors.bmp3 import Bmp3
from rig.devices.sensors.iis2iclx import Iis2iclx
from rig.devices.sensors.mmc5983ma import Mmc5983ma
from rig.devices.sensors.ms5611 import Coefficients, Ms5611
from rig.errors import WrongDeviceError
from sim.devices import adxl355 as fake_adxl355
from sim.devices import bmp3 as fake_bmp3
from sim.devices import iis2iclx as fake_iis2iclx
from sim.devices import mmc5983ma as fake_mmc5983ma
from sim.devices import ms5611 as fake_ms5611
from sim.devices.i2c_chip import I2cChip


@pytest.fixture(autouse=True)
def clock(monkeypatch: pytest.MonkeyPatch) -> FakeClock:
    return FakeClock(monkeypatch)


class Bus:
    """One simulated chip on a bus."""

    def __init__(self, chip: I2cChip) -> None:
        self._chip = chip

    def __str__(self) -> str:
        return "bus"

    def transfer(self, address: int, write: bytes, read_length: int) -> bytes:
        assert address == self._chip.address
        time.sleep(TRANSFER_S)
        return self._chip.transfer(write, read_length)

    def close(self) -> None:
        """Nothing to give back."""


def tilted(tilt_deg: float, roll_deg: float = 0.0) -> Callable[[], np.ndarray]:
    t, r = math.radians(tilt_deg), math.radians(roll_deg)
    up = np.array([-math.sin(r) * math.cos(t), math.sin(t), math.cos(r) * math.cos(t)])
    return lambda: up


def accelerometer(kind: type, up: Callable[[], np.ndarray]) -> I2cChip:
    chip: I2cChip = kind(up, lambda: 22.0, clock=time.monotonic, rng=np.random.default_rng(1))
    return chip


def write(chip: I2cChip, *registers: tuple[int, int]) -> None:
    for register, value in registers:
        chip.transfer(bytes([register, value]), 0)


@pytest.mark.parametrize("tilt_deg", [0.0, 14.7, -30.0])
def test_a_relative_of_the_iis2iclx_with_its_identity_is_refused(tilt_deg: float) -> None:
    chip = accelerometer(fake_iis2iclx.Ism330dhcx, tilted(tilt_deg, 5.0))
    with pytest.raises(WrongDeviceError, match=r"third axis, .* ISM330DHCX, LSM6DSR or ASM330LHH, .*0x6B"):
        Iis2iclx(Bus(chip))


@pytest.mark.parametrize("tilt_deg", [0.0, 14.7, -14.7, 45.0])
def test_an_iis2iclx_is_none_at_any_tilt(tilt_deg: float) -> None:
    chip = Iis2iclx(Bus(accelerometer(fake_iis2iclx.Iis2iclx, tilted(tilt_deg))))
    assert math.degrees(math.asin(chip.read().y_g)) == pytest.approx(tilt_deg, abs=0.1)


@pytest.mark.parametrize("left_range", [0x01, 0x02, 0x03])
def test_an_adxl357_which_has_the_identity_of_the_adxl355_is_refused(left_range: int) -> None:
    chip = accelerometer(fake_adxl355.Adxl357, tilted(20.0))
    write(chip, (0x2C, left_range), (0x2D, 0x00))
    with pytest.raises(WrongDeviceError, match=r"shows gravity as 0\.200 g, in the scale of an ADXL357"):
        Adxl355(Bus(chip))


IIS_LEFT = {
    "the embedded functions' registers": [(0x01, 0x80)],
    "the sensor hub's registers": [(0x01, 0x40)],
    "another range and rate": [(0x10, 0x74)],
    "offsets of the user": [(0x73, 0x40), (0x74, 0xC0), (0x15, 0x08), (0x16, 0x02)],
    "the self-test": [(0x14, 0x01), (0x10, 0x38)],
    "the high-pass": [(0x17, 0x04), (0x10, 0x38)],
    "no auto-increment": [(0x12, 0x00)],
}


@pytest.mark.parametrize("left", IIS_LEFT.values(), ids=IIS_LEFT)
def test_an_iis2iclx_measures_right_whatever_was_left_on(left: list[tuple[int, int]]) -> None:
    chip = accelerometer(fake_iis2iclx.Iis2iclx, tilted(10.0))
    write(chip, *left)
    assert math.degrees(math.asin(Iis2iclx(Bus(chip)).read().y_g)) == pytest.approx(10.0, abs=0.1)


ADXL_LEFT = {
    "another range": [(0x2C, 0x83), (0x2D, 0x00)],
    "offsets": [(0x1E, 0x10), (0x20, 0xE0), (0x22, 0x7F), (0x2D, 0x00)],
    "the high-pass": [(0x28, 0x36), (0x2D, 0x00)],
    "the self-test": [(0x2E, 0x03), (0x2D, 0x00)],
    "the thermometer off": [(0x2D, 0x02)],
    "a slow filter": [(0x28, 0x0A), (0x2D, 0x00)],
}


@pytest.mark.parametrize("left", ADXL_LEFT.values(), ids=ADXL_LEFT)
def test_an_adxl355_measures_right_whatever_was_left_on(left: list[tuple[int, int]]) -> None:
    chip = accelerometer(fake_adxl355.Adxl355, tilted(10.0))
    write(chip, *left)
    reading = Adxl355(Bus(chip)).read()
    assert reading.y_g == pytest.approx(math.sin(math.radians(10.0)), abs=2e-3)
    assert reading.temperature_c == pytest.approx(22.0, abs=0.5)


MMC_LEFT = {
    "measuring by itself": [(0x0A, 0x03), (0x0B, 0x0F), (0x09, 0x20)],
    "axes switched off": [(0x0A, 0x1C)],
    "a wide band": [(0x0A, 0x03)],
}


@pytest.mark.parametrize("left", MMC_LEFT.values(), ids=MMC_LEFT)
def test_an_mmc5983ma_measures_right_whatever_was_left_on(left: list[tuple[int, int]]) -> None:
    field = np.array([20.0, -15.0, 40.0])
    chip = fake_mmc5983ma.Mmc5983ma(
        lambda: field, lambda: 22.0, clock=time.monotonic, rng=np.random.default_rng(1)
    )
    time.sleep(0.02)
    write(chip, *left)
    reading = Mmc5983ma(Bus(chip)).read()
    assert (reading.x_ut, reading.y_ut, reading.z_ut) == pytest.approx(tuple(field), abs=0.5)


BMP_LEFT = {
    "measuring by itself, filtered": [(0x1C, 0x00), (0x1F, 0x0E), (0x1D, 0x02), (0x1B, 0x33)],
    "no thermometer": [(0x1B, 0x31)],
    "the coarsest": [(0x1C, 0x00)],
}


@pytest.mark.parametrize("left", BMP_LEFT.values(), ids=BMP_LEFT)
def test_a_bmp390_measures_right_whatever_was_left_on(left: list[tuple[int, int]]) -> None:
    pressure_pa = [101_000.0]
    chip = fake_bmp3.Bmp3(
        "bmp390", lambda: pressure_pa[0], lambda: 22.0, clock=time.monotonic, rng=np.random.default_rng(1)
    )
    time.sleep(0.012)
    write(chip, *left)
    time.sleep(0.05)
    pressure_pa[0] = 95_000.0
    assert Bmp3(Bus(chip)).read().pressure_hpa == pytest.approx(950.0, abs=0.2)


def barometer(kind: type[fake_ms5611.Ms5611], pressure_hpa: float, temperature_c: float = 22.0) -> I2cChip:
    return kind(
        lambda: 100.0 * pressure_hpa,
        lambda: temperature_c,
        clock=time.monotonic,
        rng=np.random.default_rng(1),
        noise_pa=0.5,
    )


def test_ms5607_compensation_is_that_of_the_data_sheets_example() -> None:
    coefficients = Coefficients(46372, 43981, 29059, 27842, 31553, 28165)
    assert ms5611.compensate(coefficients, 6465444, 8077636, "ms5607") == (110002, 2000)


@pytest.mark.parametrize("temperature_c", [22.0, 5.0, -25.0])
def test_an_ms5607_reads_pressure_and_temperature(temperature_c: float) -> None:
    sensor = Ms5611(Bus(barometer(fake_ms5611.Ms5607, 946.0, temperature_c)), model="ms5607")
    reading = sensor.read()
    assert reading.pressure_hpa == pytest.approx(946.0, abs=0.1)
    assert reading.temperature_c == pytest.approx(temperature_c, abs=0.05)
    assert sensor.identify() == "MS5607 at 0x77 on bus"


def test_an_ms5607_read_as_an_ms5611_gives_half_the_pressure() -> None:
    """Which the chip itself cannot tell; where it is, does."""
    assert Ms5611(Bus(barometer(fake_ms5611.Ms5607, 946.0))).read().pressure_hpa == pytest.approx(
        473.0, abs=15.0
    )
