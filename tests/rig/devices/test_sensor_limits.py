"""What a chip may measure and what it cannot have measured: each limit of the data sheets from both sides.

The chips are the simulator's, on a virtual clock.
"""

import math
import re

import numpy as np
import pytest
from fakes.clock import FakeClock, TimedBus

from rig.devices.sensors.adxl355 import Adxl355
from rig.devices.sensors.bmp3 import Bmp3
from rig.devices.sensors.iis2iclx import Iis2iclx
from rig.devices.sensors.mmc5983ma import Mmc5983ma
from rig.devices.sensors.ms5611 import Ms5611
from rig.errors import DeviceError, TransientError, WrongDeviceError
from sim.devices import adxl355 as fake_adxl355
from sim.devices import bmp3 as fake_bmp3
from sim.devices import iis2iclx as fake_iis2iclx
from sim.devices import mmc5983ma as fake_mmc5983ma
from sim.devices import ms5611 as fake_ms5611


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> FakeClock:
    return FakeClock(monkeypatch)


def bmp3_at(clock: FakeClock, pressure_pa: float, temperature_c: float) -> fake_bmp3.Bmp3:
    rng = np.random.default_rng(1)
    return fake_bmp3.Bmp3("bmp390", lambda: pressure_pa, lambda: temperature_c, clock=clock, rng=rng)


def ms5611_at(clock: FakeClock, pressure_pa: float, temperature_c: float) -> fake_ms5611.Ms5611:
    rng = np.random.default_rng(1)
    return fake_ms5611.Ms5611(lambda: pressure_pa, lambda: temperature_c, clock=clock, rng=rng)


@pytest.mark.parametrize(
    ("chip", "driver", "highest_pa"), [(bmp3_at, Bmp3, 125_000.0), (ms5611_at, Ms5611, 120_000.0)]
)
def test_a_barometer_measures_300_hpa_and_more_between_minus_40_and_85_degrees(
    clock: FakeClock, chip: type, driver: type, highest_pa: float
) -> None:
    for pressure_pa, temperature_c in [
        (30_050.0, 22.0),
        (highest_pa - 50.0, 22.0),
        (95_000.0, -39.5),
        (95_000.0, 84.5),
    ]:
        reading = driver(TimedBus(chip(clock, pressure_pa, temperature_c), clock)).read()
        assert reading.pressure_hpa == pytest.approx(pressure_pa / 100.0, abs=0.1)
        assert reading.temperature_c == pytest.approx(temperature_c, abs=0.05)
    for pressure_pa, temperature_c, said in [
        (29_900.0, 22.0, "299 hPa at 22 °C"),
        (highest_pa + 100.0, 22.0, f"{highest_pa / 100 + 1:.0f} hPa at 22 °C"),
        (95_000.0, -40.6, "950 hPa at -41 °C"),
        (95_000.0, 85.6, "950 hPa at 86 °C"),
    ]:
        sensor = driver(TimedBus(chip(clock, pressure_pa, temperature_c), clock))
        with pytest.raises(TransientError, match=f"implausible reading: {said}"):
            sensor.read()


class Changed(TimedBus):
    """A chip of whose registers one reads as given."""

    def __init__(self, chip: object, clock: FakeClock, register: int, content: bytes) -> None:
        super().__init__(chip, clock)  # type: ignore[arg-type]
        self._register = register
        self._content = content

    def transfer(self, address: int, write: bytes, read_length: int) -> bytes:
        answer = super().transfer(address, write, read_length)
        return self._content if write == bytes([self._register]) and read_length else answer


@pytest.mark.parametrize(
    ("errors", "said"),
    [
        (0x01, "reports a fatal error"),
        (0x02, "reports a command error"),
        (0x04, "reports a configuration error"),
        (0x06, "reports a command error and a configuration error"),
        (0xF8, None),
    ],
)
def test_each_error_of_a_bmp390_is_named(clock: FakeClock, errors: int, said: str | None) -> None:
    sensor = Bmp3(Changed(bmp3_at(clock, 95_000.0, 22.0), clock, 0x02, bytes([errors])))
    if said is None:
        assert sensor.read().pressure_hpa == pytest.approx(950.0, abs=0.1)
        return
    with pytest.raises(DeviceError, match=re.escape(said) + ";"):
        sensor.read()


def adxl_at(clock: FakeClock, up: tuple[float, float, float], temperature_c: float = 22.0) -> TimedBus:
    rng = np.random.default_rng(1)
    vector = np.array(up) / (3.9e-6 * 256_000)  # the driver takes a count for 3.9 ug
    chip = fake_adxl355.Adxl355(lambda: vector, lambda: temperature_c, clock=clock, rng=rng)
    return TimedBus(chip, clock)


@pytest.mark.parametrize("direction", [(1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.36, 0.48, 0.8)])
@pytest.mark.parametrize(("size_g", "is_gravity"), [(0.49, False), (0.51, True), (1.49, True), (1.51, False)])
def test_the_adxl355_at_rest_measures_half_to_one_and_a_half_g(
    clock: FakeClock, direction: tuple[float, float, float], size_g: float, is_gravity: bool
) -> None:
    x, y, z = (size_g * part for part in direction)
    sensor = Adxl355(adxl_at(clock, (x, y, z)))
    if is_gravity:
        reading = sensor.read()
        assert (reading.x_g, reading.y_g, reading.z_g) == pytest.approx((x, y, z), abs=0.001)
        return
    with pytest.raises(TransientError, match=rf"implausible reading: {size_g:.2f} g in all"):
        sensor.read()


@pytest.mark.parametrize(
    ("size_g", "is_another"), [(0.178, False), (0.182, True), (0.218, True), (0.222, False)]
)
def test_a_fifth_of_gravity_on_the_adxl355_is_an_adxl357(
    clock: FakeClock, size_g: float, is_another: bool
) -> None:
    """51,200 counts to 1 g instead of 256,000; a tenth to either side."""
    bus = adxl_at(clock, (0.0, 0.6 * size_g, 0.8 * size_g))
    if is_another:
        with pytest.raises(WrongDeviceError, match="in the scale of an ADXL357"):
            Adxl355(bus)
    else:
        Adxl355(bus)


@pytest.mark.parametrize(
    ("temperature_c", "is_possible"), [(-41.0, False), (-39.0, True), (124.0, True), (126.0, False)]
)
def test_the_adxl355_works_between_minus_40_and_125_degrees(
    clock: FakeClock, temperature_c: float, is_possible: bool
) -> None:
    sensor = Adxl355(adxl_at(clock, (0.0, 0.0, 1.0), temperature_c))
    if is_possible:
        assert sensor.read().temperature_c == pytest.approx(temperature_c, abs=0.6)
        assert not math.isnan(sensor.read(without_temperature=True).temperature_c)
        return
    with pytest.raises(TransientError, match=rf"implausible reading: {temperature_c:.0f} °C"):
        sensor.read()
    assert math.isnan(sensor.read(without_temperature=True).temperature_c)


def test_the_adxl355_is_reset_five_times_at_most(clock: FakeClock) -> None:
    class Forgetful(TimedBus):
        """Its trim is another one after each reset."""

        def transfer(self, address: int, write: bytes, read_length: int) -> bytes:
            answer = super().transfer(address, write, read_length)
            return bytes([len(self.writes)] * 5) if write == b"\x50" else answer

    bus = adxl_at(clock, (0.0, 0.0, 1.0))
    bus.__class__ = Forgetful
    with pytest.raises(DeviceError, match="loses its factory trim when it is reset"):
        Adxl355(bus)
    assert bus.writes == [bytes([0x2F, 0x52])] * 5


def iis_at(
    clock: FakeClock, up: tuple[float, float, float], temperature_c: float = 22.0, three_axes: bool = False
) -> TimedBus:
    kind = fake_iis2iclx.Ism330dhcx if three_axes else fake_iis2iclx.Iis2iclx
    vector = np.array(up)
    return TimedBus(
        kind(lambda: vector, lambda: temperature_c, clock=clock, rng=np.random.default_rng(1)), clock
    )


@pytest.mark.parametrize(
    ("x_g", "y_g", "is_possible"),
    [
        (0.99, 0.0, True),
        (0.0, -0.99, True),
        (1.01, 0.0, False),
        (0.0, -1.01, False),
        (0.84, 0.84, True),  # hypot 1.188
        (-0.86, 0.86, False),  # 1.216
    ],
)
def test_the_iis2iclx_at_rest_measures_1_g_at_most(
    clock: FakeClock, x_g: float, y_g: float, is_possible: bool
) -> None:
    sensor = Iis2iclx(iis_at(clock, (x_g, y_g, 0.0)))
    if is_possible:
        reading = sensor.read()
        assert (reading.x_g, reading.y_g) == pytest.approx((x_g, y_g), abs=0.001)
        return
    with pytest.raises(TransientError, match=rf"implausible reading: {x_g:.2f} g and {y_g:.2f} g"):
        sensor.read()


@pytest.mark.parametrize(
    ("temperature_c", "is_possible"), [(-40.5, False), (-39.5, True), (104.5, True), (105.5, False)]
)
def test_the_iis2iclx_works_between_minus_40_and_105_degrees(
    clock: FakeClock, temperature_c: float, is_possible: bool
) -> None:
    sensor = Iis2iclx(iis_at(clock, (0.1, 0.2, 0.97), temperature_c))
    if is_possible:
        assert sensor.read().temperature_c == pytest.approx(temperature_c, abs=0.01)
        return
    with pytest.raises(TransientError, match=r"implausible reading: -?\d+ °C"):
        sensor.read()
    assert math.isnan(sensor.read(without_temperature=True).temperature_c)


@pytest.mark.parametrize(
    ("up", "is_another"),
    [
        ((0.0, 0.0, 0.91), True),
        ((0.0, 0.0, 1.09), True),
        ((0.0, 0.0, 0.89), False),
        ((0.0, 0.0, 1.11), False),
        ((0.66, 0.66, 0.31), True),
        ((0.67, 0.67, 0.29), False),  # a head is not tilted so far
        ((-0.6, 0.0, -0.8), True),
    ],
)
def test_a_third_axis_with_gravity_is_a_relative_of_the_iis2iclx(
    clock: FakeClock, up: tuple[float, float, float], is_another: bool
) -> None:
    """Its count is 0.122 mg at the setting where this chip's is 0.031 (data sheet ISM330DHCX, 4.1)."""
    bus = iis_at(clock, up, three_axes=True)
    if is_another:
        with pytest.raises(WrongDeviceError, match="has a third axis"):
            Iis2iclx(bus)
    else:
        Iis2iclx(bus)


def mmc_at(clock: FakeClock, field_ut: tuple[float, float, float], temperature_c: float = 22.0) -> TimedBus:
    field = np.array(field_ut)
    rng = np.random.default_rng(1)
    return TimedBus(
        fake_mmc5983ma.Mmc5983ma(lambda: field, lambda: temperature_c, clock=clock, rng=rng), clock
    )


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_mmc5983ma_measures_to_8_gauss(clock: FakeClock, axis: int, sign: float) -> None:
    field_ut = [20.0, 20.0, 20.0]
    field_ut[axis] = sign * 799.0
    reading = Mmc5983ma(mmc_at(clock, tuple(field_ut))).read()
    assert (reading.x_ut, reading.y_ut, reading.z_ut) == pytest.approx(field_ut, abs=0.2)
    field_ut[axis] = sign * 801.0
    sensor = Mmc5983ma(mmc_at(clock, tuple(field_ut)))
    with pytest.raises(TransientError, match=r"a field beyond ±8 G; is a magnet near\?"):
        sensor.read()


@pytest.mark.parametrize(
    ("temperature_c", "is_possible"), [(-41.0, False), (-39.0, True), (104.0, True), (106.0, False)]
)
def test_the_mmc5983ma_works_between_minus_40_and_105_degrees(
    clock: FakeClock, temperature_c: float, is_possible: bool
) -> None:
    found_c = Mmc5983ma(mmc_at(clock, (20.0, 0.0, 40.0), temperature_c)).read().temperature_c
    assert found_c == (pytest.approx(temperature_c, abs=0.5) if is_possible else None)


def test_an_ms5611_is_told_from_a_bmp3_by_what_register_0_holds(clock: FakeClock) -> None:
    for identity, named in ((0x60, "BMP390"), (0x50, "BMP388")):
        bus = Changed(ms5611_at(clock, 95_000.0, 22.0), clock, 0x00, bytes([identity]))
        with pytest.raises(WrongDeviceError, match=f"is a {named}, which has the same addresses"):
            Ms5611(bus)
    for reading in (0x00, 0x51, 0x61):
        bus = Changed(ms5611_at(clock, 95_000.0, 22.0), clock, 0x00, bytes([reading]))
        sensor = Ms5611(bus)
        with pytest.raises(TransientError, match="gave 1 of 3 bytes"):
            sensor.read()
