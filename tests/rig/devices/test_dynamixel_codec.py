"""Protocol 2.0 codec: the manual's packets, stuffing, and finding the way back after garbage."""

import pytest
from dynamixel_sdk.protocol2_packet_handler import Protocol2PacketHandler
from hypothesis import given
from hypothesis import strategies as st

from rig.devices.dynamixel.protocol2 import Instruction, Status, StatusParser, crc16, frame, stuff, unstuff
from rig.errors import MessageError

SENT = {
    "ping": (1, Instruction.PING, "", "FF FF FD 00 01 03 00 01 19 4E"),
    "ping broadcast": (254, Instruction.PING, "", "FF FF FD 00 FE 03 00 01 31 42"),
    "read 132/4": (1, Instruction.READ, "84 00 04 00", "FF FF FD 00 01 07 00 02 84 00 04 00 1D 15"),
    "write goal 512": (
        1,
        Instruction.WRITE,
        "74 00 00 02 00 00",
        "FF FF FD 00 01 09 00 03 74 00 00 02 00 00 CA 89",
    ),
    "reg write": (1, 0x04, "68 00 C8 00 00 00", "FF FF FD 00 01 09 00 04 68 00 C8 00 00 00 AE 8E"),
    "action": (1, 0x05, "", "FF FF FD 00 01 03 00 05 02 CE"),
    "reboot": (1, Instruction.REBOOT, "", "FF FF FD 00 01 03 00 08 2F 4E"),
    "clear": (1, 0x10, "01 44 58 4C 22", "FF FF FD 00 01 08 00 10 01 44 58 4C 22 B1 DC"),
    "factory reset": (1, 0x06, "01", "FF FF FD 00 01 04 00 06 01 A1 E6"),
    "sync read": (
        254,
        Instruction.SYNC_READ,
        "84 00 04 00 01 02",
        "FF FF FD 00 FE 09 00 82 84 00 04 00 01 02 CE FA",
    ),
    "sync read state": (
        254,
        Instruction.SYNC_READ,
        "7A 00 19 00 01 02",
        "FF FF FD 00 FE 09 00 82 7A 00 19 00 01 02 38 0E",
    ),
    "sync write": (
        254,
        0x83,
        "74 00 04 00 01 96 00 00 00 02 AA 00 00 00",
        "FF FF FD 00 FE 11 00 83 74 00 04 00 01 96 00 00 00 02 AA 00 00 00 82 87",
    ),
    "bulk read": (
        254,
        0x92,
        "01 90 00 02 00 02 92 00 01 00",
        "FF FF FD 00 FE 0D 00 92 01 90 00 02 00 02 92 00 01 00 1A 05",
    ),
    "stuffed write": (
        1,
        Instruction.WRITE,
        "66 00 FF FF FD FF FF FF",
        "FF FF FD 00 01 0C 00 03 66 00 FF FF FD FD FF FF FF 09 35",
    ),
}

RECEIVED = {
    "ping": ("FF FF FD 00 01 07 00 55 00 06 04 26 65 5D", Status(1, 0, bytes.fromhex("060426"))),
    "ping 2": ("FF FF FD 00 02 07 00 55 00 06 04 26 6F 6D", Status(2, 0, bytes.fromhex("060426"))),
    "position 166": ("FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0", Status(1, 0, bytes.fromhex("A6000000"))),
    "written": ("FF FF FD 00 01 04 00 55 00 A1 0C", Status(1, 0, b"")),
    "position 2079": (
        "FF FF FD 00 02 08 00 55 00 1F 08 00 00 BA BE",
        Status(2, 0, bytes.fromhex("1F080000")),
    ),
    "voltage": ("FF FF FD 00 01 06 00 55 00 77 00 C3 69", Status(1, 0, bytes.fromhex("7700"))),
    "temperature": ("FF FF FD 00 02 05 00 55 00 24 8B A9", Status(2, 0, bytes.fromhex("24"))),
    "stuffed": (
        "FF FF FD 00 01 0F 00 55 00 FF FF FD FD 00 00 00 00 08 00 00 61 00",
        Status(1, 0, bytes.fromhex("FFFFFD00000000080000")),
    ),
    "alert": ("FF FF FD 00 01 05 00 55 80 2A A5 21", Status(1, 0x80, b"\x2a")),
    "data limit": ("FF FF FD 00 01 04 00 55 06 B5 0C", Status(1, 6, b"")),
}

GOOD = bytes.fromhex(RECEIVED["position 2079"][0])
GOOD_STATUS = RECEIVED["position 2079"][1]
# Bytes that are likely to look like the protocol.
treacherous = st.lists(
    st.sampled_from([b"\xff", b"\xfd", b"\x00", b"\x01", b"\x55", b"\xff\xff\xfd\x00", GOOD[:9], GOOD[:-1]])
    | st.binary(min_size=1, max_size=3),
    max_size=30,
).map(b"".join)


def received(data: bytes) -> list[Status]:
    return StatusParser().feed(data)


@pytest.mark.parametrize(("servo_id", "instruction", "parameters", "packet"), SENT.values(), ids=SENT)
def test_packets_to_send_are_those_of_the_manual(servo_id, instruction, parameters, packet):
    assert frame(servo_id, instruction, bytes.fromhex(parameters)) == bytes.fromhex(packet)


@pytest.mark.parametrize(("packet", "status"), RECEIVED.values(), ids=RECEIVED)
def test_packets_received_are_those_of_the_manual(packet, status):
    assert received(bytes.fromhex(packet)) == [status]


def test_alert_and_error_number_are_two_things():
    assert (Status(1, 0x86, b"").alert, Status(1, 0x86, b"").error_number) == (True, 6)
    assert (Status(1, 0x06, b"").alert, Status(1, 0x06, b"").error_number) == (False, 6)


def test_crc_of_the_catalogue():
    assert crc16(b"123456789") == 0xFEE8


@given(st.binary(max_size=200))
def test_crc_agrees_with_the_vendors(data):
    assert crc16(data) == Protocol2PacketHandler().updateCRC(0, list(data), len(data))


@given(st.binary(max_size=60) | treacherous)
def test_unstuffing_undoes_stuffing(body):
    assert unstuff(stuff(body)) == body
    assert b"\xff\xff\xfd\x00" not in stuff(body)


@given(treacherous, st.lists(st.integers(1, 40), max_size=10))
def test_the_next_good_packet_is_understood_after_any_garbage(garbage, cuts):
    parser = StatusParser()
    found = []
    data = garbage + GOOD
    for cut in cuts:
        found += parser.feed(data[:cut])
        data = data[cut:]
    found += parser.feed(data)
    assert found[-1] == GOOD_STATUS


@given(st.binary(max_size=300) | treacherous)
def test_any_bytes_give_packets_or_one_named_problem(data):
    parser = StatusParser()
    statuses = parser.feed(data)
    assert all(isinstance(status, Status) for status in statuses)
    assert parser.problem is None or isinstance(parser.problem, MessageError)


@pytest.mark.parametrize(
    ("data", "problem"),
    [
        (b"\x12\x34\x56\x78", "received bytes that are no packet"),
        (GOOD[:-1] + b"\x00", "received a packet with a wrong CRC"),
        (GOOD[:-5] + GOOD, "received a packet that was cut short"),
        (b"\xff\xff\xfd\x00\x01\xff\xff\x55\x00", "received a packet of the impossible length 65535"),
    ],
)
def test_the_problem_says_what_was_dropped(data, problem):
    parser = StatusParser()
    parser.feed(data)
    assert str(parser.problem) == problem


def test_the_echo_of_an_instruction_is_no_status():
    assert received(frame(1, Instruction.PING) + GOOD) == [GOOD_STATUS]


def test_a_packet_may_come_byte_by_byte():
    parser = StatusParser()
    assert [status for byte in GOOD + GOOD for status in parser.feed(bytes([byte]))] == [GOOD_STATUS] * 2


def test_a_crc_that_looks_like_a_header_with_the_parameters_before_it_is_none():
    # Two free parameter bytes, then FF FF: some choice gives the CRC 0x00FD, which is FD 00 on the wire.
    for free in range(1 << 16):
        packet = frame(1, 0x55, b"\x00" + free.to_bytes(2, "little") + b"\xff\xff")
        if packet.endswith(b"\xff\xff\xfd\x00"):
            break
    assert received(packet + GOOD) == [Status(1, 0, free.to_bytes(2, "little") + b"\xff\xff"), GOOD_STATUS]
