"""A played-back log answers requests, however often, and reports missing ones."""

import json
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

from rig.check.devices import check_devices, check_inclinometer
from rig.config.load import load_config
from rig.devices.bus import monitor
from rig.devices.bus.deadline import Deadline
from rig.devices.bus.serial_port import SerialPort
from rig.devices.sensors.mmc5983ma import Mmc5983ma
from rig.devices.wire_log import recording_wire_log
from sim.commands.cli import sim
from sim.devices.dynamixel_packet import Instruction, packet
from sim.replay.devices import ReplayedChip, ReplayedServos, whole_lines
from sim.replay.log_file import load_log
from sim.replay.playback import replaying
from sim.replay.response_lookup import RecordedExchange, ResponseLookup, recorded_epoch

LOGS = sorted((Path(__file__).parents[2] / "logs").glob("*.log"))


def exchange(write: str, read: str, length: int | None = None) -> dict[str, Any]:
    return {"write": write, "length": len(read) // 2 if length is None else length, "read": read}


def set_reset_log(cycles: int) -> list[tuple[dict[str, Any], int]]:
    """Of an MMC5983MA: SET, RESET, temperature, over and over, with noise that counts."""
    log = [exchange("2f", "30"), exchange("0a80", ""), exchange("08", "10"), exchange("0a00", "")]
    for cycle in range(cycles):
        for pulse, high in (("08", 0x90), ("10", 0x70)):
            log += [
                exchange(f"09{pulse}", ""),
                exchange("0901", ""),
                exchange("08", "10"),
                exchange("08", "11"),
            ]
            log += [exchange("00", f"{high:02x}{cycle:02x}80008000{0:02x}")]
        log += [exchange("0902", ""), exchange("08", "12"), exchange("07", "7d")]
    return [(each, 0) for each in log]


class OnePlayedChip:
    """A bus with one replayed chip."""

    def __init__(self, chip: ReplayedChip) -> None:
        self.chip = chip

    def transfer(self, address: int, write: bytes, read_length: int) -> bytes:
        assert address == self.chip.address
        return self.chip.transfer(write, read_length)

    def close(self) -> None:
        pass


@pytest.mark.parametrize("recorded", [3, 5, 10])
@pytest.mark.parametrize("asked", [1, 4, 23])
def test_set_and_reset_stay_apart_however_many_readings_are_taken(recorded: int, asked: int) -> None:
    compass = Mmc5983ma(OnePlayedChip(ReplayedChip(0x30, set_reset_log(recorded))), 0x30)
    readings = [compass.read() for _ in range(asked)]
    assert {round(reading.x_ut, 3) for reading in readings} == {100.0}
    assert len({reading.offset_ut for reading in readings}) == min(
        asked, recorded
    )  # not the last one for ever


@given(st.lists(st.sampled_from("abcAB"), min_size=1, max_size=40), st.data())
def test_the_same_requests_get_the_same_answers(requests: list[str], data: st.DataObject) -> None:
    exchanges = [
        RecordedExchange(request, number, request.isupper()) for number, request in enumerate(requests)
    ]
    recorded = ResponseLookup(exchanges)
    assert [recorded.answer(request) for request in requests] == list(range(len(requests)))
    again = data.draw(st.lists(st.sampled_from("abcABx"), max_size=30))
    for request in again:  # whatever is asked then: an answer to that, or none where it was never made
        answer = recorded.answer(request)
        assert (answer is None) == (request not in requests)
        assert answer is None or requests[answer] == request


def test_fewer_and_more_polls_change_no_reading() -> None:
    log = [("go", None), *[("poll", 0)] * 3, ("poll", 1), ("read", "first")]
    log += [("go", None), ("poll", 0), ("poll", 1), ("read", "second")]
    exchanges = [RecordedExchange(request, answer, request == "go") for request, answer in log]
    for polls in (1, 3, 9):
        recorded = ResponseLookup(exchanges)
        found = []
        for _ in range(2):
            recorded.answer("go")
            last = [recorded.answer("poll") for _ in range(polls)][-1]
            found.append(recorded.answer("read"))
        assert found == ["first", "second"]
        assert last == (0 if polls == 1 else 1)


def test_a_poll_that_the_end_of_the_log_cuts_off_is_answered_from_before() -> None:
    log = [("poll", 0), ("poll", 1), ("read", "a"), ("poll", 0), ("poll", 1), ("read", "b"), ("poll", 0)]
    exchanges = [RecordedExchange(request, answer, False) for request, answer in log]
    recorded = ResponseLookup(exchanges, cut_polls_go_on=True)
    found = []
    for _ in range(5):
        while recorded.answer("poll") == 0:
            pass
        found.append(recorded.answer("read"))
    assert found == ["a", "b", "a", "b", "a"]
    assert recorded.ran_out
    still = ResponseLookup(exchanges)
    assert [still.answer("poll") for _ in range(3)] == [0, 1, 1]


def test_what_is_asked_at_a_stop_is_answered_from_that_stop() -> None:
    now = 0
    exchanges = [
        RecordedExchange("level", (stop, number), False, stop) for stop in (2, 4) for number in range(3)
    ]
    spaced = [
        each
        for pair in zip(
            exchanges, [RecordedExchange("ready", 1, False, e.epoch) for e in exchanges], strict=True
        )
        for each in pair
    ]
    recorded = ResponseLookup(spaced, lambda: now)

    def levels(count: int) -> list[Any]:
        found = []
        for _ in range(count):
            found.append(recorded.answer("level"))
            recorded.answer("ready")
        return found

    assert levels(4) == [
        (2, 0),
        (2, 1),
        (2, 2),
        (2, 0),
    ]  # before the head was ever sent anywhere: its first stop
    now = 4
    assert levels(5) == [(4, 0), (4, 1), (4, 2), (4, 0), (4, 1)]
    assert [recorded_epoch([2, 4], at) for at in (0, 2, 3, 4, 9)] == [2, 2, 2, 4, 4]


def test_registers_within_a_longer_read_are_answered_from_it() -> None:
    told: list[str] = []
    chip = ReplayedChip(0x1D, [(exchange("06", "000102030405"), 0)], say=told.append)
    assert chip.transfer(b"\x06", 2) == bytes([0, 1])
    assert chip.transfer(b"\x08", 3) == bytes([2, 3, 4])
    assert not told
    with pytest.raises(OSError, match="Remote I/O"):
        chip.transfer(b"\x0a", 3)
    assert told == ["holds no transfer that writes 0a and reads 3 bytes"]


def goal(tick: int) -> bytes:
    return packet(1, bytes([Instruction.WRITE]) + (116).to_bytes(2, "little") + tick.to_bytes(4, "little"))


def servo_log(*ticks: int) -> list[tuple[dict[str, Any], int]]:
    log = []
    for epoch, tick in enumerate(ticks, 1):
        log += [({"sent": goal(tick).hex()}, epoch), ({"received": f"{epoch:02x}"}, epoch)]
    return log


def test_a_goal_that_follows_from_noisy_readings_is_taken_for_the_one_of_then() -> None:
    told: list[str] = []
    servos = ReplayedServos(servo_log(1000, 2000), told.append)
    assert servos.answer(goal(1003)) == b"\x01"
    assert servos.epoch() == 1
    assert servos.answer(goal(1992)[:7]) == b""  # a packet may arrive in pieces
    assert servos.answer(goal(1992)[7:]) == b"\x02"
    assert servos.epoch() == 2
    assert servos.answer(goal(1100)) == b""
    assert told[0].startswith("holds no move of servo id 1 to tick 1100")
    assert servos.epoch() == 2


def test_a_talker_begins_again_with_whole_lines() -> None:
    said = [(0.0, b"6*11\r\n$A*"), (0.1, b"00\r\n$B*01\r\n"), (0.2, b"$C")]
    assert whole_lines(said) == [(0.0, b"$A*"), (0.1, b"00\r\n$B*01\r\n")]
    assert whole_lines([(0.0, b"$A\r$B\r")]) == [(0.0, b"$A\r$B\r")]  # lines that end with CR only
    assert whole_lines([(0.0, b"noise")]) == [(0.0, b"noise")]


@pytest.mark.parametrize(
    "log",
    [pytest.param(log, id=log.stem, marks=[pytest.mark.long] if n % 2 else []) for n, log in enumerate(LOGS)],
)
def test_a_log_passes_the_check_that_it_was_recorded_of(log: Path) -> None:
    with replaying(log) as played:
        config = load_config(played.config_path)
        quick = config.inclinometer.model_copy(update={"average_s": 0.2})
        checks = check_devices(config.model_copy(update={"inclinometer": quick}))
        assert [check.problem for check in checks] == [None] * 5
        assert played.notes.lines(failed=False) == []


def test_devices_missing_in_the_log_are_played_too_and_reported(tmp_path: Path) -> None:
    """Not the real ones: the log's configuration names those of the vehicle."""
    lines = LOGS[0].read_text().splitlines()
    of_servos = [line for line in lines[1:] if '"port"' in line]
    (tmp_path / "servos.log").write_text("\n".join([lines[0], *of_servos]) + "\n")
    with replaying(tmp_path / "servos.log") as played:
        config = load_config(played.config_path)
        assert config.inclinometer.bus.startswith("tcp://127.0.0.1")
        with pytest.raises(Exception, match="does not acknowledge"):
            check_inclinometer(config.inclinometer)
        told = played.notes.lines(failed=True)
    assert told[0].startswith("the log holds nothing of this chip (0x")
    assert told[-1].startswith("the log ends after ")


def test_a_talker_missing_in_the_log_is_reported(tmp_path: Path) -> None:
    lines = LOGS[3].read_text().splitlines()  # a compass and a barometer that talk
    without = [line for line in lines[1:] if '"port"' not in line or '"sent"' in line]
    (tmp_path / "chips.log").write_text("\n".join([lines[0], *without]) + "\n")
    with replaying(tmp_path / "chips.log") as played:
        config = load_config(played.config_path)
        section: Any = config.compass
        with closing(SerialPort(section.port, section.baud)) as port:
            assert port.read(Deadline.after(0.2)) == b""
        told = played.notes.lines(failed=False)
    assert any("the log holds nothing of this port" in line for line in told)


def test_the_command_has_the_clock_of_then(tmp_path: Path) -> None:
    lines = LOGS[0].read_text().splitlines()
    header = {**json.loads(lines[0]), "utc": "2001-02-03T04:05:06.000Z"}
    (tmp_path / "old.log").write_text("\n".join([json.dumps(header), *lines[1:]]) + "\n")
    with replaying(tmp_path / "old.log") as played:
        offset_s = float(Path(played.environment["SKYFIX_CLOCK_OFFSET"]).read_text())
    assert offset_s < -25 * 365 * 86400


@pytest.mark.parametrize(
    ("name", "text", "why"),
    [
        ("empty", "", "it is empty"),
        ("other", "\x89PNG\n", "is no log of rig record"),
        ("fix", '{"schema": "skyfix.fix/1"}\n', "it begins with"),
        ("newer", '{"skyfix_log": 9}\n', "version 1: it says 9; replay it with the skyfix that wrote it"),
        ("no-config", '{"skyfix_log": 1}\n{"t": 0, "port": "a", "sent": ""}\n', "no configuration"),
        ("bad", '{"skyfix_log": 1, "config": {}}\n{"t": 0}\n', "line 2 is no exchange"),
        (
            "hex",
            '{"skyfix_log": 1, "config": {}}\n{"t": 0, "port": "a", "sent": "zz"}\n',
            "line 2 is no exchange",
        ),
        ("deep", '{"skyfix_log": 1, "config": {}}\n' + "[" * 100000 + "]" * 100000 + "\n1\n", "line 2"),
    ],
)
def test_what_is_no_log_is_refused_in_one_line(tmp_path: Path, name: str, text: str, why: str) -> None:
    path = tmp_path / f"{name}.log"
    path.write_text(text, encoding="latin-1")
    with pytest.raises(Exception, match=r"\.log: is no log of rig record") as caught:
        load_log(path)
    assert why in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_folder_is_no_log(tmp_path: Path) -> None:
    result = CliRunner().invoke(sim, ["replay", str(tmp_path), "--", "true"])
    assert "Is a directory" in str(result.exception)


def test_a_full_disk_under_the_log_is_not_blamed_on_a_device(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    with replaying(LOGS[0]) as played:
        config = load_config(played.config_path)
        with recording_wire_log(tmp_path / "x.log", config):
            monitor.serial_bytes("a", "sent", b"1")
            monkeypatch.setattr("rig.devices.wire_log.json.dumps", full)
            monitor.serial_bytes("a", "sent", b"2")
            monitor.serial_bytes("a", "sent", b"3")
    assert [record.getMessage().split(";")[0] for record in caplog.records] == [
        f"{tmp_path / 'x.log'}: cannot be written: No space left on device"
    ]
    assert len((tmp_path / "x.log").read_text().splitlines()) == 2


def full(_value: object) -> str:
    raise OSError(28, "No space left on device")


def test_no_url_of_the_camera_is_in_a_log(tmp_path: Path) -> None:
    with replaying(LOGS[0]) as played:
        config = load_config(played.config_path)
        camera = config.camera.model_copy(
            update={
                "source": "http://user:secret@camera/stream",
                "exposure_url": "http://user:secret@camera/set?ev={ev}",
            }
        )
        with recording_wire_log(tmp_path / "x.log", config.model_copy(update={"camera": camera})):
            monitor.serial_bytes("a", "sent", b"1")
    assert "secret" not in (tmp_path / "x.log").read_text()
    with replaying(tmp_path / "x.log") as played:
        camera = load_config(played.config_path).camera
        assert camera.exposure_url
        assert camera.exposure_url.startswith("http://127.0.0.1")  # the played camera's, and no real one's
