"""Fault scripts: their validation, and the effect of each fault."""

import json
import time
from pathlib import Path

import numpy as np
import pytest

from sim.devices.i2c_chip import PoweredChip
from sim.devices.pty_port import PtyPort
from sim.errors import SimulationError
from sim.faults.catalogue import CATALOGUE, DEVICES
from sim.faults.chip import FaultyChip
from sim.faults.picture import FaultyPictures
from sim.faults.script import Fault, load_faults, parse_faults
from sim.faults.wire import Wire


def fault(device: str, name: str, **more: float) -> Fault:
    (parsed,) = parse_faults([{"at": 0.0, "device": device, "fault": name, **more}])
    return parsed


def test_toml_and_json_say_the_same(tmp_path: Path) -> None:
    entry = {"at": 2.0, "device": "compass", "fault": "nack", "for": 1.5, "share": 0.5}
    (tmp_path / "a.json").write_text(json.dumps([entry]))
    (tmp_path / "a.toml").write_text(
        "[[fault]]\n" + "\n".join(f"{key} = {json.dumps(value)}" for key, value in entry.items())
    )
    assert load_faults(tmp_path / "a.json") == load_faults(tmp_path / "a.toml")
    assert load_faults(tmp_path / "a.json")[0].parameters == {"share": 0.5}


@pytest.mark.parametrize(
    ("entry", "said"),
    [
        (
            {"at": 0, "device": "compas", "fault": "nack"},
            "there is no device 'compas'; did you mean 'compass'?",
        ),
        ({"at": 0, "device": "pan", "fault": "nack"}, "pan has no fault 'nack'; there are overload, "),
        ({"at": -1, "device": "pan", "fault": "reboot"}, "at = -1 should be seconds, 0 or more"),
        ({"at": 0, "device": "pan", "fault": "reboot", "for": 1}, "reboot is over at once"),
        ({"at": 0, "device": "pan", "fault": "blocked", "force": 1}, "has no parameter 'force'; it has none"),
        ({"at": 0, "device": "tilt", "fault": "backlash", "degrees": "1"}, "degrees = '1' is no number"),
        ({"device": "pan", "fault": "reboot"}, "at is missing"),
        ("pan", "expected a table"),
    ],
)
def test_a_script_that_names_what_there_is_not_is_refused(entry: object, said: str) -> None:
    with pytest.raises(SimulationError) as caught:
        parse_faults([entry])
    assert str(caught.value).startswith("fault 1: ")
    assert said in str(caught.value)


def test_a_script_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    broken = tmp_path / "faults.toml"
    broken.write_text("[[fault]\n")
    for path, said in ((broken, "not valid TOML"), (tmp_path / "none.toml", "No such file")):
        with pytest.raises(SimulationError, match=said):
            load_faults(path)


def test_every_device_has_faults() -> None:
    assert {group for groups in DEVICES.values() for group in groups} == set(CATALOGUE)


@pytest.mark.parametrize(
    ("name", "arrives"),
    [("lost", b""), ("duplicated", b"abcabc"), ("corrupted", None), ("truncated", None), ("garbage", None)],
)
def test_a_wire_damages_messages_until_it_is_mended(name: str, arrives: bytes | None) -> None:
    wire, damage = Wire(np.random.default_rng(1)), fault("servo-bus", name)
    assert wire(b"abc") == b"abc"
    wire.begin(damage)
    arrived = wire(b"abc")
    assert arrived == arrives if arrives is not None else arrived != b"abc"
    wire.end(damage)
    assert wire(b"abc") == b"abc"


class Counter:
    """A chip whose reading counts up; a power cycle resets it."""

    address = 0x1D

    def __init__(self) -> None:
        self.count = 0

    def transfer(self, write: bytes, read_length: int) -> bytes:
        self.count += 1
        return bytes([self.count] * read_length)

    def power_cycle(self) -> None:
        self.count = 0


def test_faults_of_a_chip() -> None:
    counter: PoweredChip = Counter()
    chip = FaultyChip(counter, np.random.default_rng(1))
    for name, number in (("nack", 121), ("stuck", 5), ("stretched", 110)):
        broken = fault("compass", name)
        chip.begin(broken)
        with pytest.raises(OSError, match=r"\w") as caught:
            chip.transfer(b"\x00", 3)
        assert caught.value.errno == number
        chip.end(broken)
    frozen = fault("compass", "frozen")
    before = chip.transfer(b"\x00", 3)
    chip.begin(frozen)
    assert chip.transfer(b"\x00", 3) == before
    chip.end(frozen)
    assert chip.transfer(b"\x00", 3) != before
    chip.begin(fault("compass", "reset"))
    assert chip.transfer(b"\x00", 3) == b"\x01\x01\x01"


def test_old_pictures_are_sent() -> None:
    pictures = FaultyPictures()
    stale = fault("camera", "stale", seconds=0.1)
    pictures.begin(stale)
    first, second = (np.full((4, 4, 3), level, np.uint8) for level in (10, 20))
    assert pictures(first) is first
    time.sleep(0.05)
    assert pictures(second) is first
    time.sleep(0.12)
    assert pictures(second) is second
    pictures.end(stale)
    pictures.begin(fault("camera", "stalled"))
    assert pictures(first) is None


def test_a_port_keeps_its_lasting_name_and_gets_another_terminal(tmp_path: Path) -> None:
    port = PtyPort()
    link = tmp_path / "by-id" / "adapter"
    port.keep_name(link)
    before = link.readlink()
    port.unplug()
    port.unplug()
    assert not link.is_symlink()
    port.send(b"lost")
    port.plug_in()
    assert link.readlink() != before
    assert port.path == str(link)
    port.close()
    port.close()
