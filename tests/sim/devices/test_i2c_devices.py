"""The fake I2C chips at their registers, and the bridge at its socket."""

import math
import socket
import struct
import threading
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from sim.devices import ms5611
from sim.devices.adxl355 import Adxl355
from sim.devices.bmp3 import TRIMS, Bmp3, Trim
from sim.devices.i2c_bridge import I2cBridge
from sim.devices.i2c_chip import I2cChip
from sim.devices.iis2iclx import Iis2iclx
from sim.devices.mmc5983ma import Mmc5983ma
from sim.devices.ms5611 import Ms5611


class Surroundings:
    """Input of the chips, and a manual clock."""

    def __init__(self) -> None:
        self.now_s = 50.0
        self.acceleration = np.array([0.1, -0.2, 0.97])
        self.field = np.array([20.0, -3.0, -40.0])
        self.pressure_pa = 95_000.0
        self.air_c = 12.5

    def clock(self) -> float:
        return self.now_s

    def acceleration_g(self) -> NDArray[np.float64]:
        return self.acceleration

    def field_ut(self) -> NDArray[np.float64]:
        return self.field

    def pressure(self) -> float:
        return self.pressure_pa

    def temperature_c(self) -> float:
        return self.air_c


@pytest.fixture
def around() -> Surroundings:
    return Surroundings()


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)


def read(chip: I2cChip, register: int, length: int = 1) -> bytes:
    return chip.transfer(bytes([register]), length)


def write(chip: I2cChip, register: int, *values: int) -> None:
    assert chip.transfer(bytes([register, *values]), 0) == b""


class TestAdxl355:
    @pytest.fixture
    def chip(self, around: Surroundings, rng: np.random.Generator) -> Adxl355:
        return Adxl355(around.acceleration_g, around.temperature_c, clock=around.clock, rng=rng)

    def axes_g(self, chip: Adxl355, lsb_g: float = 1 / 256_000) -> NDArray[np.float64]:
        data = read(chip, 0x08, 9)
        words = [int.from_bytes(data[i : i + 3], "big", signed=True) >> 4 for i in (0, 3, 6)]
        return np.array(words) * lsb_g

    def test_identity_and_defaults(self, chip: Adxl355) -> None:
        assert read(chip, 0x00, 3) == bytes([0xAD, 0x1D, 0xED])
        assert read(chip, 0x2C, 2) == bytes([0x81, 0x01])

    def test_the_first_samples_are_of_a_filter_that_is_filling(
        self, chip: Adxl355, around: Surroundings
    ) -> None:
        write(chip, 0x28, 0x06)
        write(chip, 0x2D, 0x00)
        shares = []
        for _ in range(5):
            around.now_s += 1.001 / 62.5
            shares.append(self.axes_g(chip)[2] / around.acceleration[2])
        assert shares == pytest.approx([0.25, 0.5, 0.75, 1.0, 1.0], abs=0.001)

    def test_measures_only_out_of_standby(self, chip: Adxl355, around: Surroundings) -> None:
        around.now_s += 1.0
        assert (read(chip, 0x04), read(chip, 0x08, 9)) == (b"\x00", bytes(9))
        write(chip, 0x2D, 0x00)
        assert read(chip, 0x04) == b"\x00"
        around.now_s += 0.01
        assert read(chip, 0x04) == b"\x07"  # ready; 4000 Hz has filled and overrun the FIFO in 10 ms
        np.testing.assert_allclose(self.axes_g(chip), around.acceleration, atol=0.005)
        assert read(chip, 0x04)[0] & 0x01 == 0

    def test_noise_has_the_density_behind_the_low_pass(self, chip: Adxl355, around: Surroundings) -> None:
        write(chip, 0x28, 0x05)  # 125 Hz, corner 31.25 Hz
        write(chip, 0x2D, 0x00)
        around.now_s += 0.1
        assert self.axes_g(chip) == pytest.approx(around.acceleration, abs=0.001)
        samples = []
        for _ in range(4000):
            around.now_s += 1 / 125
            samples.append(self.axes_g(chip))
        assert np.std(samples, axis=0) == pytest.approx(22.5e-6 * math.sqrt(125 / 4), rel=0.1)
        second_means = np.mean(np.reshape(samples, (-1, 125, 3)), axis=1)
        assert np.mean(np.std(second_means, axis=0)) == pytest.approx(22.5e-6 * math.sqrt(0.5), rel=0.35)

    def test_range_scales_and_saturates(self, chip: Adxl355, around: Surroundings) -> None:
        around.acceleration = np.array([3.0, -3.0, 0.5])
        write(chip, 0x2D, 0x00)
        around.now_s += 0.01
        assert read(chip, 0x08, 6) == bytes.fromhex("7FFFF0 800000")
        write(chip, 0x2C, 0x82)
        around.now_s += 0.01
        np.testing.assert_allclose(self.axes_g(chip, 2 / 256_000), around.acceleration, atol=0.005)

    def test_filter_is_locked_while_measuring(self, chip: Adxl355) -> None:
        write(chip, 0x2D, 0x00)
        write(chip, 0x28, 0x05)
        assert read(chip, 0x28) == b"\x00"
        write(chip, 0x2D, 0x01)
        write(chip, 0x28, 0x05)
        assert read(chip, 0x28) == b"\x05"

    def test_offset_registers_count_sixteen_lsb(self, chip: Adxl355, around: Surroundings) -> None:
        around.acceleration = np.zeros(3)
        write(chip, 0x1E, 0x01, 0x00)
        write(chip, 0x2D, 0x00)
        around.now_s += 0.01
        assert self.axes_g(chip)[0] == pytest.approx(256 * 16 / 256_000, abs=0.003)

    def test_fifo_marks_the_x_axis_and_emptiness(self, chip: Adxl355, around: Surroundings) -> None:
        write(chip, 0x28, 0x05)
        write(chip, 0x2D, 0x00)
        around.now_s += 0.0241
        assert read(chip, 0x05) == b"\x09"
        data = read(chip, 0x11, 30)
        markers = [data[i] & 0x03 for i in range(2, 30, 3)]
        assert markers == [1, 0, 0, 1, 0, 0, 1, 0, 0, 2]

    def test_reset_reads_as_busy_and_restores_the_shadow(self, chip: Adxl355, around: Surroundings) -> None:
        around.now_s += 0.01
        shadow = read(chip, 0x50, 5)
        write(chip, 0x2C, 0x83)
        write(chip, 0x2F, 0x52)
        assert (read(chip, 0x04), read(chip, 0x50, 5)) == (b"\x10", bytes(5))
        around.now_s += 0.029
        assert (read(chip, 0x04), read(chip, 0x50, 5)) == (b"\x10", bytes(5))
        around.now_s += 0.002
        assert (read(chip, 0x50, 5), read(chip, 0x2C)) == (shadow, b"\x81")

    def test_temperature(self, chip: Adxl355, around: Surroundings) -> None:
        write(chip, 0x2D, 0x00)
        around.now_s += 0.01
        raw = int.from_bytes(read(chip, 0x06, 2), "big")
        assert 25 + (raw - 1885) / -9.05 == pytest.approx(12.5, abs=0.5)


class TestIis2iclx:
    @pytest.fixture
    def chip(self, around: Surroundings, rng: np.random.Generator) -> Iis2iclx:
        return Iis2iclx(around.acceleration_g, around.temperature_c, clock=around.clock, rng=rng)

    @pytest.mark.parametrize(("code", "mg"), [(0, 0.015), (1, 0.122), (2, 0.031), (3, 0.061)])
    def test_full_scale_codes_are_not_monotonic(
        self, chip: Iis2iclx, around: Surroundings, code: int, mg: float
    ) -> None:
        write(chip, 0x10, 0x40 | code << 2)
        around.now_s += 0.1
        assert read(chip, 0x1E)[0] & 0x01
        x, y = struct.unpack("<hh", read(chip, 0x28, 4))
        assert (x * mg / 1000, y * mg / 1000) == pytest.approx((0.1, -0.2), abs=0.001)
        assert read(chip, 0x1E)[0] & 0x01 == 0

    def test_identity_and_silence_when_off(self, chip: Iis2iclx, around: Surroundings) -> None:
        around.now_s += 1.0
        assert (read(chip, 0x0F), read(chip, 0x1E), read(chip, 0x28, 4)) == (b"\x6b", b"\x00", bytes(4))

    def test_low_pass_narrows_the_noise(self, chip: Iis2iclx, around: Surroundings) -> None:
        deviations = []
        for control, slope in ((0x40, 0), (0x42, 2 << 5)):
            write(chip, 0x17, slope)
            write(chip, 0x10, control)
            around.now_s += 1.0
            read(chip, 0x28, 4)
            xs = []
            for _ in range(3000):
                around.now_s += 1 / 104
                xs.append(struct.unpack("<hh", read(chip, 0x28, 4))[0] * 0.015e-3)
            deviations.append(np.std(xs))
        assert deviations[0] == pytest.approx(15e-6 * math.sqrt(52), rel=0.1)
        assert deviations[1] == pytest.approx(15e-6 * math.sqrt(104 / 20), rel=0.15)

    def test_block_update_keeps_both_bytes_of_one_sample(self, chip: Iis2iclx, around: Surroundings) -> None:
        write(chip, 0x12, 0x44)
        write(chip, 0x10, 0x40)
        around.now_s += 0.1
        low = read(chip, 0x28)[0]
        around.acceleration = np.array([-0.3, 0.4, 0.8])
        around.now_s += 0.1
        value = int.from_bytes([low, read(chip, 0x29)[0]], "little", signed=True)
        assert value * 0.015e-3 == pytest.approx(0.1, abs=0.001)
        assert struct.unpack("<h", read(chip, 0x28, 2))[0] * 0.015e-3 == pytest.approx(-0.3, abs=0.001)

    def test_soft_reset_clears_itself(self, chip: Iis2iclx, around: Surroundings) -> None:
        write(chip, 0x10, 0x40)
        write(chip, 0x12, 0x01)
        assert read(chip, 0x12) == b"\x05"
        around.now_s += 0.002
        assert (read(chip, 0x12), read(chip, 0x10)) == (b"\x04", b"\x00")


class TestMmc5983ma:
    OFFSET_UT = (30.0, -12.0, 5.0)

    @pytest.fixture
    def chip(self, around: Surroundings, rng: np.random.Generator) -> Mmc5983ma:
        chip = Mmc5983ma(
            around.field_ut,
            around.temperature_c,
            clock=around.clock,
            rng=rng,
            bridge_offset_ut=self.OFFSET_UT,
        )
        around.now_s += 0.02
        return chip

    def measure(self, chip: Mmc5983ma, around: Surroundings) -> NDArray[np.float64]:
        write(chip, 0x09, 0x01)
        assert read(chip, 0x08)[0] & 0x01 == 0
        around.now_s += 0.0085
        assert read(chip, 0x08)[0] & 0x01 == 1
        data = read(chip, 0x00, 7)
        counts = [data[2 * i] << 10 | data[2 * i + 1] << 2 | (data[6] >> 6 - 2 * i & 3) for i in range(3)]
        return (np.array(counts) - 131072) / 163.84

    def test_set_and_reset_uncover_the_offset(self, chip: Mmc5983ma, around: Surroundings) -> None:
        assert read(chip, 0x2F) == b"\x30"
        write(chip, 0x09, 0x08)
        after_set = self.measure(chip, around)
        write(chip, 0x09, 0x10)
        after_reset = self.measure(chip, around)
        np.testing.assert_allclose((after_set - after_reset) / 2, around.field, atol=0.15)
        np.testing.assert_allclose((after_set + after_reset) / 2, self.OFFSET_UT, atol=0.15)

    def test_control_registers_cannot_be_read(self, chip: Mmc5983ma) -> None:
        write(chip, 0x0A, 0x03)
        assert read(chip, 0x0A) == b"\x00"

    def test_a_strong_field_saturates(self, chip: Mmc5983ma, around: Surroundings) -> None:
        around.field = np.array([900.0, -900.0, 0.0])
        np.testing.assert_allclose(self.measure(chip, around)[:2], [800.0, -800.0], atol=0.01)

    def test_bandwidth_sets_the_duration(self, chip: Mmc5983ma, around: Surroundings) -> None:
        write(chip, 0x0A, 0x03)
        write(chip, 0x09, 0x01)
        around.now_s += 0.0006
        assert read(chip, 0x08)[0] & 0x01

    def test_continuous_mode_measures_by_itself(self, chip: Mmc5983ma, around: Surroundings) -> None:
        write(chip, 0x0B, 0x0D)
        read(chip, 0x08)
        around.now_s += 0.011
        assert read(chip, 0x08)[0] & 0x01

    def test_temperature_and_reset(self, chip: Mmc5983ma, around: Surroundings) -> None:
        write(chip, 0x09, 0x02)
        around.now_s += 0.01
        assert read(chip, 0x08)[0] & 0x02
        assert read(chip, 0x07)[0] * 0.8 - 75 == pytest.approx(12.5, abs=0.5)
        write(chip, 0x0A, 0x80)
        with pytest.raises(OSError, match="acknowledge"):
            read(chip, 0x2F)


@pytest.mark.parametrize(
    ("trim_hex", "data_hex", "temperature_c", "pressure_pa"),
    [
        (
            "236B5849F65CFFCEF42300EA636E79F3F6AA4312C4",
            "979F6D73D885",
            30.499314453874284,
            100876.00634692199,
        ),
        ("986CA94AF9E31C61160601514ADE5D03FAF90E06F5", "CBB36BD1BA82", 25.770745473616987, 98370.56628475757),
        (
            "986E134DF9B01BC0150601924AAE5D03FA080F06F5",
            "92516579CE83",
            25.498167027511645,
            100548.40477814537,
        ),
    ],
)
def test_bmp3_compensation_has_the_golden_values_and_turns_round(
    trim_hex: str, data_hex: str, temperature_c: float, pressure_pa: float
) -> None:
    trim, data = Trim.of(bytes.fromhex(trim_hex)), bytes.fromhex(data_hex)
    raw_pressure, raw_temperature = (int.from_bytes(data[i : i + 3], "little") for i in (0, 3))
    assert trim.temperature_c(raw_temperature) == pytest.approx(temperature_c, rel=1e-12)
    assert trim.pressure_pa(raw_pressure, temperature_c) == pytest.approx(pressure_pa, rel=1e-12)
    assert trim.raw_temperature(temperature_c) == raw_temperature
    assert trim.raw_pressure(pressure_pa, temperature_c) == raw_pressure


class TestBmp3:
    @pytest.fixture(params=["bmp390", "bmp388"])
    def model(self, request: pytest.FixtureRequest) -> str:
        return str(request.param)

    @pytest.fixture
    def chip(self, model: str, around: Surroundings, rng: np.random.Generator) -> Bmp3:
        return Bmp3(model, around.pressure, around.temperature_c, clock=around.clock, rng=rng)

    def value(self, chip: Bmp3, model: str) -> tuple[float, float]:
        data = read(chip, 0x04, 6)
        trim = Trim.of(read(chip, 0x31, 21))
        temperature_c = trim.temperature_c(int.from_bytes(data[3:], "little"))
        return trim.pressure_pa(int.from_bytes(data[:3], "little"), temperature_c), temperature_c

    def test_identity_and_start(self, chip: Bmp3, model: str, around: Surroundings) -> None:
        assert read(chip, 0x00) == {"bmp390": b"\x60", "bmp388": b"\x50"}[model]
        assert read(chip, 0x04, 6) == bytes.fromhex("000080000080")
        assert (read(chip, 0x03), read(chip, 0x31, 21)) == (b"\x00", bytes(21))
        write(chip, 0x1C, 0x0D)
        assert read(chip, 0x1C) == b"\x02", "it takes nothing before it is ready"
        around.now_s += 0.011
        assert (read(chip, 0x03), read(chip, 0x31, 21)) == (b"\x10", TRIMS[model])
        assert (read(chip, 0x10), read(chip, 0x10)) == (b"\x01", b"\x00")

    def test_forced_mode_converts_once(self, chip: Bmp3, model: str, around: Surroundings) -> None:
        around.now_s += 0.011
        chip.transfer(bytes([0x1C, 0x0D, 0x1B, 0x13]), 0)  # pairs: oversampling 32 and 2, then forced
        around.now_s += 0.065
        assert read(chip, 0x04, 3) == bytes.fromhex("000080")
        around.now_s += 0.006
        assert read(chip, 0x03)[0] == 0x70
        assert read(chip, 0x1B) == b"\x03"
        pressure_pa, temperature_c = self.value(chip, model)
        assert pressure_pa == pytest.approx(around.pressure_pa, abs=5.0)
        assert temperature_c == pytest.approx(12.5, abs=0.03)
        assert read(chip, 0x03)[0] == 0x10

    def test_normal_mode_with_filter_is_quieter(self, chip: Bmp3, model: str, around: Surroundings) -> None:
        spreads = []
        around.now_s += 0.011
        for config in (0x00, 0x08):
            chip.transfer(bytes([0x1B, 0x00, 0x1C, 0x05, 0x1D, 0x04, 0x1F, config, 0x1B, 0x33]), 0)
            values = []
            for _ in range(300):
                around.now_s += 0.08
                values.append(self.value(chip, model)[0])
            spreads.append(np.std(values[100:]))
        assert spreads[0] == pytest.approx(0.9, rel=0.2)
        assert spreads[1] < 0.5

    def test_a_rate_that_is_too_fast_is_a_configuration_error(self, chip: Bmp3, around: Surroundings) -> None:
        around.now_s += 0.011
        chip.transfer(bytes([0x1C, 0x05, 0x1D, 0x00, 0x1B, 0x33]), 0)
        assert (read(chip, 0x02), read(chip, 0x1B)) == (b"\x04", b"\x03")

    def test_soft_reset(self, chip: Bmp3, around: Surroundings) -> None:
        around.now_s += 0.011
        write(chip, 0x1C, 0x05)
        assert read(chip, 0x1C) == b"\x05"
        write(chip, 0x7E, 0xB6)
        assert read(chip, 0x1C) == b"\x02"


class TestMs5611:
    @pytest.fixture
    def chip(self, around: Surroundings, rng: np.random.Generator) -> Ms5611:
        return Ms5611(around.pressure, around.temperature_c, clock=around.clock, rng=rng)

    def convert(self, chip: Ms5611, around: Surroundings, command: int) -> int:
        chip.transfer(bytes([command]), 0)
        around.now_s += 0.0091
        return int.from_bytes(chip.transfer(b"\x00", 3), "big")

    def test_golden_crc(self) -> None:
        assert ms5611.crc4([0x3132, 0x3334, 0x3536, 0x3738, 0x3940, 0x4142, 0x4344, 0x4500]) == 0xB

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
    def test_golden_compensation(self, d2: int, temperature: int, pressure_pa: int) -> None:
        assert ms5611.compensate(9085466, d2) == (temperature, pressure_pa)

    @pytest.mark.parametrize("air_c", [25.0, 12.5, -20.0])
    def test_raw_words_compensate_to_the_truth(
        self, chip: Ms5611, around: Surroundings, air_c: float
    ) -> None:
        around.air_c = air_c
        d1, d2 = self.convert(chip, around, 0x48), self.convert(chip, around, 0x58)
        temperature, pressure_pa = ms5611.compensate(d1, d2)
        assert temperature == pytest.approx(air_c * 100, abs=2)
        assert pressure_pa == pytest.approx(around.pressure_pa, abs=6)

    def test_prom_checks(self, chip: Ms5611) -> None:
        words = [int.from_bytes(chip.transfer(bytes([0xA0 + 2 * i]), 2), "big") for i in range(8)]
        assert tuple(words[1:7]) == (40127, 36924, 23317, 23282, 33464, 28312)
        assert words[7] & 0x0F == ms5611.crc4(words)

    def test_early_and_repeated_reads_give_nothing(self, chip: Ms5611, around: Surroundings) -> None:
        chip.transfer(b"\x48", 0)
        around.now_s += 0.005
        assert chip.transfer(b"\x00", 3) == bytes(3)
        around.now_s += 0.005
        assert chip.transfer(b"\x00", 3) == bytes(3)
        assert self.convert(chip, around, 0x48) > 0
        assert chip.transfer(b"\x00", 3) == bytes(3)

    def test_reset_is_not_acknowledged_to(self, chip: Ms5611, around: Surroundings) -> None:
        chip.transfer(b"\x1e", 0)
        with pytest.raises(OSError, match="acknowledge"):
            chip.transfer(b"\xa0", 2)
        around.now_s += 0.003
        assert chip.transfer(b"\xa2", 2) == (40127).to_bytes(2, "big")


@given(st.lists(st.tuples(st.binary(max_size=8), st.integers(0, 32)), max_size=12))
def test_no_transfer_however_odd_breaks_a_chip(transfers: list[tuple[bytes, int]]) -> None:
    around, rng = Surroundings(), np.random.default_rng(3)
    common: dict[str, Any] = {"clock": around.clock, "rng": rng}
    chips: list[I2cChip] = [
        Adxl355(around.acceleration_g, around.temperature_c, **common),
        Iis2iclx(around.acceleration_g, around.temperature_c, **common),
        Mmc5983ma(around.field_ut, around.temperature_c, **common),
        Bmp3("bmp390", around.pressure, around.temperature_c, **common),
        Ms5611(around.pressure, around.temperature_c, **common),
    ]
    for write_bytes, length in transfers:
        around.now_s += 0.03
        for chip in chips:
            assert len(chip.transfer(write_bytes, length)) == length


class Echo:
    """A chip that answers with what was written, backwards."""

    address = 0x42

    def transfer(self, write: bytes, read_length: int) -> bytes:
        return write[::-1][:read_length]


Transfer = Callable[[int, int, bytes, int], tuple[int, bytes]]


@pytest.fixture
def bridge() -> Iterator[I2cBridge]:
    bridge = I2cBridge({1: [Echo()], 2: []})
    yield bridge
    bridge.close()


@pytest.fixture
def transfer(bridge: I2cBridge) -> Iterator[Transfer]:
    host, port = bridge.url(1).removeprefix("tcp://").removesuffix("/1").split(":")
    with (
        socket.create_connection((host, int(port)), timeout=5) as connection,
        connection.makefile("rb") as answers,
    ):

        def one(bus: int, address: int, data: bytes, length: int) -> tuple[int, bytes]:
            connection.sendall(struct.pack(">BBHH", bus, address, len(data), length) + data)
            errno, count = struct.unpack(">HH", answers.read(4))
            return errno, answers.read(count)

        yield one


def test_the_bridge_carries_transfers_and_errors(bridge: I2cBridge, transfer: Transfer) -> None:
    assert transfer(1, 0x42, b"abc", 2) == (0, b"cb")
    assert transfer(1, 0x43, b"", 1) == (121, b"")
    assert transfer(2, 0x42, b"", 1) == (121, b"")
    bridge.fault = lambda bus, address: 110
    assert transfer(1, 0x42, b"abc", 2) == (110, b"")


def test_closing_the_bridge_ends_its_thread_with_clients_connected(
    bridge: I2cBridge, transfer: Transfer
) -> None:
    transfer(1, 0x42, b"", 0)
    bridge.close()
    bridge.close()
    assert not any(thread.name == "i2c bridge" for thread in threading.enumerate())
