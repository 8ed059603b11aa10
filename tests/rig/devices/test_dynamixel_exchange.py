"""Instructions and status packets of the servo bus, byte by byte, on a port in memory and a virtual clock.

The packets are the e-manual's ("Protocol 2.0"); others are made with the CRC of the vendor's SDK.
"""

import re

import pytest
from fakes.clock import FakeClock
from fakes.servos import status_packet

from rig.devices.bus.deadline import Deadline
from rig.devices.dynamixel.servo_bus import RefusedError, ServoBus
from rig.errors import TransientError
from rig.fault_notes import collecting

PING_1 = bytes.fromhex("FFFFFD0001030001194E")
PING_1_ANSWER = bytes.fromhex("FFFFFD000107005500060426655D")
PING_ALL = bytes.fromhex("FFFFFD00FE0300013142")
PING_2_ANSWER = bytes.fromhex("FFFFFD0002070055000604266F6D")
READ_POSITION = bytes.fromhex("FFFFFD0001070002840004001D15")
POSITION_166 = bytes.fromhex("FFFFFD000108005500A60000008CC0")
WRITE_GOAL_512 = bytes.fromhex("FFFFFD0001090003740000020000CA89")
WRITTEN = bytes.fromhex("FFFFFD000104005500A10C")
REBOOT = bytes.fromhex("FFFFFD00010300082F4E")
CLEAR = bytes.fromhex("FFFFFD00010800100144584C22B1DC")
SYNC_READ = bytes.fromhex("FFFFFD00FE090082840004000102CEFA")
POSITION_2079_OF_2 = bytes.fromhex("FFFFFD0002080055001F080000BABE")
DATA_LIMIT = bytes.fromhex("FFFFFD000104005506B50C")


class Port:
    """What is written is kept; each read gives the next piece of the answer, or waits until the deadline."""

    path = "/dev/ttyX"
    baud = 1_000_000

    def __init__(self, clock: FakeClock, *pieces: bytes) -> None:
        self._clock = clock
        self.pieces = list(pieces)
        self.written: list[bytes] = []
        self.stale = b"stale"
        self.waited_s = 0.0
        self.closed = False

    def discard_input(self) -> None:
        self.stale = b""

    def write(self, data: bytes) -> None:
        assert self.stale == b"", "what was received before the instruction is thrown away"
        self.stale = b"next"
        self.written.append(data)

    def read(self, deadline: Deadline) -> bytes:
        if self.pieces:
            self._clock.now_s += 0.001
            return self.pieces.pop(0)
        self.waited_s += deadline.remaining_s
        self._clock.now_s += deadline.remaining_s
        return b""

    def close(self) -> None:
        self.closed = True


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> FakeClock:
    return FakeClock(monkeypatch)


def bus_with(clock: FakeClock, *pieces: bytes) -> tuple[ServoBus, Port]:
    port = Port(clock, *pieces)
    return ServoBus(port), port  # type: ignore[arg-type]


def test_a_ping(clock: FakeClock) -> None:
    bus, port = bus_with(clock, PING_1_ANSWER)
    assert bus.ping(1) == (1030, 38)
    assert port.written == [PING_1]
    assert port.waited_s == 0.0


def test_a_ping_to_all_waits_for_all(clock: FakeClock) -> None:
    short = status_packet(3, 0, b"\x06\x04")
    bus, port = bus_with(clock, PING_ALL, PING_1_ANSWER[:5], PING_1_ANSWER[5:] + short, PING_2_ANSWER)
    began_s = clock.now_s
    assert bus.ping_all(0.1) == {1: 1030, 2: 1030}
    assert port.written == [PING_ALL]
    assert clock.now_s - began_s == pytest.approx(0.1)


def test_reading_and_writing(clock: FakeClock) -> None:
    bus, port = bus_with(clock, POSITION_166, WRITTEN, WRITTEN, WRITTEN)
    assert bus.read(1, 132, 4) == (166).to_bytes(4, "little")
    bus.write(1, 116, (512).to_bytes(4, "little"))
    bus.reboot(1)
    bus.clear_multi_turn(1)
    assert port.written == [READ_POSITION, WRITE_GOAL_512, REBOOT, CLEAR]
    assert port.waited_s == 0.0
    bus.close()
    assert port.closed


def test_addresses_have_two_bytes(clock: FakeClock) -> None:
    """Indirect Address 29 lies at 578, 0x0242."""
    bus, port = bus_with(clock, status_packet(1, 0, bytes(300)))
    assert len(bus.read(1, 578, 300)) == 300
    assert port.written[0][7:12] == bytes.fromhex("02 42 02 2C 01")


def test_a_servo_has_the_time_of_its_packets_and_50_ms(clock: FakeClock) -> None:
    """Request 14 bytes, answer (11 + 4) x 4/3 = 20: 34 bytes of 10 us at 1 MBd."""
    bus, port = bus_with(clock)
    with pytest.raises(
        TransientError, match=r"servo id 1 on /dev/ttyX: no answer; check power, cable, `id` and"
    ):
        bus.read(1, 132, 4)
    assert port.waited_s == pytest.approx(0.05 + 34 * 10 / 1_000_000, abs=1e-5)
    two, port = bus_with(clock)
    assert two.sync_read([1, 2], 132, 4) == {}
    assert port.waited_s == pytest.approx(0.05 + (16 + 40) * 10 / 1_000_000, abs=1e-5)


def test_what_came_while_the_process_was_not_scheduled_still_counts(clock: FakeClock) -> None:
    class Late(Port):
        def read(self, deadline: Deadline) -> bytes:
            self._clock.now_s += 0.2  # past the deadline, in one go
            return super().read(deadline)

    port = Late(clock, POSITION_166[:6], POSITION_166[6:])
    assert ServoBus(port).read(1, 132, 4) == (166).to_bytes(4, "little")  # type: ignore[arg-type]


def test_another_servos_packet_is_no_answer(clock: FakeClock) -> None:
    bus, _ = bus_with(clock, POSITION_2079_OF_2)
    with pytest.raises(TransientError, match="no answer"):
        bus.read(1, 132, 4)
    bus, _ = bus_with(clock, POSITION_2079_OF_2, POSITION_166)
    assert bus.read(1, 132, 4) == (166).to_bytes(4, "little")


def test_an_echo_and_noise_are_skipped_and_noise_is_noted(clock: FakeClock) -> None:
    bus, _ = bus_with(clock, READ_POSITION, POSITION_166, b"\x00\x01" + POSITION_166)
    with collecting() as faults:
        bus.read(1, 132, 4)
    assert list(faults.all()) == [], "an adapter may echo"
    with collecting() as faults:
        assert bus.read(1, 132, 4) == (166).to_bytes(4, "little")
    assert [(n.device, n.problem) for n in faults.all()] == [
        ("servo bus /dev/ttyX", "received bytes that are no packet")
    ]


def test_a_damaged_packet_is_no_answer_and_says_so(clock: FakeClock) -> None:
    bus, _ = bus_with(clock, POSITION_166[:-1] + b"\x00")
    with (
        collecting() as faults,
        pytest.raises(TransientError, match=r"no valid answer \(received a packet with a"),
    ):
        bus.read(1, 132, 4)
    assert list(faults.all()) == [], "it is in the error"


@pytest.mark.parametrize(
    ("number", "why"),
    [
        (1, "could not carry out the instruction"),
        (2, "does not know the instruction"),
        (4, "says that the value is out of range"),
        (5, "says that the value has a wrong length"),
        (6, "says that the value is beyond its limit registers"),
        (7, "does not allow that register to be accessed now"),
        (9, "refuses with the unknown error 9"),
    ],
)
@pytest.mark.parametrize("alert", [0x00, 0x80])
def test_each_refusal_of_a_write_is_named_with_what_was_written(
    clock: FakeClock, number: int, why: str, alert: int
) -> None:
    bus, _ = bus_with(clock, status_packet(1, number | alert, b""))
    with pytest.raises(RefusedError, match=re.escape(f"{why} (WRITE 74 00 00 02 00 00)")) as refused:
        bus.write(1, 116, (512).to_bytes(4, "little"))
    assert refused.value.number == number
    assert not isinstance(refused.value, TransientError)


def test_a_packet_that_the_servo_got_damaged_is_sent_again(clock: FakeClock) -> None:
    bus, _ = bus_with(clock, status_packet(1, 3, b""))
    with pytest.raises(TransientError, match="received a packet with a wrong CRC; check the cable"):
        bus.write(1, 64, b"\x01")


@pytest.mark.parametrize("number", [4, 6])
def test_a_read_that_is_answered_like_a_write_got_an_earlier_answer(clock: FakeClock, number: int) -> None:
    for ask in (lambda bus: bus.read(1, 132, 4), lambda bus: bus.ping(1)):
        bus, _ = bus_with(clock, status_packet(1, number, b""))
        with pytest.raises(
            TransientError, match="answered an earlier instruction, late; shorten the adapter's"
        ):
            ask(bus)
    bus, _ = bus_with(clock, status_packet(1, 7, b""))
    with pytest.raises(RefusedError, match="accessed now"):
        bus.read(1, 132, 4)


def test_an_alert_alone_is_no_refusal(clock: FakeClock) -> None:
    bus, _ = bus_with(clock, status_packet(1, 0x80, b"\x2a"))
    assert bus.read(1, 146, 1) == b"\x2a"


def test_an_answer_of_another_length_is_none(clock: FakeClock) -> None:
    bus, _ = bus_with(clock, POSITION_166)
    with pytest.raises(
        TransientError, match="answered 4 bytes instead of 2; check that no two servos have one id"
    ):
        bus.read(1, 144, 2)


def test_a_write_that_may_stay_unanswered(clock: FakeClock) -> None:
    bus, port = bus_with(clock)
    bus.write_unanswered(1, 116, (512).to_bytes(4, "little"))
    assert port.written == [WRITE_GOAL_512]


def test_a_sync_read_takes_whole_blocks_from_whoever_answers(clock: FakeClock) -> None:
    bus, port = bus_with(clock, POSITION_166 + POSITION_2079_OF_2)
    found = bus.sync_read([1, 2], 132, 4)
    assert {i: int.from_bytes(s.parameters, "little") for i, s in found.items()} == {1: 166, 2: 2079}
    assert port.written == [SYNC_READ]
    assert port.waited_s == 0.0
    for bad in (DATA_LIMIT, status_packet(1, 0, b"\xa6\x00"), b""):
        bus, _ = bus_with(clock, bad + POSITION_2079_OF_2)
        assert list(bus.sync_read([1, 2], 132, 4)) == [2]
    bus, _ = bus_with(clock, status_packet(1, 0x80, bytes(4)) + POSITION_2079_OF_2)
    assert bus.sync_read([1, 2], 132, 4)[1].alert


def test_a_servo_set_to_protocol_1_answers_its_ping(clock: FakeClock) -> None:
    """FF FF ID LENGTH INSTRUCTION CHECKSUM, the complement of the sum (e-manual, "Protocol 1.0")."""
    ping, answer = bytes.fromhex("FFFF010201FB"), bytes.fromhex("FFFF010200FC")
    bus, port = bus_with(clock, answer[:3], answer[3:])
    assert bus.answers_protocol_1(1)
    assert port.written == [ping]
    assert port.waited_s + 0.002 == pytest.approx(0.05 + 12 * 10 / 1_000_000, abs=1e-5)
    for pieces, is_there in (
        ((ping, answer), True),
        ((ping,), False),
        ((b"\xff\xff\x02\x02\x00\xfb",), False),
    ):
        bus, _ = bus_with(clock, *pieces)
        assert bus.answers_protocol_1(1) is is_there
    bus, _ = bus_with(clock)
    assert not bus.answers_protocol_1(1)
