"""Servo bus and control table: refusals, silence and noise, each as one named error."""

from collections.abc import Iterator

import pytest
from dynamixel_easy_sdk import ControlTable
from fakes.servos import GOAL, POSITION, TORQUE, FakeServo, FakeServoBus, status_packet

from rig.devices.bus.serial_port import SerialPort
from rig.devices.dynamixel import control_table as table
from rig.devices.dynamixel.servo import Servo
from rig.devices.dynamixel.servo_bus import RefusedError, ServoBus
from rig.devices.dynamixel.servo_group import read_states, require_models
from rig.errors import TransientError, WrongDeviceError


@pytest.fixture
def servos() -> Iterator[FakeServoBus]:
    with FakeServoBus(FakeServo(1), FakeServo(2, model_number=1060)) as bus:
        yield bus


@pytest.fixture
def bus(servos: FakeServoBus) -> Iterator[ServoBus]:
    bus = ServoBus(SerialPort(servos.path, 1_000_000))
    yield bus
    bus.close()


def test_ping_gives_model_and_firmware(bus):
    assert bus.ping(1) == (1020, 45)
    assert bus.ping(2) == (1060, 45)


def test_a_silent_servo_is_named_with_what_to_check(bus, servos):
    with pytest.raises(TransientError, match=rf"servo id 7 on {servos.path}: no answer; check power"):
        bus.read(7, POSITION, 4)


def test_a_damaged_answer_says_what_came(bus, servos):
    servos.corrupt_next = 1
    with pytest.raises(TransientError, match=r"no valid answer .received a packet with a wrong CRC"):
        bus.read(1, POSITION, 4)
    assert bus.read(1, POSITION, 4) == (2048).to_bytes(4, "little")


def test_an_answer_after_noise_is_understood(bus, servos):
    servos.noise_before = b"\x00\xff\xff\xfd\x00\x01\x09"
    assert bus.read(1, POSITION, 4) == (2048).to_bytes(4, "little")


def test_an_answer_with_the_header_pattern_in_it_is_understood(bus, servos):
    servos.servos[1].registers[126:132] = b"\xff\xff\xfd\x00\x00\x00"
    assert bus.read(1, 126, 6) == b"\xff\xff\xfd\x00\x00\x00"


def test_a_refusal_says_why(bus, servos):
    servos.servos[1].registers[TORQUE] = 1
    with pytest.raises(RefusedError, match=r"servo id 1 .* does not allow that register to be accessed now"):
        bus.write(1, 11, b"\x03")
    with pytest.raises(RefusedError, match="beyond its limit registers"):
        bus.write(1, GOAL, (5000).to_bytes(4, "little"))


def test_a_bus_of_the_right_models_gives_their_firmware(bus):
    assert require_models(bus, {1: "XM430-W350", 2: "XL430-W250"}) == {1: 45, 2: 45}


def test_another_model_is_refused_with_all_that_was_expected_and_found(bus):
    with pytest.raises(WrongDeviceError) as refused:
        require_models(bus, {1: "XM430-W350", 2: "XM430-W350"})
    assert "expected id 1: XM430-W350, id 2: XM430-W350, found id 1: XM430-W350, id 2: XL430-W250" in str(
        refused.value
    )


def test_a_missing_servo_is_listed_with_those_found(bus):
    with pytest.raises(TransientError, match="found id 1: XM430-W350, id 3: no answer; check servo power"):
        require_models(bus, {1: "XM430-W350", 3: "XM430-W350"})


def test_an_unknown_model_is_named_by_its_number(bus, servos):
    servos.servos[2].put(0, 2, 1200)
    with pytest.raises(WrongDeviceError, match="id 2: model number 1200"):
        require_models(bus, {1: "XM430-W350", 2: "XM430-W350"})


def test_the_state_of_both_servos_comes_in_si_units_from_one_instruction(bus, servos):
    for servo in servos.servos.values():
        servo.put(123, 1, 0b0000_0001)
        servo.put(126, 2, -100)
        servo.put(128, 4, -10)
        servo.put(144, 2, 121)
        servo.put(146, 1, 42)
    states = read_states(bus, [Servo(bus, 1, "XM430-W350", "pan"), Servo(bus, 2, "XL430-W250", "tilt")])
    assert len(servos.requests) == 1
    assert servos.requests[0] == bytes.fromhex("FF FF FD 00 FE 09 00 82 7A 00 19 00 01 02 38 0E")
    pan, tilt = states
    assert (pan.position_tick, pan.moving, pan.in_position, pan.alert) == (2048, False, True, False)
    assert pan.velocity_deg_s == pytest.approx(-13.74)
    assert (pan.voltage_v, pan.temperature_c) == (pytest.approx(12.1), 42.0)
    assert (pan.current_a, pan.load_percent) == (pytest.approx(-0.269), None)
    assert (tilt.current_a, tilt.load_percent) == (None, pytest.approx(-10.0))


def test_a_silent_servo_in_a_state_is_named(bus, servos):
    servos.servos[2].silent = True
    servo_pair = [Servo(bus, 1, "XM430-W350", "pan"), Servo(bus, 2, "XL430-W250", "tilt")]
    with pytest.raises(TransientError, match=r"^tilt servo \(id 2\) on .*: no valid answer"):
        read_states(bus, servo_pair)


def test_every_hardware_error_has_a_name(bus, servos):
    servo = Servo(bus, 1, "XM430-W350", "pan")
    servos.servos[1].registers[70] = 0x25
    assert servo.hardware_errors() == ("input voltage out of range", "overheated", "overload")
    servos.servos[1].registers[70] = 0x42
    assert servo.hardware_errors() == ("unknown hardware error 0x42",)
    servos.servos[1].registers[70] = 0
    assert servo.hardware_errors() == ()


def test_the_eeprom_is_written_only_where_it_differs(bus, servos):
    servo = Servo(bus, 1, "XM430-W350", "pan")
    servo.configure(100, 4000, 60.0, 180.0)
    assert [(a, v) for a, v in eeprom_writes(servos)] == [(9, 0), (52, 100), (48, 4000)]
    servos.writes.clear()
    servo.configure(100, 4000, 60.0, 180.0)
    assert eeprom_writes(servos) == []


def eeprom_writes(servos: FakeServoBus) -> list[tuple[int, int]]:
    return [(address, int.from_bytes(data, "little")) for _, address, data in servos.writes if address < 64]


def test_the_profile_survives_a_change_of_mode(bus, servos):
    servos.servos[1].put(11, 1, 1)
    Servo(bus, 1, "XM430-W350", "pan").configure(0, 4095, 60.0, 180.0)
    assert servos.servos[1].get(11, 1) == table.POSITION_MODE
    assert servos.servos[1].get(112, 4) == round(60.0 / 1.374)
    assert servos.servos[1].get(108, 4) == round(180.0 / 21.4577)


def test_a_very_slow_profile_is_not_rounded_to_0_which_means_full_speed(bus, servos):
    Servo(bus, 1, "XM430-W350", "pan").set_profile(0.1, 0.1)
    assert (servos.servos[1].get(112, 4), servos.servos[1].get(108, 4)) == (1, 1)


# Chip facts: address, length, name; the two models differ at 126 only, as far as the rig uses them.
USED = {
    "Model Number": (0, 2),
    "Firmware Version": (6, 1),
    "ID": (7, 1),
    "Return Delay Time": (9, 1),
    "Drive Mode": (10, 1),
    "Operating Mode": (11, 1),
    "Max Position Limit": (48, 4),
    "Min Position Limit": (52, 4),
    "Torque Enable": (64, 1),
    "Hardware Error Status": (70, 1),
    "Bus Watchdog": (98, 1),
    "Profile Acceleration": (108, 4),
    "Profile Velocity": (112, 4),
    "Goal Position": (116, 4),
    "Moving": (122, 1),
    "Moving Status": (123, 1),
    "Present Velocity": (128, 4),
    "Present Position": (132, 4),
    "Present Input Voltage": (144, 2),
    "Present Temperature": (146, 1),
}


@pytest.mark.parametrize("model", table.MODEL_NUMBERS)
def test_the_control_table_is_that_of_the_manual(model):
    registers = table.control_table(model)
    assert {name: (registers[name].address, registers[name].length) for name in USED} == USED
    own = {"XM430-W350": "Present Current", "XL430-W250": "Present Load"}[model]
    assert (registers[own].address, registers[own].length, registers[own].signed) == (126, 2, True)
    assert ("Goal Current" in registers) == (model == "XM430-W350")


@pytest.mark.parametrize(("model", "number"), table.MODEL_NUMBERS.items())
def test_the_vendors_own_parser_reads_the_same_table(model, number):
    vendors = ControlTable.getControlTable(number)
    ours = table.control_table(model)
    assert {name: (item.address, item.size) for name, item in vendors.items()} == {
        name: (register.address, register.length) for name, register in ours.items()
    }


def test_units_are_those_of_the_manual():
    assert 360 / table.TICKS_PER_TURN == 0.087890625
    assert pytest.approx(1.374) == table.VELOCITY_UNIT_DEG_S
    assert pytest.approx(21.4577) == table.ACCELERATION_UNIT_DEG_S2


def test_a_late_answer_to_an_earlier_packet_is_no_refusal_to_read(bus, servos):
    data_range = 4
    servos.noise_before = status_packet(1, data_range, b"")
    servos.corrupt_next = 1
    with pytest.raises(TransientError, match="answered an earlier instruction, late"):
        bus.read(1, POSITION, 4)
