"""Talkers: the newest reading is used, and every wait has a limit."""

import os
import threading
import time
from collections.abc import Iterator

import pytest
from fakes.line import Line

from rig.devices.bus.deadline import Deadline
from rig.devices.bus.serial_port import SerialPort
from rig.devices.readings import HeadingReading
from rig.devices.sensors.talker import LineReader, Talker, nmea_barometer, nmea_compass, vaisala_pa50
from rig.errors import DeviceError, TransientError

OLD = b"$HCHDM,238.5,M*25\r\n"
NEW = b"$HCHDT,128.0,T*22\r\n"


@pytest.fixture
def line() -> Iterator[Line]:
    line = Line()
    yield line
    line.unplug()


@pytest.fixture
def compass(line: Line) -> Iterator[Talker[HeadingReading]]:
    compass = nmea_compass(line.path, 4800)
    yield compass
    compass.close()


def test_the_newest_reading_wins_over_all_that_waited(line, compass):
    os.write(line.far, OLD * 50)
    line.say_soon(NEW)
    assert compass.read().heading_deg == 128.0


def test_the_rest_of_a_sentence_that_had_begun_before_is_not_taken(line, compass):
    os.write(line.far, OLD[:9])
    line.say_soon(OLD[9:], NEW)
    assert compass.read().heading_deg == 128.0


def test_a_sentence_in_pieces_is_put_together(line, compass):
    line.say_soon(NEW[:3], NEW[3:12], NEW[12:], every_s=0.01)
    assert compass.read().heading_deg == 128.0


def test_damaged_and_other_sentences_are_passed_over(line, compass):
    line.say_soon(b"\xff\x00$HCHDM,9\r\n$GPZDA,1*55\r\n" + OLD[:-3] + b"6\r\n" + NEW)
    assert compass.read().heading_deg == 128.0


def test_a_silent_talker_is_given_up_in_time(line, compass):
    started_s = time.monotonic()
    with pytest.raises(
        TransientError, match=r"NMEA compass on /dev/\S+: no HDG, .* last line: nothing; check"
    ):
        compass.read(timeout_s=0.1)
    assert time.monotonic() - started_s < 1.0


def test_a_wrong_baud_rate_shows_in_the_error(line, compass):
    line.say_soon(b"\x80\xf8\x00\n" * 5)
    with pytest.raises(TransientError, match=r"last line: damaged: .*; check `baud` and the cable"):
        compass.read(timeout_s=0.2)


def test_a_talker_of_other_sentences_is_reported_with_the_expected_ones(line, compass):
    line.say_soon(b"$GPZDA,1*55\r\n")
    with pytest.raises(TransientError, match=r"last line: b'\$GPZDA,1\*55'; set the instrument to send"):
        compass.read(timeout_s=0.2)


def test_noise_without_end_is_given_up_in_time(line, compass):
    stop = threading.Event()

    def babble() -> None:
        while not stop.wait(0.002):
            os.write(line.far, b"\x55" * 100 + b"\n")

    thread = threading.Thread(target=babble)
    thread.start()
    try:
        with pytest.raises(TransientError, match="no HDG"):
            compass.read(timeout_s=0.2)
    finally:
        stop.set()
        thread.join()


def test_a_talker_that_is_unplugged_is_one_clear_line(line, compass):
    line.unplug()
    with pytest.raises(DeviceError, match="stopped working"):
        compass.read(timeout_s=0.2)


def test_many_readings_come_one_after_the_other(line, compass):
    os.write(line.far, OLD)
    line.say_soon(*[NEW] * 6, every_s=0.02)
    readings = compass.read_many(0.1)
    assert len(readings) >= 3
    assert {reading.heading_deg for reading in readings} == {128.0}


def test_a_talker_names_itself(line, compass):
    assert compass.identify() == f"NMEA compass on {line.path} at 4800 baud"


def test_an_nmea_barometer(line):
    barometer = nmea_barometer(line.path, 4800)
    line.say_soon(NEW + b"$YXXDR,A,-0.5,D,PITCH,A,1.2,D,ROLL*3F\r\n$WIXDR,P,1028.1,H,0*6C\r\n")
    assert barometer.read().pressure_hpa == 1028.1
    barometer.close()


def test_a_pa50_barometer(line):
    barometer = vaisala_pa50(line.path, 9600)
    line.say_soon(b"200\x0370\r\n", b"\x01P\x021 1009.18 ***.* * 1009.2 1009.2 1009.2 000\x03D6\r\n")
    assert barometer.read().pressure_hpa == 1009.18
    barometer.close()


def test_a_line_that_never_ends_is_dropped(line):
    port = SerialPort(line.path, 4800)
    reader = LineReader(port)
    os.write(line.far, b"x" * 2000)
    assert reader.read_line(Deadline.after(0.05)) is None
    os.write(line.far, b"\r\nnext\r\n")
    lines = [reader.read_line(Deadline.after(0.5)) for _ in range(2)]
    assert lines[1] == b"next"
    assert reader.read_line(Deadline.after(0.01)) is None
    port.close()
