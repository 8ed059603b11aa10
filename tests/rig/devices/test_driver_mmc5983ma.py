"""MMC5983MA against a register file: golden vectors, SET and RESET, and what is out of range."""

import itertools
from dataclasses import replace

import pytest
from fakes.chips import FakeI2cBus, RegisterChip
from fakes.clock import FakeClock
from hypothesis import given
from hypothesis import strategies as st

from rig.devices.sensors import mmc5983ma
from rig.devices.sensors.mmc5983ma import Mmc5983ma, decode_field, decode_temperature_c
from rig.devices.sensors.sampling import MIN_READINGS
from rig.errors import DeviceError, TransientError, WrongDeviceError
from rig.fault_notes import collecting


@pytest.fixture(autouse=True)
def clock(monkeypatch: pytest.MonkeyPatch) -> FakeClock:
    return FakeClock(monkeypatch)


def registers_of(x: int, y: int, z: int) -> bytes:
    high = b"".join((value >> 2).to_bytes(2, "big") for value in (x, y, z))
    return high + bytes([(x & 3) << 6 | (y & 3) << 4 | (z & 3) << 2])


def test_half_a_gauss_and_zero_are_those_of_the_data_sheet():
    data = bytes.fromhex("88 00 80 00 80 00 00")
    assert decode_field(data) == (139264 - 131072, 0, 0)
    assert decode_field(data)[0] * mmc5983ma._UT_PER_COUNT == pytest.approx(50.0)


@given(*[st.integers(0, (1 << 18) - 1)] * 3)
def test_all_18_bits_of_each_axis_are_used(x, y, z):
    assert decode_field(registers_of(x, y, z)) == (x - 131072, y - 131072, z - 131072)


def test_temperature():
    assert decode_temperature_c(125) == pytest.approx(25.0)


class FakeMmc5983ma(RegisterChip):
    """Field and offset in counts; SET and RESET turn the sign of what it measures."""

    def __init__(self) -> None:
        super().__init__(on_write=self._written)
        self.put(0x2F, b"\x30")
        self.field_counts = (3277, -1638, -6554)  # 20, -10, -40 µT
        self.offset_counts = (500, 8000, -8000)
        self.temperature = 125
        self.answers = True
        self.otp_good = True
        self.tells_temperature = True
        self._sign = 1

    def _written(self, register: int, value: int) -> None:
        if register == 0x0A and value & 0x80:
            self.registers[0x08] = 0x10 if self.otp_good else 0
        if register != 0x09:
            return
        if value & 0x08:
            self._sign = 1
        if value & 0x10:
            self._sign = -1
        if value & 0x03:
            self.registers[0x08] &= ~0x03
        if value & 0x01 and self.answers:
            raw = (
                max(0, min(131072 + self._sign * field + offset, (1 << 18) - 1))
                for field, offset in zip(self.field_counts, self.offset_counts, strict=True)
            )
            self.put(0x00, registers_of(*raw))
            self.registers[0x08] |= 0x01
        if value & 0x02 and self.answers and self.tells_temperature:
            self.registers[0x07] = self.temperature
            self.registers[0x08] |= 0x02


@pytest.fixture
def chip() -> FakeMmc5983ma:
    return FakeMmc5983ma()


@pytest.fixture
def sensor(chip: FakeMmc5983ma) -> Mmc5983ma:
    return Mmc5983ma(FakeI2cBus({0x30: chip}))


def test_set_and_reset_part_the_field_from_the_offset(sensor):
    reading = sensor.read()
    assert (reading.x_ut, reading.y_ut, reading.z_ut) == pytest.approx((20.0, -10.0, -40.0), abs=0.01)
    assert reading.offset_ut == pytest.approx((3.05, 48.83, -48.83), abs=0.01)
    assert reading.temperature_c == pytest.approx(25.0)


def test_a_reading_sets_measures_resets_and_measures(chip, sensor):
    chip.writes.clear()
    sensor.read()
    assert [value for register, value in chip.writes if register == 0x09] == [0x08, 0x01, 0x10, 0x01, 0x02]


def test_many_readings_are_enough_for_a_mean_however_short_the_time(sensor, monkeypatch):
    noisy = itertools.count()
    read = sensor.read
    monkeypatch.setattr(sensor, "read", lambda: replace(read(), x_ut=20.0 + 0.01 * next(noisy)))
    assert len(sensor.read_many(0.0)) == MIN_READINGS


def test_a_chip_whose_readings_are_all_the_same_is_frozen(sensor):
    with pytest.raises(DeviceError, match="is frozen: "):
        sensor.read_many(0.3)


def test_it_names_itself_and_gives_the_bus_back(chip):
    bus = FakeI2cBus({0x30: chip})
    sensor = Mmc5983ma(bus)
    assert sensor.identify() == "MMC5983MA at 0x30 on fake bus"
    sensor.close()
    assert bus.closed


def test_another_chip_is_refused(chip):
    chip.put(0x2F, b"\x0c")
    with pytest.raises(WrongDeviceError, match="0x2F holds 0x0C instead of 0x30"):
        Mmc5983ma(FakeI2cBus({0x30: chip}))


def test_a_chip_that_cannot_load_its_trim_is_broken(chip, monkeypatch):
    monkeypatch.setattr(mmc5983ma, "_TIMEOUT_S", 0.02)
    chip.otp_good = False
    with pytest.raises(DeviceError, match="could not load its factory trim"):
        Mmc5983ma(FakeI2cBus({0x30: chip}))


def test_a_measurement_that_does_not_end_is_given_up(chip, sensor, monkeypatch):
    monkeypatch.setattr(mmc5983ma, "_TIMEOUT_S", 0.02)
    chip.answers = False
    with pytest.raises(TransientError, match="a measurement took longer"):
        sensor.read()


@pytest.mark.parametrize(
    ("field_counts", "is_refused"), [(0, True), (160, True), (168, False), (-168, False)]
)
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_chip_on_which_set_and_reset_make_no_difference_is_not_believed(
    chip, sensor, field_counts, is_refused, axis
):
    """Its coil is broken. The Earth's field has 22 uT; below 1 uT, 164 counts, on all axes it is not measured."""
    chip.field_counts = tuple(field_counts if i == axis else 0 for i in range(3))
    if is_refused:
        with pytest.raises(TransientError, match="SET and RESET make no difference"):
            sensor.read()
    else:
        assert sensor.read().offset_ut == pytest.approx((3.05, 48.83, -48.83), abs=0.01)


def test_a_chip_that_ignores_reset_is_not_believed(chip, sensor):
    chip._written = lambda register, value: FakeMmc5983ma._written(
        chip, register, value & ~0x10 if register == 0x09 else value
    )
    chip.on_write = chip._written
    with pytest.raises(TransientError, match="SET and RESET make no difference"):
        sensor.read()


@pytest.mark.parametrize("counts", [200_000, -200_000])
def test_a_saturating_magnet_is_reported(chip, sensor, counts):
    chip.field_counts = (counts, 0, 0)
    with pytest.raises(TransientError, match="beyond ±8 G; is a magnet near"):
        sensor.read()


@pytest.mark.parametrize(
    ("offset_ut", "is_refused"), [(190, False), (-190, False), (210, True), (-210, True)]
)
def test_a_field_that_saturates_after_set_or_after_reset_only_is_refused(chip, sensor, offset_ut, is_refused):
    """600 uT on a bridge that is off by 200 reach the end of the range at 800 one way, and -400 the other."""
    chip.field_counts = (round(600 * 163.84), 0, 0)
    chip.offset_counts = (round(offset_ut * 163.84), 0, 0)
    if is_refused:
        with pytest.raises(TransientError, match="beyond ±8 G"):
            sensor.read()
    else:
        assert sensor.read().x_ut == pytest.approx(600.0, abs=0.01)


def test_it_is_reset_and_set_to_the_bandwidth_of_the_least_noise(chip, sensor):
    assert chip.writes == [(0x0A, 0x80), (0x0A, 0x00)]


def test_an_impossible_temperature_does_not_refuse_the_field(chip, sensor):
    chip.temperature = 0
    with collecting() as faults:
        reading = sensor.read()
    assert (reading.x_ut, reading.y_ut, reading.z_ut) == pytest.approx((20.0, -10.0, -40.0), abs=0.01)
    assert reading.temperature_c is None
    assert [note.problem for note in faults.all()] == ["says -75 °C of itself"]


def test_a_temperature_that_is_never_measured_is_waited_for_once(chip, sensor, monkeypatch):
    monkeypatch.setattr(mmc5983ma, "_TIMEOUT_S", 0.02)
    chip.tells_temperature = False
    with collecting() as faults:
        readings = [sensor.read(), sensor.read()]
    assert [reading.temperature_c for reading in readings] == [None, None]
    assert [reading.x_ut for reading in readings] == pytest.approx([20.0, 20.0], abs=0.01)
    (note,) = faults.all()
    assert note.count == 1
    assert note.problem.startswith("its temperature cannot be read: a measurement took longer")
