"""What is overcome without the operator: lost ports, restarted chips, a stepped clock. And that it is noted."""

import itertools
import os
import pty
import threading
import time
import tty
from collections.abc import Sequence
from datetime import timedelta
from pathlib import Path

import pytest

from rig import clock
from rig.clock import Instant
from rig.devices.bus.deadline import Deadline
from rig.devices.bus.retry import retry
from rig.devices.bus.serial_port import SerialPort
from rig.devices.sensors.reconnecting import ReconnectingSensor
from rig.errors import DeviceError, LostPortError, TransientError, WrongDeviceError
from rig.fault_notes import collecting, note_fault


class Adapter:
    """A USB adapter with a lasting name, whose terminal changes with each plugging in."""

    def __init__(self, folder: Path) -> None:
        self.link = folder / "usb-adapter"
        self.ends: tuple[int, int] = (-1, -1)
        self.used = False
        self.plug_in()

    def plug_in(self) -> None:
        skip_failed_sensors = (
            pty.openpty() if self.used else ()
        )  # the system gives the lowest free number again
        self.used = True
        self.ends = pty.openpty()
        for end in skip_failed_sensors:
            os.close(end)
        tty.setraw(self.ends[1])
        self.link.symlink_to(os.ttyname(self.ends[1]))

    def unplug(self) -> None:
        self.link.unlink()
        for end in self.ends:
            os.close(end)
        self.ends = (-1, -1)


@pytest.fixture
def adapter(tmp_path: Path) -> Adapter:
    return Adapter(tmp_path)


def test_a_port_that_comes_back_under_another_name_is_found_again(adapter: Adapter) -> None:
    port = SerialPort(str(adapter.link), 115200)
    first = adapter.link.readlink()
    adapter.unplug()
    threading.Timer(0.3, adapter.plug_in).start()
    with collecting() as notes:
        retry(lambda: port.write(b"hello"), replug_s=3.0)
    assert os.read(adapter.ends[0], 10) == b"hello"
    assert adapter.link.readlink() != first
    assert {note.action for note in notes.all()} == {"waited for it to come back"}
    os.write(adapter.ends[0], b"answer")
    assert port.read(Deadline.after(1.0)) == b"answer"
    port.close()


def test_a_port_that_does_not_come_back_is_given_up_in_time(adapter: Adapter) -> None:
    port = SerialPort(str(adapter.link), 115200)
    adapter.unplug()
    begun_s = time.monotonic()
    with pytest.raises(LostPortError, match="usb-adapter: there is no such port; plug the adapter in"):
        retry(lambda: port.write(b"hello"), replug_s=0.4)
    assert time.monotonic() - begun_s < 1.0
    port.close()


class Chip:
    """Has to be set up; a restart loses that."""

    def __init__(self) -> None:
        self.set_up = 0
        self.working = False
        self.closed = 0

    def connect(self) -> "Chip":
        self.set_up += 1
        self.working = True
        return self

    def identify(self) -> str:
        return "chip"

    def read_many(self, duration_s: float) -> Sequence[int]:
        if not self.working:
            raise TransientError("chip", "has no sample", "power-cycle it")
        return [7]

    def close(self) -> None:
        self.closed += 1


def test_a_chip_that_reset_is_configured_again() -> None:
    chip = Chip()
    sensor = ReconnectingSensor(chip.connect)
    assert sensor.read_many(0.0) == [7]
    chip.working = False
    with collecting() as notes:
        assert retry(lambda: sensor.read_many(0.0)) == [7]
    assert (chip.set_up, chip.closed) == (2, 1)
    (note,) = notes.all()
    assert (note.device, note.problem, note.action, note.count) == ("chip", "has no sample", "tried again", 1)
    sensor.close()
    sensor.close()
    assert chip.closed == 2


def test_another_chip_in_its_place_is_no_reading() -> None:
    chip = Chip()
    sensor = ReconnectingSensor(chip.connect)
    chip.working = False

    def other() -> Chip:
        raise WrongDeviceError("chip", "is another one", "correct `address`")

    sensor._connect = other
    with pytest.raises(WrongDeviceError):
        retry(lambda: sensor.read_many(0.0))


def test_faults_are_counted_from_any_thread_and_only_while_collected() -> None:
    note_fault("camera", "was black", "taken again")
    with collecting() as notes:
        threads = [
            threading.Thread(target=note_fault, args=("camera", "was black", "taken again")) for _ in range(9)
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    note_fault("camera", "was black", "taken again")
    (note,) = notes.as_json()
    assert note["count"] == 9
    assert note["first"]["monotonic_s"] <= note["last"]["monotonic_s"]
    assert note["first"]["time"].endswith("Z")


def test_the_times_of_a_session_belong_together_whatever_the_wall_clock_does(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    offset = tmp_path / "offset"
    monkeypatch.setenv(clock.OFFSET_VARIABLE, str(offset))
    clock.begin_session()
    before = Instant.now()
    offset.write_text("3600\n")
    after = Instant.now()
    assert after.utc - before.utc < timedelta(seconds=1)
    assert clock.step_s() == pytest.approx(3600.0, abs=0.1)
    clock.begin_session()
    assert clock.step_s() == pytest.approx(0.0, abs=0.1)
    assert Instant.now().utc - after.utc > timedelta(minutes=59)
    monkeypatch.delenv(clock.OFFSET_VARIABLE)
    clock.begin_session()


def test_the_first_error_that_will_not_pass_ends_the_trying() -> None:
    errors = itertools.chain(
        [TransientError("a", "b", "c")], itertools.repeat(DeviceError("a", "broken", "c"))
    )

    def exchange() -> None:
        raise next(errors)

    with pytest.raises(DeviceError, match="broken"):
        retry(exchange)
