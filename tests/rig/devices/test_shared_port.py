"""One serial port shared by two devices: both receive everything, in several threads, and neither closes it for the
other.
"""

import os
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from fakes.line import Line

from rig import sysfs
from rig.devices.bus.deadline import Deadline
from rig.devices.bus.serial_port import SerialPort
from rig.devices.bus.shared_port import SharedPort
from rig.devices.sensors.talker import nmea_barometer, nmea_compass
from rig.errors import DeviceError
from rig.fault_notes import collecting

HEADING = b"$HCHDM,238.5,M*25\r\n"
PRESSURE = b"$WIXDR,P,1028.1,H,0*6C\r\n"


@pytest.fixture
def line() -> Iterator[Line]:
    line = Line()
    yield line
    line.unplug()


def test_a_compass_and_a_barometer_share_one_stream(line: Line) -> None:
    compass, barometer = nmea_compass(line.path, 4800), nmea_barometer(line.path, 4800)
    stop = threading.Event()

    def talk() -> None:
        while not stop.wait(0.02):
            os.write(line.far, HEADING[:9])
            os.write(line.far, HEADING[9:] + PRESSURE)

    speaker = threading.Thread(target=talk)
    found: dict[str, list[float]] = {}
    readers = [
        threading.Thread(target=lambda: found.update(h=[r.heading_deg for r in compass.read_many(0.3)])),
        threading.Thread(target=lambda: found.update(p=[r.pressure_hpa for r in barometer.read_many(0.3)])),
    ]
    with collecting() as faults:
        for thread in (speaker, *readers):
            thread.start()
        for thread in readers:
            thread.join()
        stop.set()
        speaker.join()
    compass.close()
    barometer.close()
    assert set(found["h"]) == {238.5}
    assert set(found["p"]) == {1028.1}
    assert min(len(found["h"]), len(found["p"])) >= 5
    assert not faults.all()


def test_one_that_closes_does_not_take_the_port_from_the_other(line: Line, tmp_path: Path) -> None:
    other_name = tmp_path / "by-id"
    other_name.symlink_to(line.path)
    first, second = SharedPort(line.path, 4800), SharedPort(str(other_name), 4800)
    first.close()
    first.close()
    os.write(line.far, b"x")
    assert second.read(Deadline.after(0.5)) == b"x"
    with pytest.raises(DeviceError, match="is closed"):
        first.read(Deadline.after(0.0))
    with pytest.raises(DeviceError, match="is in use"):
        SerialPort(line.path, 4800)
    second.close()
    SerialPort(line.path, 4800).close()


def test_what_is_old_is_thrown_away_by_each_for_itself(line: Line) -> None:
    first, second = SharedPort(line.path, 4800), SharedPort(line.path, 4800)
    os.write(line.far, b"old")
    first.discard_input()
    assert first.read(Deadline.after(0.05)) == b""
    assert second.read(Deadline.after(0.05)) == b"old"
    first.close()
    second.close()


def test_another_baud_rate_is_refused(line: Line) -> None:
    first = SharedPort(line.path, 4800)
    with pytest.raises(DeviceError, match="is open at 4800 baud for another device, 9600 are asked for"):
        SharedPort(line.path, 9600)
    first.close()


def test_an_unplugged_port_is_one_clear_line_for_both() -> None:
    line = Line()
    first, second = SharedPort(line.path, 4800), SharedPort(line.path, 4800)
    line.unplug()
    for port in (first, second):
        with pytest.raises(DeviceError, match=r"stopped working|no such port"):
            port.read(Deadline.after(0.1))
        port.close()


@pytest.mark.parametrize(("says", "noted"), [("16\n", True), ("1\n", False), ("", False)])
def test_an_adapter_that_holds_bytes_back_is_noted_with_what_to_do(
    line: Line, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, says: str, noted: bool
) -> None:
    timer = tmp_path / "bus/usb-serial/devices" / Path(line.path).name / "latency_timer"
    timer.parent.mkdir(parents=True)
    timer.write_text(says)
    monkeypatch.setattr(sysfs, "SYS", tmp_path)
    assert sysfs.serial_latency_ms(line.path) == (int(says) if says else None)
    with collecting() as faults:
        SerialPort(line.path, 4800).close()
    found = [(note.problem, note.action) for note in faults.all()]
    assert bool(found) == noted
    if noted:
        assert found[0][0].startswith("its adapter holds bytes back for 16 ms")
        assert f"echo 1 > {timer}" in found[0][1]
