"""BMP390, BMP388 and MS5611: golden vectors, and the traps of their data sheets."""

import struct
import time
from functools import partial

import pytest
from fakes.chips import FakeI2cBus, RegisterChip
from fakes.clock import FakeClock
from hypothesis import given
from hypothesis import strategies as st

from rig.devices.sensors import bmp3, ms5611
from rig.devices.sensors.bmp3 import Bmp3, Trim
from rig.devices.sensors.ms5611 import Coefficients, Ms5611, crc4
from rig.errors import DeviceError, TransientError, WrongDeviceError

BMP388_TRIM = bytes.fromhex("23 6B 58 49 F6 5C FF CE F4 23 00 EA 63 6E 79 F3 F6 AA 43 12 C4")
BMP388_DATA = bytes.fromhex("97 9F 6D 73 D8 85")
BMP3_GOLDEN = [
    (BMP388_TRIM, BMP388_DATA, 30.499314453874284, 100876.00634692199),
    (
        bytes.fromhex("98 6C A9 4A F9 E3 1C 61 16 06 01 51 4A DE 5D 03 FA F9 0E 06 F5"),
        bytes.fromhex("CB B3 6B D1 BA 82"),
        25.770745473616987,
        98370.56628475757,
    ),
    (
        bytes.fromhex("98 6E 13 4D F9 B0 1B C0 15 06 01 92 4A AE 5D 03 FA 08 0F 06 F5"),
        bytes.fromhex("92 51 65 79 CE 83"),
        25.498167027511645,
        100548.40477814537,
    ),
]


@pytest.fixture(autouse=True)
def clock(monkeypatch: pytest.MonkeyPatch) -> FakeClock:
    return FakeClock(monkeypatch)


@pytest.mark.parametrize(("trim", "data", "temperature_c", "pressure_pa"), BMP3_GOLDEN)
def test_bmp3_compensation_is_that_of_the_golden_vectors(trim, data, temperature_c, pressure_pa):
    raw_pressure, raw_temperature = (int.from_bytes(data[i : i + 3], "little") for i in (0, 3))
    pressure, temperature = bmp3.compensate(Trim.decode(trim), raw_pressure, raw_temperature)
    assert temperature == pytest.approx(temperature_c, abs=1e-9)
    assert pressure == pytest.approx(pressure_pa, abs=1e-6)


def test_bmp3_trim_words_are_decoded_with_their_signs():
    trim = Trim.decode(BMP388_TRIM)
    assert [trim.t[0] / 2**8, trim.t[1] * 2**30, trim.t[2] * 2**48] == [27427, 18776, -10]
    scales = [2**20, 2**29, 2**32, 2**37, 2**-3, 2**6, 2**8, 2**15, 2**48, 2**48, 2**65]
    words = [p * scale for p, scale in zip(trim.p, scales, strict=True)]
    words[0] += 2**14
    words[1] += 2**14
    assert words == [-164, -2866, 35, 0, 25578, 31086, -13, -10, 17322, 18, -60]


class FakeBmp3(RegisterChip):
    """One forced conversion takes ``conversion_s``; before the first the data registers hold 0x800000."""

    def __init__(self, chip_id: int = 0x60) -> None:
        super().__init__(on_write=self._written, on_read=self._act)
        self.put(0x00, bytes([chip_id, 0x01]))
        self.put(0x03, b"\x10")
        self.put(0x31, BMP388_TRIM)
        self.conversion_s = 0.01
        self.data = BMP388_DATA
        self._done_s: float | None = None
        self._put_unmeasured()

    def _put_unmeasured(self) -> None:
        self.put(0x04, b"\x00\x00\x80\x00\x00\x80")

    def _written(self, register: int, value: int) -> None:
        if register == 0x7E and value == 0xB6:
            self._put_unmeasured()
        if register == 0x1B and value == 0x13:
            self._done_s = time.monotonic() + self.conversion_s

    def _act(self, register: int) -> None:
        if self._done_s and time.monotonic() >= self._done_s:
            self._done_s = None
            self.put(0x04, self.data)
            self.registers[0x03] |= 0x60
        elif register == 0x04:
            self.registers[0x03] &= ~0x60


@pytest.fixture
def bmp() -> FakeBmp3:
    return FakeBmp3()


def test_bmp390_reads_pressure_and_temperature(bmp):
    sensor = Bmp3(FakeI2cBus({0x76: bmp}))
    reading = sensor.read()
    assert reading.pressure_hpa == pytest.approx(1008.7600634692)
    assert reading.temperature_c == pytest.approx(30.4993144)
    assert sensor.identify() == "BMP390 at 0x76 on fake bus"


def test_bmp388_is_another_identity():
    bus = FakeI2cBus({0x77: FakeBmp3(0x50)})
    assert Bmp3(bus, 0x77, model="bmp388").read().pressure_hpa == pytest.approx(1008.76, abs=0.01)
    with pytest.raises(WrongDeviceError, match=r"holds 0x50 instead of 0x60 .*0x50 a BMP388"):
        Bmp3(bus, 0x77, model="bmp390")


def test_bmp390_is_reset_and_set_up_for_16_and_2_times_without_filter(bmp):
    Bmp3(FakeI2cBus({0x76: bmp}))
    assert bmp.writes == [(0x7E, 0xB6), (0x1C, 0x0C), (0x1F, 0x00)]


def test_bmp390_waits_for_the_conversion_and_does_not_take_the_last_one(bmp):
    sensor = Bmp3(FakeI2cBus({0x76: bmp}))
    bmp.conversion_s = 0.08
    sensor.read()
    bmp.data = bytes.fromhex("92 51 65 79 CE 83")
    assert sensor.read().pressure_hpa != pytest.approx(1008.76, abs=0.01)


def test_bmp390_that_does_not_convert_is_given_up(bmp, monkeypatch):
    monkeypatch.setattr(bmp3, "_TIMEOUT_S", 0.05)
    sensor = Bmp3(FakeI2cBus({0x76: bmp}))
    bmp.conversion_s = 60.0
    with pytest.raises(TransientError, match="a conversion took longer"):
        sensor.read()


@pytest.mark.parametrize("data", ["00 00 80 73 D8 85", "97 9F 6D 00 00 80"])
def test_bmp390_value_before_the_first_conversion_is_refused(bmp, data):
    sensor = Bmp3(FakeI2cBus({0x76: bmp}))
    bmp.data = bytes.fromhex(data)
    with pytest.raises(TransientError, match="has not measured yet"):
        sensor.read()


@pytest.mark.parametrize("data", ["00 00 00 73 D8 85", "97 9F 6D FF FF FF", "FF FF FF FF FF FF"])
def test_bmp390_reading_outside_its_range_is_refused(bmp, data):
    sensor = Bmp3(FakeI2cBus({0x76: bmp}))
    bmp.data = bytes.fromhex(data)
    with pytest.raises(TransientError, match=r"implausible reading: .* hPa at .* °C"):
        sensor.read()


@pytest.mark.parametrize(("bits", "what"), [(1, "fatal error"), (4, "configuration error")])
def test_bmp390_own_errors_are_named(bmp, bits, what):
    sensor = Bmp3(FakeI2cBus({0x76: bmp}))
    bmp.registers[0x02] = bits
    with pytest.raises(DeviceError, match=f"reports a {what}"):
        sensor.read()


@pytest.mark.parametrize("trim", [b"\x00" * 21, b"\xff" * 21])
def test_bmp390_without_trim_is_broken(bmp, trim):
    bmp.put(0x31, trim)
    with pytest.raises(DeviceError, match="has no factory trim"):
        Bmp3(FakeI2cBus({0x76: bmp}))


def test_an_ms5611_at_the_address_of_a_bmp390_is_reported(ms):
    with pytest.raises(WrongDeviceError, match=r"BMP390 at 0x76 .*0x00 often an MS5611"):
        Bmp3(FakeI2cBus({0x76: ms}))


def test_a_bmp390_at_the_address_of_an_ms5611_is_reported(bmp):
    with pytest.raises(WrongDeviceError, match=r"MS5611 at 0x76 .* is a BMP390"):
        Ms5611(FakeI2cBus({0x76: bmp}), 0x76)


C = Coefficients(40127, 36924, 23317, 23282, 33464, 28312)
D1 = 9085466


@pytest.mark.parametrize(
    ("d2", "temperature", "pressure_pa"),
    [
        (8569150, 2007, 100009),
        (8300000, 1066, 98189),
        (8077636, 238, 96576),
        (7700000, -1275, 93605),
        (7000000, -4431, 85693),
    ],
)
def test_ms5611_compensation_is_that_of_the_golden_vectors(d2, temperature, pressure_pa):
    assert ms5611.compensate(C, D1, d2) == (pressure_pa, temperature)


def test_ms5611_checksum_is_that_of_the_application_note():
    prom = bytes.fromhex("3132 3334 3536 3738 3940 4142 4344 4500")
    assert crc4(prom) == 0xB
    assert crc4(prom[:15] + b"\x5b") == 0xB


@given(st.binary(min_size=16, max_size=16), st.integers(0, 119))
def test_ms5611_checksum_notices_every_single_flipped_bit(prom, bit):
    flipped = bytearray(prom)
    flipped[bit // 8] ^= 1 << bit % 8
    assert crc4(bytes(flipped)) != crc4(prom)


class FakeMs5611:
    """Commands instead of registers; the ADC gives 0 before its time, and 0 when it is read twice."""

    def __init__(self) -> None:
        words = struct.pack(">7H", 0, C.c1, C.c2, C.c3, C.c4, C.c5, C.c6)
        self.prom = bytearray(words + b"\x00\x00")
        self.prom[15] = crc4(bytes(self.prom))
        self.raw = {0x40: D1, 0x50: 8569150}
        self.conversion_s = 0.00904
        self.commands: list[int] = []
        self._result = 0
        self._ready_s = 0.0

    def transfer(self, write: bytes, read_length: int) -> bytes:
        command = write[0]
        self.commands.append(command)
        if 0xA0 <= command <= 0xAE:
            return bytes(self.prom[command - 0xA0 : command - 0xA0 + 2])
        if command & 0xF0 in self.raw:
            self._result, self._ready_s = self.raw[command & 0xF0], time.monotonic() + self.conversion_s
        if command == 0x00:
            result = self._result if time.monotonic() >= self._ready_s else 0
            self._result = 0
            return result.to_bytes(3, "big")[:read_length]
        return b""


@pytest.fixture
def ms() -> FakeMs5611:
    return FakeMs5611()


def test_ms5611_reads_pressure_and_temperature(ms):
    sensor = Ms5611(FakeI2cBus({0x77: ms}))
    reading = sensor.read()
    assert (reading.pressure_hpa, reading.temperature_c) == (1000.09, 20.07)
    assert ms.commands[-4:] == [0x58, 0x00, 0x48, 0x00]
    assert sensor.identify() == "MS5611 at 0x77 on fake bus"


def test_ms5611_conversion_that_was_not_finished_is_refused(ms):
    sensor = Ms5611(FakeI2cBus({0x77: ms}))
    ms.conversion_s = 1.0
    with pytest.raises(TransientError, match="not finished or was read twice"):
        sensor.read()


def test_ms5611_with_a_flipped_bit_in_its_calibration_is_broken(ms):
    ms.prom[5] ^= 0x10
    with pytest.raises(DeviceError, match="the checksum of its factory calibration is wrong"):
        Ms5611(FakeI2cBus({0x77: ms}))


def test_ms5611_with_an_empty_calibration_is_broken_though_its_checksum_is_right(ms):
    ms.prom[:] = bytes(16)
    with pytest.raises(DeviceError, match="has no factory calibration"):
        Ms5611(FakeI2cBus({0x77: ms}))


def test_ms5611_reading_outside_its_range_is_refused(ms):
    sensor = Ms5611(FakeI2cBus({0x77: ms}))
    ms.raw[0x40] = 0xFFFFFF
    with pytest.raises(TransientError, match="implausible reading"):
        sensor.read()


@pytest.mark.parametrize(
    ("driver", "enough"), [(partial(Bmp3, address=0x76), 8), (partial(Ms5611, address=0x77), 16)]
)
def test_a_barometer_whose_readings_are_all_the_same_is_frozen(driver, enough, bmp, ms, clock):
    sensor = driver(FakeI2cBus({0x76: bmp, 0x77: ms}))
    began_s = clock.now_s
    sensor.read()
    one_s = clock.now_s - began_s
    assert len(sensor.read_many((enough - 1.5) * one_s)) == enough - 1
    with pytest.raises(DeviceError, match=f"is frozen: {enough} identical readings in a row"):
        sensor.read_many((enough - 0.5) * one_s)


@pytest.mark.parametrize("driver", [partial(Bmp3, model="bmp390"), Ms5611])
def test_barometers_give_the_bus_back(driver, bmp, ms):
    bus = FakeI2cBus({0x76: bmp, 0x77: ms})
    sensor = driver(bus, 0x77 if driver is Ms5611 else 0x76)
    assert len(sensor.read_many(0.05)) >= 1
    sensor.close()
    assert bus.closed
