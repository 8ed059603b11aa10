"""ADXL355 and IIS2ICLX on register files: golden vectors, set-up, data-ready, readings that cannot be."""

import math
import struct
import time
from collections.abc import Iterator

import pytest
from fakes.chips import FakeI2cBus, RegisterChip
from fakes.clock import FakeClock
from hypothesis import given
from hypothesis import strategies as st

from rig.attitude.accelerometer import AccelerometerCorrection
from rig.attitude.level import head_level
from rig.devices.sensors import adxl355, iis2iclx
from rig.devices.sensors.adxl355 import Adxl355
from rig.devices.sensors.iis2iclx import Iis2iclx
from rig.errors import DeviceError, TransientError, WrongDeviceError
from rig.fault_notes import collecting


@pytest.fixture(autouse=True)
def clock(monkeypatch: pytest.MonkeyPatch) -> FakeClock:
    return FakeClock(monkeypatch)


@pytest.mark.parametrize(
    ("data", "counts"),
    [
        ("00 00 10", 1),
        ("7F FF F0", 524287),
        ("80 00 00", -524288),
        ("FF FF F0", -1),
        ("3E 99 A0", 256410),
        ("FF C1 80", -1000),
    ],
)
def test_adxl355_counts_are_those_of_the_test_vectors(data, counts):
    assert adxl355.decode_axis(bytes.fromhex(data)) == counts


@pytest.mark.parametrize(
    ("data", "temperature_c"), [("07 5D", 25.0), ("F7 5D", 25.0), ("0F FF", -219.199), ("00 00", 233.287)]
)
def test_adxl355_temperature_is_that_of_the_test_vectors(data, temperature_c):
    assert adxl355.decode_temperature_c(bytes.fromhex(data)) == pytest.approx(temperature_c, abs=1e-3)


@given(st.integers(-524288, 524287), st.integers(0, 15))
def test_adxl355_counts_survive_the_registers_whatever_the_reserved_bits(counts, reserved):
    assert adxl355.decode_axis(((counts << 4 | reserved) & 0xFFFFFF).to_bytes(3, "big")) == counts


def test_iis2iclx_acceleration_is_that_of_the_vendors_driver():
    acceleration_g = iis2iclx.decode_acceleration_g(struct.pack("<h", -1000), 0.5)
    assert acceleration_g == pytest.approx(-15.0e-3)
    assert math.degrees(math.asin(acceleration_g)) == pytest.approx(-0.85947, abs=1e-5)


@pytest.mark.parametrize(("range_g", "g"), [(0.5, 0.015), (1.0, 0.031), (2.0, 0.061), (3.0, 0.122)])
def test_iis2iclx_sensitivities(range_g, g):
    assert iis2iclx.decode_acceleration_g(struct.pack("<h", 1000), range_g) == pytest.approx(g)


def test_iis2iclx_temperature():
    assert iis2iclx.decode_temperature_c(b"\x00\x01") == 26.0


class FakeAdxl355(RegisterChip):
    """Converts every 5 ms while it measures; each sample differs from the last by one count of x."""

    def __init__(self) -> None:
        super().__init__(on_write=self._written, on_read=self._convert)
        self.put(0x00, b"\xad\x1d\xed\x01")
        self.put(0x50, b"\x11\x22\x33\x44\x55")
        self.bad_resets = 0
        self.raw_g = (0.1, -0.2, 0.97)
        self.raw_temperature = 1885
        self.dither = 1
        self.frozen = False
        self.measuring = False
        self._next_s = 0.0
        self._count = 0

    def _written(self, register: int, value: int) -> None:
        if register == 0x2F and value == 0x52:
            self.bad_resets -= 1
            self.registers[0x50] = 0xEE if self.bad_resets >= 0 else 0x11
        if register == 0x2D:
            self.measuring = value == 0x00
            self._next_s = time.monotonic() + 0.005

    def _convert(self, register: int) -> None:
        if register == 0x06:
            self.registers[0x04] &= ~0x01
        if not self.measuring or self.frozen or time.monotonic() < self._next_s or register != 0x04:
            return
        self._next_s = time.monotonic() + 0.005
        self._count += self.dither
        self.registers[0x04] |= 0x01
        self.put(0x06, struct.pack(">H", self.raw_temperature))
        for i, value_g in enumerate(self.raw_g):
            counts = round(value_g / 3.9e-6) + (self._count if i == 0 else 0)
            self.put(0x08 + 3 * i, (counts << 4 & 0xFFFFFF).to_bytes(3, "big"))


@pytest.fixture
def adxl() -> FakeAdxl355:
    return FakeAdxl355()


@pytest.fixture
def sensor(adxl: FakeAdxl355) -> Iterator[Adxl355]:
    sensor = Adxl355(FakeI2cBus({0x1D: adxl}))
    yield sensor
    sensor.close()


def test_adxl355_reads_what_it_measures(sensor):
    reading = sensor.read()
    assert reading.x_g == pytest.approx(0.1, abs=1e-4)
    assert reading.y_g == pytest.approx(-0.2, abs=1e-5)
    assert reading.z_g == pytest.approx(0.97, abs=1e-5)
    assert reading.temperature_c == pytest.approx(25.0)
    assert abs(time.monotonic() - reading.monotonic_s) < 0.5


def test_adxl355_is_set_up_in_standby_for_62_5_hz_and_2_g(adxl, sensor):
    assert adxl.writes == [(0x2F, 0x52), (0x28, 0x06), (0x2C, 0x81), (0x2D, 0x00)]


def test_adxl355_goes_to_standby_and_gives_the_bus_back(adxl):
    bus = FakeI2cBus({0x1D: adxl})
    Adxl355(bus).close()
    assert adxl.registers[0x2D] == 0x01
    assert bus.closed


def test_adxl355_names_itself(sensor):
    assert sensor.identify() == "ADXL355 at 0x1D on fake bus, revision 1"


@pytest.mark.parametrize(("register", "value"), [(0x00, 0x00), (0x01, 0xFF), (0x02, 0xE9)])
def test_adxl355_refuses_another_chip(adxl, register, value):
    adxl.registers[register] = value
    with pytest.raises(WrongDeviceError, match=f"0x{register:02X} holds 0x{value:02X}"):
        Adxl355(FakeI2cBus({0x1D: adxl}))


def test_an_adxl359_is_named(adxl):
    adxl.registers[0x02] = 0xE9
    with pytest.raises(WrongDeviceError, match=r"instead of 0xED \(0xE9 in 0x02 is an ADXL359\);"):
        Adxl355(FakeI2cBus({0x1D: adxl}))
    adxl.registers[0x01] = 0x00
    with pytest.raises(WrongDeviceError, match="holds 0x00 instead of 0x1D;"):
        Adxl355(FakeI2cBus({0x1D: adxl}))


def test_adxl355_that_is_not_there_is_named():
    with pytest.raises(TransientError, match="ADXL355 at 0x53 on fake bus: does not acknowledge"):
        Adxl355(FakeI2cBus({}), 0x53)


def test_adxl355_is_reset_again_where_it_lost_its_trim(adxl):
    adxl.bad_resets = 2
    Adxl355(FakeI2cBus({0x1D: adxl}))
    assert adxl.writes.count((0x2F, 0x52)) == 3


def test_adxl355_that_keeps_losing_its_trim_is_broken(adxl):
    adxl.bad_resets = 100
    with pytest.raises(DeviceError, match="loses its factory trim"):
        Adxl355(FakeI2cBus({0x1D: adxl}))
    assert adxl.writes.count((0x2F, 0x52)) == 5


def test_adxl355_gives_each_sample_once(sensor):
    readings = [sensor.read() for _ in range(5)]
    assert len({reading.x_g for reading in readings}) == 5


def test_adxl355_without_new_samples_is_not_read_again(adxl, sensor, monkeypatch):
    monkeypatch.setattr(adxl355, "_READY_TIMEOUT_S", 0.05)
    adxl.frozen = True
    with pytest.raises(TransientError, match=r"a sample took longer than 0\.05 s"):
        sensor.read()


def test_adxl355_whose_samples_are_all_the_same_is_frozen(adxl, sensor):
    adxl.dither = 0
    with pytest.raises(DeviceError, match=r"is frozen: .* identical readings"):
        sensor.read_many(0.3)
    adxl.dither = 1
    assert len(sensor.read_many(0.1)) > 5


@pytest.mark.parametrize("raw_g", [(0.0, 0.0, 0.0), (-2.0, -2.0, -2.0), (0.0, 0.0, 0.4)])
def test_adxl355_refuses_what_no_gravity_can_be(adxl, sensor, raw_g):
    adxl.raw_g = raw_g
    with pytest.raises(TransientError, match=r"implausible reading: .* g in all"):
        sensor.read()


def test_adxl355_refuses_an_impossible_temperature(adxl, sensor):
    adxl.raw_temperature = 4095
    with pytest.raises(TransientError, match="-219 °C"):
        sensor.read()


def test_a_mean_of_the_adxl355_does_without_its_temperature(adxl, sensor):
    adxl.raw_temperature = 4095
    with collecting() as faults:
        readings = sensor.read_many(0.0)
    assert all(math.isnan(reading.temperature_c) for reading in readings)
    assert {note.problem for note in faults.all()} == {"says -219 °C of itself"}
    level = head_level(readings, ("+x", "+y", "+z"), "ADXL355")
    assert level.temperature_c is None
    drifting = AccelerometerCorrection(drift_mg_c=(0.1, 0.0, 0.0))
    with pytest.raises(
        DeviceError, match=r"does not tell its temperature, and .inclinometer. drift_mg_c needs it"
    ):
        head_level(readings, ("+x", "+y", "+z"), "ADXL355", drifting)


def test_adxl355_passes_a_fault_of_the_bus_on_and_works_again(adxl):
    bus = FakeI2cBus({0x1D: adxl})
    sensor = Adxl355(bus)
    bus.fail_next(121)
    with pytest.raises(TransientError, match="does not acknowledge"):
        sensor.read()
    assert sensor.read().y_g == pytest.approx(-0.2, abs=1e-5)


class FakeIis2iclx(RegisterChip):
    """A sample every 5 ms while its rate is not 0; a reset takes two readings of its flag."""

    def __init__(self) -> None:
        super().__init__(on_write=self._written, on_read=self._convert)
        self.put(0x0F, b"\x6b")
        self.counts = (-1000, 2000)
        self.temperature = 0x0100
        self.dither = 1
        self._reset_polls = 0
        self._next_s = 0.0
        self._count = 0

    def _written(self, register: int, value: int) -> None:
        if register == 0x12 and value & 1:
            self._reset_polls = 2

    def _convert(self, register: int) -> None:
        if register == 0x12 and self._reset_polls:
            self._reset_polls -= 1
            self.registers[0x12] = 1 if self._reset_polls else 0x04
        if register == 0x1E and self.registers[0x10] >> 4 and time.monotonic() >= self._next_s:
            self._next_s = time.monotonic() + 0.005
            self._count += self.dither
            x, y = self.counts
            self.put(0x28, struct.pack("<hh", x, min(y + self._count, 32767)))
            self.put(0x20, struct.pack("<h", self.temperature))
            self.registers[0x1E] = 0x05
        elif register == 0x28:
            self.registers[0x1E] = 0


@pytest.fixture
def iis() -> FakeIis2iclx:
    return FakeIis2iclx()


def test_iis2iclx_reads_what_it_measures(iis):
    sensor = Iis2iclx(FakeI2cBus({0x6A: iis}))
    reading = sensor.read()
    assert reading.x_g == pytest.approx(-0.031)
    assert reading.y_g == pytest.approx(0.062, abs=2e-4)
    assert reading.z_g is None
    assert reading.temperature_c == 26.0
    assert sensor.identify() == "IIS2ICLX at 0x6A on fake bus"


def test_iis2iclx_is_set_up_for_52_hz_1_g_low_pass_and_consistent_bytes(iis):
    Iis2iclx(FakeI2cBus({0x6A: iis}))
    assert iis.writes == [(0x12, 0x01), (0x12, 0x44), (0x17, 0x00), (0x10, 0x3A)]


def test_iis2iclx_powers_down(iis):
    bus = FakeI2cBus({0x6B: iis})
    Iis2iclx(bus, 0x6B).close()
    assert iis.registers[0x10] == 0
    assert bus.closed


def test_iis2iclx_refuses_another_chip(iis):
    iis.put(0x0F, b"\x6c")
    with pytest.raises(WrongDeviceError, match="0x0F holds 0x6C instead of 0x6B"):
        Iis2iclx(FakeI2cBus({0x6A: iis}))


@pytest.mark.parametrize("counts", [(32767, 0), (0, -32768), (30000, 30000)])
def test_iis2iclx_refuses_saturation_and_more_than_gravity(iis, counts):
    iis.counts = counts
    with pytest.raises(TransientError, match=r"implausible reading: .* g and .* g"):
        Iis2iclx(FakeI2cBus({0x6A: iis})).read()


def test_iis2iclx_refuses_saturation_on_either_side(iis):
    for counts in ((-32768, 0), (32767, 0), (0, 32767), (0, -32768)):  # 1.016 g at 0.031 mg
        iis.counts = counts
        with pytest.raises(TransientError, match="implausible reading"):
            Iis2iclx(FakeI2cBus({0x6A: iis})).read()


def test_iis2iclx_refuses_an_impossible_temperature(iis):
    iis.temperature = -32768
    with pytest.raises(TransientError, match="-103 °C"):
        Iis2iclx(FakeI2cBus({0x6A: iis})).read()


def test_a_mean_of_the_iis2iclx_does_without_its_temperature(iis):
    iis.temperature = -32768
    with collecting() as faults:
        readings = Iis2iclx(FakeI2cBus({0x6A: iis})).read_many(0.0)
    assert {note.problem for note in faults.all()} == {"says -103 °C of itself"}
    assert all(math.isnan(reading.temperature_c) for reading in readings)


def test_iis2iclx_whose_samples_are_all_the_same_is_frozen(iis):
    iis.dither = 0
    with pytest.raises(DeviceError, match="is frozen"):
        Iis2iclx(FakeI2cBus({0x6A: iis})).read_many(0.3)


def test_iis2iclx_that_stays_in_reset_is_given_up(iis, monkeypatch):
    monkeypatch.setattr(iis2iclx, "_READY_TIMEOUT_S", 0.02)
    iis.on_read = None
    with pytest.raises(TransientError, match="the reset took longer"):
        Iis2iclx(FakeI2cBus({0x6A: iis}))
