"""Answers of a replayed servo to reads that were not recorded."""

from sim.devices.dynamixel_packet import crc16
from sim.replay.registers import factory_answer


def read(servo_id: int, address: int, length: int) -> bytes:
    body = b"\x02" + address.to_bytes(2, "little") + length.to_bytes(2, "little")
    packet = b"\xff\xff\xfd\x00" + bytes([servo_id]) + (len(body) + 2).to_bytes(2, "little") + body
    return packet + crc16(packet).to_bytes(2, "little")


def test_set_up_is_answered_as_the_servo_leaves_the_factory() -> None:
    models = {1: "XM430-W350", 2: "XL430-W250"}
    assert factory_answer(read(1, 84, 2), models)[9:11] == (800).to_bytes(2, "little")
    assert factory_answer(read(2, 84, 2), models)[9:11] == (640).to_bytes(2, "little")
    assert factory_answer(read(1, 9, 55), models)[9 + 12 - 9] == 255


def test_what_is_measured_or_of_another_servo_is_not_made_up() -> None:
    models = {1: "XM430-W350"}
    assert factory_answer(read(1, 132, 4), models) == b""
    assert factory_answer(read(1, 100, 8), models) == b""
    assert factory_answer(read(3, 9, 1), models) == b""
