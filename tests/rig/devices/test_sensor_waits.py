"""Drivers wait for what the chips need: for their trim, a conversion, samples of a settled filter. On a virtual clock."""

import math

import numpy as np
import pytest
from fakes.clock import FakeClock, TimedBus

from rig.devices.sensors import adxl355, ms5611
from rig.devices.sensors.adxl355 import Adxl355
from rig.devices.sensors.bmp3 import Bmp3
from rig.devices.sensors.iis2iclx import Iis2iclx
from rig.devices.sensors.mmc5983ma import Mmc5983ma
from rig.devices.sensors.ms5611 import Ms5611
from rig.errors import DeviceError, TransientError
from sim.devices import adxl355 as fake_adxl355
from sim.devices import bmp3 as fake_bmp3
from sim.devices import iis2iclx as fake_iis2iclx
from sim.devices import mmc5983ma as fake_mmc5983ma
from sim.devices import ms5611 as fake_ms5611
from sim.devices.i2c_chip import I2cChip

UP = np.array([0.1, 0.5, math.sqrt(1 - 0.01 - 0.25)])
FIELD_UT = np.array([20.0, -15.0, 40.0])


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> FakeClock:
    return FakeClock(monkeypatch)


@pytest.fixture
def adxl(clock: FakeClock) -> fake_adxl355.Adxl355:
    return fake_adxl355.Adxl355(lambda: UP, lambda: 22.0, clock=clock, rng=np.random.default_rng(1))


@pytest.fixture
def iis(clock: FakeClock) -> fake_iis2iclx.Iis2iclx:
    return fake_iis2iclx.Iis2iclx(lambda: UP, lambda: 22.0, clock=clock, rng=np.random.default_rng(1))


@pytest.fixture
def mmc(clock: FakeClock) -> fake_mmc5983ma.Mmc5983ma:
    return fake_mmc5983ma.Mmc5983ma(
        lambda: FIELD_UT, lambda: 22.0, clock=clock, rng=np.random.default_rng(1), bridge_offset_ut=(30, 0, 9)
    )


@pytest.fixture
def bmp(clock: FakeClock) -> fake_bmp3.Bmp3:
    return fake_bmp3.Bmp3("bmp390", lambda: 95_000.0, lambda: 22.0, clock=clock, rng=np.random.default_rng(1))


@pytest.fixture
def ms(clock: FakeClock) -> fake_ms5611.Ms5611:
    return fake_ms5611.Ms5611(lambda: 95_000.0, lambda: 22.0, clock=clock, rng=np.random.default_rng(1))


def test_the_adxl355_is_reset_once_and_its_trim_waited_for(
    clock: FakeClock, adxl: fake_adxl355.Adxl355
) -> None:
    bus = TimedBus(adxl, clock)
    began_s = clock.now_s
    Adxl355(bus)
    assert [write for write in bus.writes if write[0] == 0x2F] == [bytes([0x2F, 0x52])]
    assert 0.030 < clock.now_s - began_s < 0.150


def test_an_adxl355_that_has_just_been_switched_on_is_not_taken_for_broken(
    clock: FakeClock, adxl: fake_adxl355.Adxl355
) -> None:
    adxl.power_cycle()
    bus = TimedBus(adxl, clock)
    assert Adxl355(bus).read().y_g == pytest.approx(0.5, abs=0.001)
    assert len([write for write in bus.writes if write[0] == 0x2F]) == 1


def test_an_adxl355_that_stays_busy_is_broken(clock: FakeClock, adxl: fake_adxl355.Adxl355) -> None:
    class Busy(TimedBus):
        def transfer(self, address: int, write: bytes, read_length: int) -> bytes:
            answer = super().transfer(address, write, read_length)
            return b"\x10" if write == b"\x04" else answer

    with pytest.raises(DeviceError, match="loses its factory trim when it is reset"):
        Adxl355(Busy(adxl, clock))


def test_the_first_reading_of_the_adxl355_is_of_a_settled_filter(
    clock: FakeClock, adxl: fake_adxl355.Adxl355
) -> None:
    reading = Adxl355(TimedBus(adxl, clock)).read()
    # The driver takes the data sheet's rounded 3.9 ug for the 1 / 256,000 g of a count: 0.16 % less.
    assert (reading.x_g, reading.y_g, reading.z_g) == pytest.approx(UP * 3.9e-6 * 256_000, abs=0.0005)
    assert reading.temperature_c == pytest.approx(22.0, abs=0.5)


def test_the_adxl355_gives_no_sample_that_is_older_than_its_opening(
    clock: FakeClock, adxl: fake_adxl355.Adxl355
) -> None:
    sensor = Adxl355(TimedBus(adxl, clock))
    opened_s = clock.now_s
    first, second = sensor.read(), sensor.read()
    assert first.monotonic_s - opened_s > adxl355._SAMPLE_S / 2, "the sample that was there is left alone"
    assert second.monotonic_s - first.monotonic_s == pytest.approx(1 / 62.5, abs=0.005)


def test_the_iis2iclx_is_set_up_after_its_reset_and_not_during_it(
    clock: FakeClock, iis: fake_iis2iclx.Iis2iclx
) -> None:
    sensor = Iis2iclx(TimedBus(iis, clock))
    assert iis.transfer(b"\x12", 1) == b"\x44", "block data update and auto-increment"
    reading = sensor.read()
    assert (reading.x_g, reading.y_g) == pytest.approx(UP[:2], abs=0.001)
    assert reading.temperature_c == pytest.approx(22.0, abs=0.01)


def test_the_iis2iclx_gives_each_sample_once(clock: FakeClock, iis: fake_iis2iclx.Iis2iclx) -> None:
    times_s = [reading.monotonic_s for reading in Iis2iclx(TimedBus(iis, clock)).read_many(1.0)]
    assert np.diff(times_s) == pytest.approx(1 / 52, abs=0.006)
    assert len(times_s) == pytest.approx(52, abs=2)


def test_the_mmc5983ma_is_left_alone_during_its_reset_and_until_its_trim_is_loaded(
    clock: FakeClock, mmc: fake_mmc5983ma.Mmc5983ma
) -> None:
    reading = Mmc5983ma(TimedBus(mmc, clock)).read()
    assert (reading.x_ut, reading.y_ut, reading.z_ut) == pytest.approx(FIELD_UT, abs=0.2)
    assert reading.offset_ut == pytest.approx((30.0, 0.0, 9.0), abs=0.2)
    assert reading.temperature_c == pytest.approx(22.0, abs=0.5)


def test_the_bmp390_is_commanded_when_it_is_ready_only(clock: FakeClock, bmp: fake_bmp3.Bmp3) -> None:
    bmp.power_cycle()
    began_s = clock.now_s
    sensor = Bmp3(TimedBus(bmp, clock))
    assert clock.now_s - began_s > 0.020, "the start, and the reset"
    assert bmp.transfer(b"\x1c", 1) == b"\x0c"
    reading = sensor.read()
    assert reading.pressure_hpa == pytest.approx(950.0, abs=0.1)
    assert reading.temperature_c == pytest.approx(22.0, abs=0.05)


def test_each_reading_of_the_bmp390_is_a_conversion_of_its_own(clock: FakeClock, bmp: fake_bmp3.Bmp3) -> None:
    """234 + 392 + 16 x 2020 + 163 + 2 x 2020 us by the data sheet, section 3.9.2: 37.1 ms."""
    sensor = Bmp3(TimedBus(bmp, clock))
    began_s = clock.now_s
    readings = [sensor.read() for _ in range(3)]
    assert len({reading.pressure_hpa for reading in readings}) == 3
    assert 3 * 0.0371 < clock.now_s - began_s < 3 * 0.0450


@pytest.mark.parametrize(("pressure_late_s", "temperature_late_s"), [(0.0, 0.03), (0.03, 0.0)])
def test_the_bmp390_waits_for_both_its_pressure_and_its_temperature(
    clock: FakeClock, bmp: fake_bmp3.Bmp3, pressure_late_s: float, temperature_late_s: float
) -> None:
    class Apart(TimedBus):
        """Says of each value when it is there; before that the value reads as one not measured yet."""

        forced_s = math.inf

        def transfer(self, address: int, write: bytes, read_length: int) -> bytes:
            if write == b"\x1b\x13":
                self.forced_s = clock.now_s
            answer = super().transfer(address, write, read_length)
            since_s = clock.now_s - self.forced_s - 0.037
            late = [since_s < late_s for late_s in (pressure_late_s, temperature_late_s)]
            if write == b"\x03" and answer[0] & 0x60:
                return bytes([answer[0] & ~(late[0] * 0x20 | late[1] * 0x40)])
            if write == b"\x04":
                halves = zip((answer[:3], answer[3:]), late, strict=True)
                return b"".join(b"\x00\x00\x80" if is_late else half for half, is_late in halves)
            return answer

    assert Bmp3(Apart(bmp, clock)).read().pressure_hpa == pytest.approx(950.0, abs=0.1)


def test_a_bmp390_that_lost_its_supply_voltage_is_not_believed(clock: FakeClock, bmp: fake_bmp3.Bmp3) -> None:
    sensor = Bmp3(TimedBus(bmp, clock))
    assert sensor.read().pressure_hpa == pytest.approx(950.0, abs=0.1)
    bmp.power_cycle()
    clock.now_s += 1.0
    with pytest.raises(TransientError, match="it has restarted and lost its configuration"):
        sensor.read()


def test_the_ms5611_is_left_alone_during_its_reset_and_its_conversions(
    clock: FakeClock, ms: fake_ms5611.Ms5611
) -> None:
    """A conversion takes 9.04 ms at most (data sheet, 4096-fold oversampling), a reset 2.8 ms."""
    bus = TimedBus(ms, clock)
    sensor = Ms5611(bus)
    assert bus.writes == [b"\x1e"]
    began_s = clock.now_s
    reading = sensor.read()
    assert reading.pressure_hpa == pytest.approx(950.0, abs=0.1)
    assert reading.temperature_c == pytest.approx(22.0, abs=0.01)
    assert clock.now_s - began_s < 0.025
    assert ms5611._CONVERSION_S > 0.00904


class StatusOf(TimedBus):
    """A chip whose status register lacks some bits and has others."""

    def __init__(self, chip: I2cChip, clock: FakeClock, register: int, lacks: int, has: int = 0) -> None:
        super().__init__(chip, clock)
        self._register = register
        self._lacks = lacks
        self._has = has

    def transfer(self, address: int, write: bytes, read_length: int) -> bytes:
        answer = super().transfer(address, write, read_length)
        if write == bytes([self._register]) and read_length:
            return bytes([answer[0] & ~self._lacks | self._has])
        return answer


def test_no_bit_but_data_ready_makes_a_sample_of_the_adxl355(
    clock: FakeClock, adxl: fake_adxl355.Adxl355
) -> None:
    """FIFO full and overrun, activity."""
    with pytest.raises(TransientError, match=r"a sample took longer than 0\.5 s"):
        Adxl355(StatusOf(adxl, clock, 0x04, 0x01, 0x0E)).read()


def test_no_bit_but_acceleration_ready_makes_a_sample_of_the_iis2iclx(
    clock: FakeClock, iis: fake_iis2iclx.Iis2iclx
) -> None:
    """Temperature ready."""
    with pytest.raises(TransientError, match=r"a sample took longer than 0\.5 s"):
        Iis2iclx(StatusOf(iis, clock, 0x1E, 0x01, 0x04)).read()


def test_a_field_is_no_temperature_to_the_mmc5983ma(clock: FakeClock, mmc: fake_mmc5983ma.Mmc5983ma) -> None:
    assert Mmc5983ma(StatusOf(mmc, clock, 0x08, 0x02)).read().temperature_c is None


def test_a_temperature_is_no_field_to_the_mmc5983ma(clock: FakeClock, mmc: fake_mmc5983ma.Mmc5983ma) -> None:
    with pytest.raises(TransientError, match=r"a measurement took longer than 0\.2 s"):
        Mmc5983ma(StatusOf(mmc, clock, 0x08, 0x01, 0x02)).read()


@pytest.mark.parametrize(("driver", "noise_ug", "rate_hz"), [(Adxl355, 22.5, 62.5), (Iis2iclx, 15.0, 52.0)])
def test_a_mean_of_one_second_has_the_noise_that_the_density_leaves(
    clock: FakeClock, driver: type[Adxl355] | type[Iis2iclx], noise_ug: float, rate_hz: float
) -> None:
    """Density over sqrt(2 T), whatever the low-pass: 15.9 and 10.6 ug, 0.0009 and 0.0006 deg of tilt.

    It holds for a mean of every sample, at 62.5 and 52 Hz: one that misses some, or counts some twice, is noisier.
    """
    fake = {Adxl355: fake_adxl355.Adxl355, Iis2iclx: fake_iis2iclx.Iis2iclx}[driver]
    chip = fake(lambda: UP, lambda: 22.0, clock=clock, rng=np.random.default_rng(1))
    sensor = driver(TimedBus(chip, clock))
    means_g = []
    for _ in range(40):
        readings = sensor.read_many(1.0)
        assert len(readings) == pytest.approx(rate_hz, abs=2)
        means_g.append([np.mean([r.x_g for r in readings]), np.mean([r.y_g for r in readings])])
    found_ug = float(np.sqrt(np.var(means_g, axis=0, ddof=1).mean()) * 1e6)
    assert found_ug == pytest.approx(noise_ug / math.sqrt(2.0), rel=0.2)
    assert math.degrees(found_ug * 1e-6) < 0.005
