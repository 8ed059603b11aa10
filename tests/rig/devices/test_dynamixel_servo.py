"""One servo by its registers: what is written, in what order, and what the values mean (e-manual, "Control Table").

The bus is a register file with the rules that matter: the EEPROM is locked while the torque is on, and a new operating
mode resets the profile.
"""

import pytest

from rig.devices.dynamixel.servo import Servo, ServoState
from rig.errors import DeviceError, TransientError
from rig.fault_notes import collecting

DRIVE_MODE, OPERATING_MODE, SECONDARY_ID, PROTOCOL, HOMING = 10, 11, 12, 13, 20
TEMPERATURE_LIMIT, MAX_VOLTAGE, MIN_VOLTAGE, PWM_LIMIT, VELOCITY_LIMIT = 31, 32, 34, 36, 44
MAX_POSITION, MIN_POSITION, STARTUP, SHUTDOWN, TORQUE, STATUS_RETURN, HARDWARE_ERROR = (
    48,
    52,
    60,
    63,
    64,
    68,
    70,
)
WATCHDOG, PROFILE_ACCELERATION, PROFILE_VELOCITY, GOAL = 98, 108, 112, 116
POSITION = 132

# Address, length, value: the factory's.
COMMON = [
    (9, 1, 250),
    (10, 1, 0),
    (11, 1, 3),
    (12, 1, 255),
    (13, 1, 2),
    (24, 4, 10),
    (36, 2, 885),
    (48, 4, 4095),
]
COMMON += [
    (63, 1, 0x34),
    (68, 1, 2),
    (78, 2, 100),
    (100, 2, 885),
    (132, 4, 2048),
    (144, 2, 120),
    (146, 1, 31),
]
OF_MODEL = {
    "XM430-W350": [
        (31, 1, 80),
        (32, 2, 160),
        (34, 2, 95),
        (38, 2, 1193),
        (44, 4, 350),
        (76, 2, 1920),
        (84, 2, 800),
        (102, 2, 1193),
    ],
    "XL430-W250": [
        (31, 1, 72),
        (32, 2, 140),
        (34, 2, 60),
        (44, 4, 265),
        (76, 2, 1000),
        (80, 2, 4000),
        (84, 2, 640),
    ],
}


class RegisterBus:
    """In place of a ``ServoBus``; keeps what was written, by address."""

    path = "/dev/ttyX"

    def __init__(self, model: str = "XM430-W350") -> None:
        self.registers = bytearray(256)
        self.writes: list[tuple[int, int]] = []
        self.cleared = 0
        for address, length, value in COMMON + OF_MODEL[model]:
            self.put(address, length, value)

    def put(self, address: int, length: int, value: int) -> None:
        self.registers[address : address + length] = value.to_bytes(length, "little", signed=value < 0)

    def get(self, address: int, length: int) -> int:
        return int.from_bytes(self.registers[address : address + length], "little", signed=length == 4)

    def read(self, servo_id: int, address: int, length: int) -> bytes:
        assert servo_id == 7
        if self.registers[STATUS_RETURN] == 0:
            raise TransientError("servo", "no answer", "")
        return bytes(self.registers[address : address + length])

    def write(self, servo_id: int, address: int, data: bytes) -> None:
        assert servo_id == 7
        assert address >= 64 or not self.registers[TORQUE], "the EEPROM is locked while the torque is on"
        self.writes.append((address, int.from_bytes(data, "little", signed=len(data) == 4)))
        self.registers[address : address + len(data)] = data
        if address == OPERATING_MODE:
            self.put(PROFILE_ACCELERATION, 4, 0)
            self.put(PROFILE_VELOCITY, 4, 0)

    write_unanswered = write

    def clear_multi_turn(self, servo_id: int) -> None:
        self.cleared += 1
        self.put(POSITION, 4, self.get(POSITION, 4) % 4096)


@pytest.fixture
def bus() -> RegisterBus:
    return RegisterBus()


@pytest.fixture
def servo(bus: RegisterBus) -> Servo:
    return Servo(bus, 7, "XM430-W350", "pan")  # type: ignore[arg-type]


def test_values_are_little_endian_and_signed_where_they_can_be_negative(
    servo: Servo, bus: RegisterBus
) -> None:
    bus.registers[132:136] = bytes.fromhex("2EFBFFFF")
    assert servo.read("Present Position") == -1234
    bus.registers[112:116] = bytes.fromhex("FF7F0000")
    assert servo.read("Profile Velocity") == 32767
    servo.write("Goal Position", -1234)
    assert bus.registers[116:120] == bytes.fromhex("2EFBFFFF")
    assert servo.name == "pan servo (id 7) on /dev/ttyX"


@pytest.mark.parametrize(
    ("stands", "goal"), [(1000, 1100), (1100, 1100), (2048, 2048), (3000, 3000), (3050, 3000)]
)
def test_the_torque_comes_on_with_the_goal_where_the_head_stands_or_at_its_limit(
    servo: Servo, bus: RegisterBus, stands: int, goal: int
) -> None:
    bus.put(POSITION, 4, stands)
    servo.hold(1100, 3000)
    assert bus.writes == [(GOAL, goal), (TORQUE, 1)]


@pytest.mark.parametrize(
    ("stands", "jumps_to", "is_refused"),
    [
        (2048, 2048 + 64, False),
        (2048, 2048 + 65, True),
        (2048, 2048 - 64, False),
        (2048, 2048 - 65, True),
        (1000, 936, False),  # on its way to the limit at 1100
        (1000, 1164, False),
        (1000, 1165, True),
        (3200, 2936, False),  # and down to the one at 3000
        (3200, 2935, True),
        (3200, 3265, True),
    ],
)
def test_a_head_that_jumps_when_the_torque_comes_on_is_let_go(
    servo: Servo,
    bus: RegisterBus,
    monkeypatch: pytest.MonkeyPatch,
    stands: int,
    jumps_to: int,
    is_refused: bool,
) -> None:
    bus.put(POSITION, 4, stands)
    write = bus.write

    def jumping(servo_id: int, address: int, data: bytes) -> None:
        write(servo_id, address, data)
        if (address, data) == (TORQUE, b"\x01"):
            bus.put(POSITION, 4, jumps_to)

    monkeypatch.setattr(bus, "write", jumping)
    if is_refused:
        with pytest.raises(DeviceError, match=f"its position went from tick {stands} to {jumps_to} when the"):
            servo.hold(1100, 3000)
    else:
        servo.hold(1100, 3000)
    assert bus.registers[TORQUE] == (not is_refused)


@pytest.mark.parametrize(("tick", "way"), [(-1, "backward"), (0, None), (4095, None), (4096, "forward")])
def test_one_turn_is_0_to_4095(servo: Servo, bus: RegisterBus, tick: int, way: str | None) -> None:
    bus.put(POSITION, 4, tick)
    if way is None:
        servo.hold(0, 4095)
        return
    with pytest.raises(
        DeviceError, match=rf"stands at tick {tick}, beyond one turn \(0 to 4095\): .* too far {way}"
    ):
        servo.hold(0, 4095)
    assert bus.writes == []


def test_it_is_set_up_in_position_mode_and_the_profile_comes_after_the_mode(
    servo: Servo, bus: RegisterBus
) -> None:
    """90 deg/s are 65.5 of 1.374 deg/s; 300 deg/s^2 are 13.98 of 21.4577 deg/s^2."""
    for address, length, value in [
        (TORQUE, 1, 1),
        (OPERATING_MODE, 1, 4),
        (DRIVE_MODE, 1, 1),
        (HOMING, 4, -5),
    ]:
        bus.put(address, length, value)
    servo.configure(100, 4000, 90.0, 300.0)
    assert bus.writes[:2] == [(TORQUE, 0), (WATCHDOG, 0)]
    assert dict(bus.writes[2:]) == {
        HOMING: 0,
        DRIVE_MODE: 0,
        OPERATING_MODE: 3,
        9: 0,
        MIN_POSITION: 100,
        MAX_POSITION: 4000,
        PROFILE_ACCELERATION: 14,
        PROFILE_VELOCITY: 66,
    }
    assert (bus.get(PROFILE_ACCELERATION, 4), bus.get(PROFILE_VELOCITY, 4)) == (14, 66)
    bus.writes.clear()
    servo.configure(100, 4000, 90.0, 300.0)
    assert [a for a, _ in bus.writes if a < 64] == [], "the EEPROM wears out"


def test_setting_up_makes_it_answer_everything_first(servo: Servo, bus: RegisterBus) -> None:
    bus.registers[STATUS_RETURN] = 0
    servo.configure(100, 4000, 90.0, 300.0)
    assert bus.writes[0] == (STATUS_RETURN, 2)


def test_a_slow_profile_is_not_rounded_to_one_without_limit(servo: Servo, bus: RegisterBus) -> None:
    servo.set_profile(0.1, 0.1)
    assert bus.writes == [(PROFILE_ACCELERATION, 1), (PROFILE_VELOCITY, 1)]


def test_the_bus_watchdog_counts_in_20_ms(servo: Servo, bus: RegisterBus) -> None:
    servo.arm_bus_watchdog(1.0)
    assert bus.registers[WATCHDOG] == 50
    servo.arm_bus_watchdog(0.001)
    assert bus.registers[WATCHDOG] == 1
    assert not servo.bus_watchdog_tripped()
    bus.registers[WATCHDOG] = 0xFF
    assert servo.bus_watchdog_tripped()
    servo.disarm_bus_watchdog()
    assert bus.registers[WATCHDOG] == 0


@pytest.mark.parametrize("level", [0, 1])
def test_a_servo_that_does_not_answer_everything_is_set_to(
    servo: Servo, bus: RegisterBus, level: int
) -> None:
    bus.registers[STATUS_RETURN] = level
    servo.set_status_return_all()
    assert bus.writes == [(STATUS_RETURN, 2)]
    servo.set_status_return_all()
    assert bus.writes == [(STATUS_RETURN, 2)], "and nothing is written where it is right"


def test_a_servo_that_answers_reads_is_left_as_it_is_where_reads_suffice(
    servo: Servo, bus: RegisterBus
) -> None:
    bus.registers[STATUS_RETURN] = 1
    servo.ensure_reads_answered()
    assert bus.writes == []
    bus.registers[STATUS_RETURN] = 0
    servo.ensure_reads_answered()
    assert bus.writes == [(STATUS_RETURN, 2)]


def test_a_servo_that_keeps_its_status_return_level_is_reported(
    servo: Servo, bus: RegisterBus, monkeypatch: pytest.MonkeyPatch
) -> None:
    bus.registers[STATUS_RETURN] = 1
    monkeypatch.setattr(bus, "write_unanswered", lambda *_: None)
    with pytest.raises(
        TransientError, match="answers a ping and keeps its Status Return Level; set register 68 to 2"
    ):
        servo.set_status_return_all()


@pytest.mark.parametrize(("left", "writes"), [(0, [255]), (252, [255]), (253, []), (255, [])])
def test_a_secondary_id_is_switched_off(servo: Servo, bus: RegisterBus, left: int, writes: list[int]) -> None:
    """253 and above are none."""
    bus.registers[TORQUE] = 1
    bus.registers[SECONDARY_ID] = left
    servo.disable_secondary_id()
    assert bus.writes == [(TORQUE, 0), *((SECONDARY_ID, value) for value in writes)]


@pytest.mark.parametrize("model", ["XM430-W350", "XL430-W250"])
def test_a_servo_as_the_factory_made_it_is_left_alone(model: str) -> None:
    bus = RegisterBus(model)
    servo = Servo(bus, 7, model, "pan")  # type: ignore[arg-type]
    with collecting() as notes:
        servo.clear_eeprom(45)
        servo.clear_ram()
    assert bus.writes == [(TORQUE, 0)]
    assert list(notes.all()) == []


LIMITS = {
    "XM430-W350": {24: 10, 36: 885, 38: 1193, 44: 350, 31: 80, 34: 95, 32: 160},
    "XL430-W250": {24: 10, 36: 885, 44: 265, 31: 72, 34: 60, 32: 140},
}
LENGTHS = {24: 4, 36: 2, 38: 2, 44: 4, 31: 1, 34: 2, 32: 2}
GAINS = {
    "XM430-W350": {76: 1920, 78: 100, 80: 0, 82: 0, 84: 800, 88: 0, 90: 0, 100: 885, 102: 1193},
    "XL430-W250": {76: 1000, 78: 100, 80: 4000, 82: 0, 84: 640, 88: 0, 90: 0, 100: 885},
}


@pytest.mark.parametrize("model", LIMITS)
def test_what_another_program_left_is_set_to_the_factorys_values(model: str) -> None:
    bus = RegisterBus(model)
    servo = Servo(bus, 7, model, "pan")  # type: ignore[arg-type]
    for address, value in LIMITS[model].items():
        # Protection registers may be narrower than the factory's, so these are left too wide.
        bus.put(address, LENGTHS[address], 1 if address == MIN_VOLTAGE else min(value + 40, 255))
    bus.put(PWM_LIMIT, 2, 5)
    bus.put(VELOCITY_LIMIT, 4, 0)
    for address, value in {PROTOCOL: 1, STARTUP: 3, SHUTDOWN: 0x08}.items():
        bus.registers[address] = value
    for address, value in GAINS[model].items():
        bus.put(address, 2, value + 1)
    servo.clear_eeprom(45)
    servo.clear_ram()
    assert {a: bus.get(a, LENGTHS[a]) for a in LIMITS[model]} == LIMITS[model]
    assert (bus.registers[PROTOCOL], bus.registers[STARTUP]) == (2, 0)
    assert bus.registers[SHUTDOWN] == 0x3C, "the factory's bits are added to those set"
    assert {a: bus.get(a, 2) for a in GAINS[model]} == GAINS[model]


def test_limits_narrower_than_the_factorys_are_kept(servo: Servo, bus: RegisterBus) -> None:
    for address, length, value in [(TEMPERATURE_LIMIT, 1, 60), (MIN_VOLTAGE, 2, 110), (MAX_VOLTAGE, 2, 130)]:
        bus.put(address, length, value)
    servo.clear_eeprom(45)
    assert bus.writes == [(TORQUE, 0)]
    bus.put(TEMPERATURE_LIMIT, 1, 0)  # which would be an error at any temperature
    servo.clear_eeprom(45)
    assert bus.registers[TEMPERATURE_LIMIT] == 80


@pytest.mark.parametrize(
    ("offset", "problems"), [(-300, ["had a Homing Offset of -300 ticks, left by another program"]), (0, [])]
)
def test_a_homing_offset_is_taken_away_and_noted(
    servo: Servo, bus: RegisterBus, offset: int, problems: list[str]
) -> None:
    """It shifts what zero_tick means."""
    bus.put(HOMING, 4, offset)
    with collecting() as notes:
        servo.clear_eeprom(45)
    assert bus.get(HOMING, 4) == 0
    assert [note.problem for note in notes.all()] == problems


def test_a_reversed_position_is_looked_at_once(servo: Servo, bus: RegisterBus) -> None:
    """In position mode and not reversed there is nothing that could be forgotten."""
    bus.put(POSITION, 4, 5000)
    servo.clear_eeprom(45)
    assert bus.writes == [(TORQUE, 0)]


@pytest.mark.parametrize(("firmware", "left"), [(44, 3), (45, 0)])
def test_the_startup_configuration_exists_from_firmware_45_on(
    servo: Servo, bus: RegisterBus, firmware: int, left: int
) -> None:
    bus.registers[STARTUP] = 3
    servo.clear_eeprom(firmware)
    assert bus.registers[STARTUP] == left


@pytest.mark.parametrize(
    ("mode", "homing", "position", "is_refused"),
    [
        # Extended position: the offset counts in full. 4200 with 200 of it is the shaft's 4000.
        (4, 200, 4200, False),
        (4, 200, 4300, True),
        (4, -200, -150, False),
        (4, -200, -250, True),
        (4, 5000, 5100, False),
        (1, 0, 4095, False),
        (1, 0, 4096, True),
    ],
)
def test_a_mode_is_not_changed_where_that_forgets_a_turn(
    servo: Servo, bus: RegisterBus, mode: int, homing: int, position: int, is_refused: bool
) -> None:
    bus.registers[OPERATING_MODE] = mode
    bus.put(HOMING, 4, homing)
    bus.put(POSITION, 4, position)
    if is_refused:
        with pytest.raises(DeviceError, match=rf"stands at tick {position - homing}, beyond one turn"):
            servo.clear_eeprom(45)
        assert bus.writes == [(TORQUE, 0)]
    else:
        servo.clear_eeprom(45)
        assert bus.get(HOMING, 4) == 0


@pytest.mark.parametrize(
    ("homing", "position", "is_refused"),
    [
        (1024, 5100, False),
        (1024, 5121, True),
        (1025, 4000, False),
        (1025, 4100, True),
        (-1024, -1000, False),
        (-1025, -1000, True),
    ],
)
def test_in_position_mode_an_offset_beyond_a_quarter_turn_is_none(
    servo: Servo, bus: RegisterBus, homing: int, position: int, is_refused: bool
) -> None:
    """A reversed servo, which is set right: 1024 ticks count, 1025 do not."""
    bus.registers[DRIVE_MODE] = 1
    bus.put(HOMING, 4, homing)
    bus.put(POSITION, 4, position)
    if is_refused:
        with pytest.raises(DeviceError, match="beyond one turn"):
            servo.clear_eeprom(45)
    else:
        servo.clear_eeprom(45)
        assert bus.registers[DRIVE_MODE] == 0


@pytest.mark.parametrize(("position", "cleared"), [(2000, 0), (0, 0), (4095, 0), (-2048, 1), (4096, 1)])
def test_the_turns_of_a_reversed_servo_are_counted_anew(
    servo: Servo, bus: RegisterBus, monkeypatch: pytest.MonkeyPatch, position: int, cleared: int
) -> None:
    """It counts from the other side when Drive Mode is 0 again."""
    bus.registers[DRIVE_MODE] = 1
    write = bus.write

    def turned_over(servo_id: int, address: int, data: bytes) -> None:
        write(servo_id, address, data)
        if address == DRIVE_MODE:
            bus.put(POSITION, 4, position)

    monkeypatch.setattr(bus, "write", turned_over)
    with collecting() as notes:
        servo.clear_eeprom(45)
        servo.clear_eeprom(45)
    assert bus.cleared == cleared
    assert [note.problem for note in notes.all()] == ["counted the other way round (Drive Mode)"]
    assert bus.writes.count((DRIVE_MODE, 0)) == 1


@pytest.mark.parametrize(
    ("bits", "names"),
    [
        (0x01, ("input voltage out of range",)),
        (0x04, ("overheated",)),
        (0x08, ("motor encoder fault",)),
        (0x10, ("electrical shock or too little power",)),
        (0x20, ("overload",)),
        (0x02, ("unknown hardware error 0x02",)),
        (0xE0, ("overload", "unknown hardware error 0xC0")),
    ],
)
def test_each_bit_of_the_hardware_error_status(
    servo: Servo, bus: RegisterBus, bits: int, names: tuple[str, ...]
) -> None:
    bus.registers[HARDWARE_ERROR] = bits
    assert servo.hardware_errors() == names


@pytest.mark.parametrize(
    ("address", "length", "value", "error", "text"),
    [
        (MAX_VOLTAGE, 2, 110, 0x01, "input voltage out of range (12.0 V; it is set to 9.5 to 11.0 V)"),
        (MIN_VOLTAGE, 2, 125, 0x01, "input voltage out of range (12.0 V; it is set to 12.5 to 16.0 V)"),
        (TEMPERATURE_LIMIT, 1, 30, 0x04, "overheated (31 °C; its limit is set to 30 °C)"),
        (TEMPERATURE_LIMIT, 1, 30, 0x01, "input voltage out of range"),
        (MAX_VOLTAGE, 2, 110, 0x04, "overheated"),
    ],
)
def test_an_error_is_compared_with_a_narrowed_limit(
    servo: Servo, bus: RegisterBus, address: int, length: int, value: int, error: int, text: str
) -> None:
    bus.put(address, length, value)
    bus.registers[HARDWARE_ERROR] = error
    assert servo.hardware_errors() == (text,)


@pytest.mark.parametrize(
    ("model", "current_a", "load_percent"), [("XM430-W350", -0.269, None), ("XL430-W250", None, -10.0)]
)
def test_the_state_in_si_units(model: str, current_a: float | None, load_percent: float | None) -> None:
    bus = RegisterBus(model)
    for address, length, value in [
        (122, 1, 1),
        (123, 1, 0x31),
        (126, 2, -100),
        (128, 4, -10),
        (POSITION, 4, -7),
    ]:
        bus.put(address, length, value)
    servo = Servo(bus, 7, model, "pan")  # type: ignore[arg-type]
    state = servo.decode_state(bytes(bus.registers[122:147]), True, 5.0)
    assert state == ServoState(
        position_tick=-7,
        velocity_deg_s=pytest.approx(-13.74),
        current_a=pytest.approx(current_a) if current_a is not None else None,
        load_percent=pytest.approx(load_percent) if load_percent is not None else None,
        voltage_v=pytest.approx(12.0),
        temperature_c=31.0,
        moving=True,
        in_position=True,
        alert=True,
        monotonic_s=5.0,
    )
    bus.registers[122:124] = b"\x00\xfe"
    still = servo.decode_state(bytes(bus.registers[122:147]), False, 6.0)
    assert (still.moving, still.in_position, still.alert) == (False, False, False)
