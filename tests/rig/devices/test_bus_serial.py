"""Serial ports, deadlines and the retry policy."""

import os
import termios
import time
from collections.abc import Iterator

import pytest
import serial
from fakes.line import Line

from rig.devices.bus.deadline import Deadline, wait_until
from rig.devices.bus.retry import retry
from rig.devices.bus.serial_port import SerialPort
from rig.errors import DeviceError, TransientError


@pytest.fixture
def line() -> Iterator[Line]:
    line = Line()
    yield line
    line.unplug()


@pytest.fixture
def port(line: Line) -> Iterator[SerialPort]:
    port = SerialPort(line.path, 115200)
    yield port
    port.close()


def test_what_is_there_is_read_at_once(line, port):
    os.write(line.far, b"hello")
    assert port.read(Deadline.after(1.0)) == b"hello"


def test_reading_waits_for_a_first_byte_and_no_longer(line, port):
    line.say_soon(b"x", every_s=0.05)
    started_s = time.monotonic()
    assert port.read(Deadline.after(5.0)) == b"x"
    assert 0.03 < time.monotonic() - started_s < 1.0


def test_reading_ends_at_the_deadline(port):
    started_s = time.monotonic()
    assert port.read(Deadline.after(0.05)) == b""
    assert 0.05 <= time.monotonic() - started_s < 0.5


def test_writing_arrives(line, port):
    port.write(b"\x00\x11\x13\xff")
    assert os.read(line.far, 10) == b"\x00\x11\x13\xff"


def test_discarding_forgets_what_came_before(line, port):
    os.write(line.far, b"old")
    port.discard_input()
    os.write(line.far, b"new")
    assert port.read(Deadline.after(1.0)) == b"new"


@pytest.mark.parametrize("call", ["read", "write", "discard_input"])
def test_a_port_that_goes_away_is_one_clear_line_whatever_is_called(line, port, call):
    line.unplug()
    arguments = {"read": [Deadline.after(0.1)], "write": [b"x"], "discard_input": []}[call]
    with pytest.raises(DeviceError, match=r"^serial port /dev/\S+: stopped working .*; check the cable"):
        getattr(port, call)(*arguments)
    port.close()


@pytest.mark.parametrize("error", [termios.error(5, "I/O"), OSError(5, "I/O"), serial.SerialException("I/O")])
def test_the_three_kinds_of_pyserial_errors_are_one(port, monkeypatch, error):
    def fail(self: serial.Serial) -> None:
        raise error

    monkeypatch.setattr(serial.Serial, "reset_input_buffer", fail)
    with pytest.raises(DeviceError, match=r"stopped working \(I/O\)"):
        port.discard_input()


def test_a_port_in_use_is_named(line, port):
    with pytest.raises(DeviceError, match=f"{line.path}: is in use; end the other program"):
        SerialPort(line.path, 115200)


def test_a_port_that_is_not_there_is_named():
    with pytest.raises(DeviceError, match=r"/dev/not-there: there is no such port; plug the adapter in"):
        SerialPort("/dev/not-there", 115200)


@pytest.mark.parametrize("path", ["/dev/null", "/"])
def test_what_is_no_serial_port_is_named(path):
    with pytest.raises(DeviceError, match=f"serial port {path}: cannot be opened"):
        SerialPort(path, 115200)


def test_a_port_can_be_opened_again_after_closing(line):
    SerialPort(line.path, 115200).close()
    again = SerialPort(line.path, 115200)
    again.close()
    again.close()


def test_a_deadline_runs_on_the_monotonic_clock(monkeypatch):
    now_s = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: now_s[0])
    deadline = Deadline.after(5.0)
    assert (deadline.remaining_s, deadline.expired) == (5.0, False)
    now_s[0] = 106.0
    assert (deadline.remaining_s, deadline.expired) == (0.0, True)


def test_a_condition_is_asked_once_more_after_the_deadline():
    answers = iter([False, True])
    assert wait_until(lambda: next(answers), Deadline.after(0.01), 1.0)
    assert wait_until(lambda: True, Deadline.after(-1.0), 1.0)
    assert not wait_until(lambda: False, Deadline.after(0.01), 0.002)


def transient() -> TransientError:
    return TransientError("thing", "did not answer", "look at it")


def test_what_may_pass_is_tried_again():
    outcomes = iter([transient(), transient(), 7])

    def exchange() -> int:
        outcome = next(outcomes)
        if isinstance(outcome, Exception):
            raise outcome
        return outcome

    assert retry(exchange, tries=3, pause_s=0.001) == 7


def test_the_last_error_is_raised_when_the_tries_are_over():
    calls = []

    def exchange() -> None:
        calls.append(1)
        raise transient()

    with pytest.raises(TransientError):
        retry(exchange, tries=4, pause_s=0.001)
    assert len(calls) == 4


def test_no_try_begins_after_the_time_is_over():
    calls = []

    def exchange() -> None:
        calls.append(1)
        time.sleep(0.03)
        raise transient()

    with pytest.raises(TransientError):
        retry(exchange, tries=100, within_s=0.05, pause_s=0.001)
    assert len(calls) <= 3


def test_what_will_not_pass_is_not_tried_again():
    calls = []

    def exchange() -> None:
        calls.append(1)
        raise DeviceError("thing", "is broken", "buy another")

    with pytest.raises(DeviceError):
        retry(exchange)
    assert len(calls) == 1
