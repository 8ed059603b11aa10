"""Any bytes from any device: a value or one named error, and what is good afterwards is still understood."""

import contextlib
import os

import pytest
from fakes.chips import FakeI2cBus
from fakes.line import Line
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from rig.clock import Instant
from rig.devices.bus.deadline import Deadline
from rig.devices.bus.serial_port import SerialPort
from rig.devices.sensors import adxl355, bmp3, iis2iclx, mmc5983ma, ms5611
from rig.devices.sensors.nmea import checksum, parse_heading, parse_sentence
from rig.devices.sensors.talker import LineReader
from rig.devices.sensors.vaisala import parse_pa50
from rig.errors import DeviceError, MessageError

AT = Instant.now()
GOOD = b"$HCHDM,238.5,M*25\r\n"
PA50 = b"\x01P\x021 1009.18 ***.* * 1009.2 1009.2 1009.2 000\x03D6\r\n"

# What a receiver meets: noise, pieces of good messages, and things that nearly are some.
pieces = st.lists(
    st.binary(max_size=30)
    | st.sampled_from([GOOD[:9], GOOD[9:], b"$", b"*", b"\r\n", b"\x01P\x021", PA50[:20], PA50[-6:]]),
    max_size=8,
).map(b"".join)


class Babbling:
    """A chip that answers any read with bytes of the example's choice, over and over."""

    def __init__(self, data: bytes) -> None:
        self._data = data or b"\x00"
        self._next = 0

    def transfer(self, write: bytes, read_length: int) -> bytes:
        answer = bytes(self._data[(self._next + i) % len(self._data)] for i in range(read_length))
        self._next += read_length
        return answer


@pytest.fixture(autouse=True)
def hurry(monkeypatch: pytest.MonkeyPatch) -> None:
    """A chip that babbles makes a driver wait for what never comes; how long is not the subject."""
    monkeypatch.setattr("time.sleep", lambda seconds: None)
    for module in (adxl355, iis2iclx):
        monkeypatch.setattr(module, "_READY_TIMEOUT_S", 0.001)
    for module in (bmp3, mmc5983ma):
        monkeypatch.setattr(module, "_TIMEOUT_S", 0.001)


DRIVERS = {
    "adxl355": (adxl355.Adxl355, bytes.fromhex("ad1ded")),
    "iis2iclx": (iis2iclx.Iis2iclx, b"\x6b"),
    "mmc5983ma": (mmc5983ma.Mmc5983ma, b"\x30"),
    "bmp3": (bmp3.Bmp3, b"\x60"),
    "ms5611": (ms5611.Ms5611, b""),
}


@pytest.mark.parametrize("name", DRIVERS)
@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.binary(min_size=1, max_size=64))
def test_a_chip_that_babbles_gives_a_reading_or_a_device_error(name: str, data: bytes) -> None:
    driver, identity = DRIVERS[name]
    for answers in (data, identity + data):
        bus = FakeI2cBus({0x1D: Babbling(answers)})  # type: ignore[dict-item]
        with contextlib.suppress(DeviceError):
            driver(bus, 0x1D).read_many(0.0)


@given(st.binary(min_size=21, max_size=21), st.integers(0, 0xFFFFFF), st.integers(0, 0xFFFFFF))
def test_any_trim_and_any_raw_values_compensate_to_numbers(
    trim: bytes, pressure: int, temperature: int
) -> None:
    pressure_pa, temperature_c = bmp3.compensate(bmp3.Trim.decode(trim), pressure, temperature)
    assert isinstance(pressure_pa, float)
    assert isinstance(temperature_c, float)


@given(st.binary(min_size=11, max_size=11))
def test_any_burst_of_an_accelerometer_or_magnetometer_decodes_within_its_range(data: bytes) -> None:
    assert -(1 << 19) <= adxl355.decode_axis(data[2:5]) < 1 << 19
    assert -220.0 < adxl355.decode_temperature_c(data[:2]) < 234.0
    assert abs(iis2iclx.decode_acceleration_g(data[:2], 1.0)) < 1.02
    assert all(-(1 << 17) <= counts < 1 << 17 for counts in mmc5983ma.decode_field(data[:7]))


@settings(max_examples=40, deadline=None)
@given(noise=pieces, cuts=st.lists(st.integers(1, 20), max_size=5))
def test_a_talker_is_understood_after_any_noise(noise: bytes, cuts: list[int]) -> None:
    """Over a real terminal, in pieces: the second good line at the latest (the first may end a line of noise)."""
    line = Line()
    port = SerialPort(line.path, 4800)
    try:
        reader, data, headings = LineReader(port), noise + GOOD + GOOD, []
        for cut in cuts:
            os.write(line.far, data[:cut])
            data = data[cut:]
        os.write(line.far, data)
        while (text := reader.read_line(Deadline.after(0.02))) is not None:
            with contextlib.suppress(MessageError):
                reading = parse_heading(parse_sentence(text), AT)
                headings += [reading.heading_deg] if reading else []
        assert headings[-1:] == [238.5]
    finally:
        port.close()
        line.unplug()


@given(noise=pieces.filter(lambda noise: b"\n" not in noise))
def test_a_barometer_is_understood_after_any_noise_on_its_line(noise: bytes) -> None:
    assert parse_pa50(noise + PA50, AT).pressure_hpa == 1009.18


@given(st.text("0123456789.,ACEMNTW", max_size=40).map(str.encode), st.integers(0, 39), st.integers(1, 255))
def test_a_sentence_with_one_wrong_byte_is_refused(body: bytes, place: int, bits: int) -> None:
    sent = b"$HCHDM," + body + b"*" + f"{checksum(b'HCHDM,' + body):02X}".encode()
    wrong = bytearray(sent)
    wrong[7 + place % max(1, len(body))] ^= bits
    if body and bytes(wrong) != sent and b"$" not in wrong[1:]:  # with a $ another sentence begins
        with pytest.raises(MessageError):
            parse_sentence(bytes(wrong))
