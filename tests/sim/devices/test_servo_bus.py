"""The fake servos: golden packets, rules of the control table, motion; the unmodified SDK as a client."""

import time
from collections.abc import Iterator
from pathlib import Path

import dynamixel_sdk as sdk
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.devices.dynamixel_packet import crc16, packet, status_packet, stuff, unstuff
from sim.devices.gear_train import GearTrain
from sim.devices.pty_port import PtyPort
from sim.devices.servo import OVERLOAD_ERROR, REBOOT_S, SHOCK_ERROR, VOLTAGE_ERROR, Servo
from sim.devices.servo_bus import ServoBus
from sim.devices.x_series import MODELS, XL430_W250, XM430_W350, ServoModel

NOTHING, RANGE, LENGTH, LIMIT, ACCESS = 0, 4, 5, 6, 7


class Clock:
    """A manual clock."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def clock() -> Clock:
    return Clock()


def make_servo(clock: Clock, model: ServoModel = XM430_W350, servo_id: int = 1, **options: object) -> Servo:
    return Servo(model, servo_id, clock=clock, rng=np.random.default_rng(1), **options)  # type: ignore[arg-type]


@pytest.fixture
def servo(clock: Clock) -> Servo:
    return make_servo(clock)


def u32(value: int) -> bytes:
    return (value & 0xFFFFFFFF).to_bytes(4, "little")


def number(servo: Servo, address: int, length: int, *, signed: bool = True) -> int:
    error, data = servo.read(address, length)
    assert error == NOTHING
    return int.from_bytes(data, "little", signed=signed)


def hexes(text: str) -> bytes:
    return bytes.fromhex(text)


def test_crc_has_the_published_check_value() -> None:
    assert crc16(b"123456789") == 0xFEE8


@given(st.lists(st.sampled_from([0xFF, 0xFD, 0x00, 0x01]), max_size=24).map(bytes))
def test_stuffing_can_be_undone(payload: bytes) -> None:
    stuffed = stuff(payload)
    assert unstuff(stuffed) == payload
    assert b"\xff\xff\xfd\x00" not in stuffed


def test_a_status_that_contains_a_header_is_stuffed() -> None:
    data = hexes("FF FF FD 00 00 00 00 08 00 00")
    assert status_packet(1, 0, data) == hexes(
        "FF FF FD 00 01 0F 00 55 00 FF FF FD FD 00 00 00 00 08 00 00 61 00"
    )


@pytest.mark.parametrize(
    ("request_hex", "answer_hex"),
    [
        ("FF FF FD 00 01 07 00 02 84 00 04 00 1D 15", "FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0"),
        ("FF FF FD 00 01 09 00 03 74 00 00 02 00 00 CA 89", "FF FF FD 00 01 04 00 55 00 A1 0C"),
    ],
)
def test_golden_packets_are_answered_as_in_the_manual(
    clock: Clock, request_hex: str, answer_hex: str
) -> None:
    bus = ServoBus([make_servo(clock, shaft_tick=166.0)])
    assert bus.reply(hexes(request_hex)) == hexes(answer_hex)


def test_golden_sync_read_is_answered_in_order(clock: Clock) -> None:
    bus = ServoBus([make_servo(clock, shaft_tick=166.0), make_servo(clock, servo_id=2, shaft_tick=2079.0)])
    answer = bus.reply(hexes("FF FF FD 00 FE 09 00 82 84 00 04 00 01 02 CE FA"))
    assert answer == hexes(
        "FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0 FF FF FD 00 02 08 00 55 00 1F 08 00 00 BA BE"
    )


def test_golden_bulk_read_of_voltage_and_temperature(clock: Clock) -> None:
    servos = [make_servo(clock, supply_v=11.9), make_servo(clock, servo_id=2, temperature_c=36.0)]
    answer = ServoBus(servos).reply(hexes("FF FF FD 00 FE 0D 00 92 01 90 00 02 00 02 92 00 01 00 1A 05"))
    assert answer == hexes("FF FF FD 00 01 06 00 55 00 77 00 C3 69 FF FF FD 00 02 05 00 55 00 24 8B A9")


def test_golden_sync_write_moves_both_goals(clock: Clock) -> None:
    servos = [make_servo(clock), make_servo(clock, servo_id=2)]
    request = hexes("FF FF FD 00 FE 11 00 83 74 00 04 00 01 96 00 00 00 02 AA 00 00 00 82 87")
    assert ServoBus(servos).reply(request) == b""
    assert [number(servo, 116, 4) for servo in servos] == [150, 170]


def test_reg_write_waits_for_action(clock: Clock) -> None:
    servo = make_servo(clock)
    bus = ServoBus([servo])
    bus.reply(hexes("FF FF FD 00 01 09 00 04 68 00 C8 00 00 00 AE 8E"))
    assert (number(servo, 69, 1), number(servo, 104, 4)) == (1, 0)
    assert bus.reply(hexes("FF FF FD 00 01 03 00 05 02 CE")) == hexes("FF FF FD 00 01 04 00 55 00 A1 0C")
    assert (number(servo, 69, 1), number(servo, 104, 4)) == (0, 200)


def test_a_stuffed_write_arrives_unstuffed(clock: Clock) -> None:
    servo = make_servo(clock)
    ServoBus([servo]).reply(hexes("FF FF FD 00 01 0C 00 03 66 00 FF FF FD FD FF FF FF 09 35"))
    assert (number(servo, 102, 2), number(servo, 104, 4)) == (-1, -3)


def test_alert_bit_and_limit_error_look_as_computed(clock: Clock) -> None:
    servo = make_servo(clock, temperature_c=42.0)
    bus = ServoBus([servo])
    assert bus.reply(packet(1, bytes([3, 116, 0]) + u32(4096))) == hexes("FF FF FD 00 01 04 00 55 06 B5 0C")
    servo.fail(VOLTAGE_ERROR)
    assert bus.reply(packet(1, bytes([2, 146, 0, 1, 0]))) == hexes("FF FF FD 00 01 05 00 55 80 2A A5 21")


def test_a_good_packet_after_noise_is_understood(clock: Clock) -> None:
    bus = ServoBus([make_servo(clock)])
    ping = packet(1, b"\x01")
    assert bus.reply(b"\xff\x00noise" + ping[:4]) == b""
    assert bus.reply(ping[4:]).startswith(hexes("FF FF FD 00 01 07 00 55 00 FC 03"))


def test_a_broken_crc_is_reported(clock: Clock) -> None:
    ping = packet(1, b"\x01")
    answer = ServoBus([make_servo(clock)]).reply(ping[:-1] + bytes([ping[-1] ^ 1]))
    assert answer == status_packet(1, 3)


def test_a_missing_servo_silences_those_behind_it(clock: Clock) -> None:
    first, second = make_servo(clock), make_servo(clock, servo_id=2)
    bus = ServoBus([first, second])
    first.silent = True
    assert bus.reply(packet(0xFE, bytes([0x82, 132, 0, 4, 0, 1, 2]))) == b""
    assert bus.reply(packet(0xFE, bytes([0x82, 132, 0, 4, 0, 2]))) != b""


def test_status_return_level_silences_all_but_ping(clock: Clock) -> None:
    servo = make_servo(clock)
    bus = ServoBus([servo])
    servo.write(68, b"\x00")
    assert bus.reply(packet(1, bytes([2, 132, 0, 4, 0]))) == b""
    assert bus.reply(packet(1, bytes([3, 65, 0, 1]))) == b""
    assert bus.reply(packet(1, b"\x01")) != b""


@given(st.integers(0, 255), st.sampled_from([1, 2, 0xFE]), st.binary(max_size=40))
def test_no_packet_however_odd_breaks_the_bus(instruction: int, servo_id: int, parameters: bytes) -> None:
    clock = Clock()
    bus = ServoBus([make_servo(clock), make_servo(clock, servo_id=2)])
    bus.reply(packet(servo_id, bytes([instruction]) + parameters))
    for servo in bus.servos:
        clock.now_s += 1.0
        servo.shaft()
        assert number(servo, 0, 2) == 1020


def test_an_unknown_instruction_is_an_error(clock: Clock) -> None:
    assert ServoBus([make_servo(clock)]).reply(packet(1, b"\x33")) == status_packet(1, 2)


def test_eeprom_is_locked_while_torque_is_on(servo: Servo) -> None:
    assert servo.write(52, u32(100)) == NOTHING
    assert servo.write(64, b"\x01") == NOTHING
    assert servo.write(52, u32(0)) == ACCESS
    assert servo.write(64, b"\x00") == NOTHING
    assert servo.write(52, u32(0)) == NOTHING


@pytest.mark.parametrize(
    ("address", "data", "error"),
    [
        (132, u32(0), ACCESS),  # read-only
        (14, b"\x00", ACCESS),  # undefined
        (116, b"\x00\x00", LENGTH),
        (7, bytes([253]), RANGE),
        (11, bytes([2]), RANGE),
        (104, u32(351), LIMIT),
        (100, (886).to_bytes(2, "little"), LIMIT),
        (112, u32(32768), RANGE),
        (98, bytes([0x80]), RANGE),
    ],
)
def test_bad_writes_are_refused_with_their_number(
    servo: Servo, address: int, data: bytes, error: int
) -> None:
    assert servo.write(address, data) == error


def test_a_refused_write_changes_nothing(servo: Servo) -> None:
    assert servo.write(108, u32(50) + u32(70) + u32(9999)) == LIMIT
    assert (number(servo, 108, 4), number(servo, 112, 4)) == (0, 0)


def test_reading_what_is_not_there_is_an_access_error(servo: Servo) -> None:
    assert servo.read(15, 1)[0] == ACCESS
    assert servo.read(660, 4)[0] == ACCESS


def test_the_xl430_has_load_and_no_current_control(clock: Clock) -> None:
    servo = make_servo(clock, XL430_W250)
    assert number(servo, 0, 2) == 1060
    assert servo.write(102, b"\x01\x00") == ACCESS
    assert servo.write(11, b"\x00") == RANGE


def test_indirect_registers_gather_what_is_scattered(servo: Servo) -> None:
    for i, address in enumerate((70, 144, 145, 65)):
        assert servo.write(168 + 2 * i, address.to_bytes(2, "little")) == NOTHING
    assert servo.read(224, 3) == (NOTHING, bytes([0, 120, 0]))
    assert servo.write(227, b"\x01") == NOTHING
    assert number(servo, 65, 1) == 1


def test_a_change_of_mode_resets_profile_and_gains(servo: Servo) -> None:
    servo.write(112, u32(100))
    servo.write(84, (500).to_bytes(2, "little"))
    servo.write(11, b"\x03")
    assert (number(servo, 112, 4), number(servo, 84, 2)) == (0, 800)


def start_moving(servo: Servo, goal: int, velocity: int = 44, acceleration: int = 8) -> None:
    servo.write(108, u32(acceleration) + u32(velocity))
    servo.write(64, b"\x01")
    assert servo.write(116, u32(goal)) == NOTHING


def test_motion_follows_the_trapezoid(servo: Servo, clock: Clock) -> None:
    speed_deg_s, acceleration_deg_s2 = 44 * 1.374, 8 * 21.4577
    start_moving(servo, 2048 + 1024)
    ramp_s = speed_deg_s / acceleration_deg_s2
    clock.now_s += ramp_s / 2
    assert servo.shaft()[0] - 180.0 == pytest.approx(acceleration_deg_s2 * (ramp_s / 2) ** 2 / 2)
    clock.now_s += ramp_s
    assert number(servo, 128, 4) == 44
    assert (number(servo, 122, 1), number(servo, 123, 1)) == (1, 0b110010)
    assert number(servo, 126, 2) > 0
    clock.now_s += 90.0 / speed_deg_s + ramp_s - 1.5 * ramp_s - 0.001
    assert number(servo, 122, 1) == 1
    clock.now_s += 0.002
    assert (number(servo, 122, 1), number(servo, 123, 1)) == (0, 1)
    assert number(servo, 132, 4) == 3072


def test_without_a_profile_the_motor_runs_at_57_rpm(servo: Servo, clock: Clock) -> None:
    start_moving(servo, 4095, velocity=0, acceleration=0)
    clock.now_s += 0.3
    assert number(servo, 128, 4) == pytest.approx(57 / 0.229, abs=1)


def test_a_new_goal_while_moving_keeps_position_and_speed_continuous(servo: Servo, clock: Clock) -> None:
    start_moving(servo, 4000)
    clock.now_s += 1.0
    before = servo.shaft()[0]
    servo.write(116, u32(1000))
    assert servo.shaft()[0] == pytest.approx(before)
    clock.now_s += 0.001
    assert servo.shaft()[0] == pytest.approx(before + 0.0604, abs=1e-3)
    clock.now_s += 30.0
    assert number(servo, 132, 4) == 1000


def test_time_based_profile_takes_its_time(clock: Clock) -> None:
    servo = make_servo(clock, eeprom={"drive_mode": 4})
    start_moving(servo, 3048, velocity=1500, acceleration=300)
    clock.now_s += 1.499
    assert number(servo, 122, 1) == 1
    clock.now_s += 0.002
    assert (number(servo, 122, 1), number(servo, 132, 4)) == (0, 3048)


def test_velocity_mode_turns_until_another_goal(servo: Servo, clock: Clock) -> None:
    servo.write(11, b"\x01")
    servo.write(64, b"\x01")
    servo.write(104, u32(100))
    clock.now_s += 10.0
    assert number(servo, 132, 4) > 4096
    servo.write(104, u32(0))
    clock.now_s += 1.0
    assert number(servo, 122, 1) == 0


def test_torque_on_folds_the_count_into_one_turn(servo: Servo, clock: Clock) -> None:
    servo.write(11, b"\x04")
    start_moving(servo, 10000, velocity=200, acceleration=0)
    clock.now_s += 10.0
    assert number(servo, 132, 4) == 10000
    servo.write(64, b"\x00")
    servo.write(64, b"\x01")
    assert number(servo, 132, 4) == 10000 % 4096


def test_reverse_mode_turns_the_other_way(clock: Clock) -> None:
    servo = make_servo(clock, eeprom={"drive_mode": 1}, shaft_tick=2048.0)
    start_moving(servo, 2148)
    clock.now_s += 5.0
    assert number(servo, 132, 4) == 2148
    assert servo.shaft()[0] == pytest.approx(180.0 - 100 * 360 / 4096)


def test_gears_add_play_and_a_swing_that_dies_away(clock: Clock) -> None:
    gears = GearTrain(backlash_deg=0.1, ring_deg=0.3)
    servo = make_servo(clock, gears=gears, shaft_tick=1000.0)
    start_moving(servo, 2048)
    clock.now_s += 100.0
    assert servo.shaft()[0] == pytest.approx(180.05)
    servo.write(116, u32(1848))
    while servo.shaft()[1]:
        clock.now_s += 0.001
    swing = [abs(servo.shaft()[0] - (1848 * 360 / 4096 - 0.05))]
    for _ in range(1000):
        clock.now_s += 0.001
        swing.append(abs(servo.shaft()[0] - (1848 * 360 / 4096 - 0.05)))
    assert max(swing) > 0.1
    assert max(swing[-100:]) < 0.001


def test_the_watchdog_stops_the_servo_and_locks_its_goals(servo: Servo, clock: Clock) -> None:
    bus = ServoBus([servo])
    start_moving(servo, 4000)
    servo.write(98, bytes([10]))
    for _ in range(10):
        clock.now_s += 0.19
        bus.reply(packet(1, b"\x01"))
    assert servo.shaft()[1]
    clock.now_s += 0.2
    stopping = servo.shaft()[0]
    clock.now_s += 1.0
    assert servo.shaft()[0] - stopping < 2.0
    assert number(servo, 98, 1) == -1
    assert (number(servo, 108, 4), number(servo, 112, 4)) == (0, 0)
    assert servo.write(116, u32(2048)) == RANGE
    assert servo.write(98, b"\x00") == NOTHING
    assert servo.write(116, u32(2048)) == NOTHING


def test_a_shutdown_takes_torque_until_a_reboot(servo: Servo, clock: Clock) -> None:
    bus = ServoBus([servo])
    start_moving(servo, 4000)
    clock.now_s += 0.5
    servo.fail(OVERLOAD_ERROR)
    assert number(servo, 64, 1) == 0
    assert bus.reply(packet(1, bytes([3, 64, 0, 1]))) == status_packet(1, 0x80)
    assert number(servo, 64, 1) == 0
    bus.reply(packet(1, b"\x08"))
    assert bus.reply(packet(1, b"\x01")) == b""
    clock.now_s += REBOOT_S
    assert bus.reply(packet(1, bytes([3, 64, 0, 1]))) == status_packet(1, 0)
    assert number(servo, 64, 1) == 1


def test_an_error_outside_the_shutdown_mask_only_alerts(servo: Servo) -> None:
    servo.write(64, b"\x01")
    servo.supply_v = 9.0
    assert number(servo, 70, 1) == VOLTAGE_ERROR
    assert number(servo, 64, 1) == 1
    servo.fail(SHOCK_ERROR)
    assert number(servo, 64, 1) == 0


def test_clear_needs_a_servo_at_rest(servo: Servo, clock: Clock) -> None:
    bus = ServoBus([servo])
    request = hexes("FF FF FD 00 01 08 00 10 01 44 58 4C 22 B1 DC")
    servo.write(11, b"\x04")
    start_moving(servo, 9000)
    clock.now_s += 1.0
    assert bus.reply(request) == status_packet(1, 1)
    clock.now_s += 60.0
    assert bus.reply(request) == status_packet(1, 0)
    assert number(servo, 132, 4) == 9000 % 4096


def test_factory_reset_keeps_the_id_and_is_refused_to_all(clock: Clock) -> None:
    servo = make_servo(clock, servo_id=1)
    bus = ServoBus([servo])
    servo.write(52, u32(100))
    assert bus.reply(packet(0xFE, bytes([6, 0xFF]))) == b""
    assert number(servo, 52, 4) == 100
    assert bus.reply(hexes("FF FF FD 00 01 04 00 06 01 A1 E6")) == status_packet(1, 0)
    assert (number(servo, 52, 4), number(servo, 7, 1)) == (0, 1)


@pytest.fixture
def wire() -> Iterator[tuple[sdk.PortHandler, list[Servo]]]:
    """Two live servos at 1 Mbaud on a pseudo-terminal, and the SDK's port opened on it."""
    servos = [
        Servo(
            MODELS["XM430-W350"],
            servo_id,
            clock=time.monotonic,
            rng=np.random.default_rng(servo_id),
            eeprom={"baud_rate": 3, "return_delay_time": 0},
        )
        for servo_id in (1, 2)
    ]
    port = PtyPort()
    ServoBus(servos).serve(port)
    handler = sdk.PortHandler(port.path)
    handler.setBaudRate(1_000_000)
    yield handler, servos
    handler.closePort()
    port.close()


def test_the_unmodified_sdk_talks_to_the_servos(
    wire: tuple[sdk.PortHandler, list[Servo]], monkeypatch: pytest.MonkeyPatch
) -> None:
    # It waits 34 ms for an answer; a thread of a busy computer may take longer.
    monkeypatch.setattr("dynamixel_sdk.port_handler.LATENCY_TIMER", 1000)
    port, _ = wire
    handler = sdk.Protocol2PacketHandler()
    assert handler.ping(port, 1) == (1020, sdk.COMM_SUCCESS, 0)
    assert handler.write1ByteTxRx(port, 1, 64, 1) == (sdk.COMM_SUCCESS, 0)
    assert handler.write4ByteTxRx(port, 1, 116, 2148) == (sdk.COMM_SUCCESS, 0)
    assert handler.read4ByteTxRx(port, 1, 116) == (2148, sdk.COMM_SUCCESS, 0)
    assert handler.read4ByteTxRx(port, 2, 132) == (2048, sdk.COMM_SUCCESS, 0)
    reader = sdk.GroupSyncRead(port, handler, 122, 25)
    for servo_id in (1, 2):
        reader.addParam(servo_id)
    assert reader.txRxPacket() == sdk.COMM_SUCCESS
    assert reader.getData(2, 144, 2) == 120
    assert reader.fastSyncRead() == sdk.COMM_SUCCESS
    assert reader.getData(2, 132, 4) == 2048
    writer = sdk.GroupSyncWrite(port, handler, 65, 1)
    for servo_id in (1, 2):
        writer.addParam(servo_id, [1])
    assert writer.txPacket() == sdk.COMM_SUCCESS
    assert handler.read1ByteTxRx(port, 2, 65) == (1, sdk.COMM_SUCCESS, 0)


def test_a_servo_at_another_baud_rate_is_silent(wire: tuple[sdk.PortHandler, list[Servo]]) -> None:
    port, _ = wire
    port.setBaudRate(57600)
    assert sdk.Protocol2PacketHandler().ping(port, 1)[1] == sdk.COMM_RX_TIMEOUT


def open_descriptors() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


def test_closing_a_port_leaves_nothing_open() -> None:
    before = open_descriptors()
    port = PtyPort()
    port.answer(lambda data: data)
    port.close()
    port.close()
    assert open_descriptors() == before
