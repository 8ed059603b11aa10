"""One Dynamixel servo in position mode: set-up, goal, state, and what is wrong with it."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from rig.dynamixel import control_table as table
from rig.dynamixel.servo_bus import ServoBus
from rig.errors import TransientError, WrongDeviceError

_STATE_ADDRESS = 122  # Moving ... Present Temperature, one contiguous block
_STATE_LENGTH = 25
_IN_POSITION = 0x01


@dataclass(frozen=True)
class ServoState:
    """What one servo says about itself. ``current_a`` is measured (XM), ``load_percent`` inferred (XL)."""

    position_tick: int
    velocity_deg_s: float
    current_a: float | None
    load_percent: float | None
    voltage_v: float
    temperature_c: float
    moving: bool
    in_position: bool
    alert: bool
    monotonic_s: float


class Servo:
    """A servo on a bus; ``name`` is how errors call it. Its methods raise what ``ServoBus`` raises."""

    def __init__(self, bus: ServoBus, servo_id: int, model: str, name: str) -> None:
        self._bus = bus
        self._registers = table.control_table(model)
        self.servo_id = servo_id
        self.model = model
        self.name = f"{name} servo (id {servo_id}) on {bus.path}"

    def read(self, register: str) -> int:
        """A register by the vendor's name, in its own unit."""
        where = self._registers[register]
        return where.decode(self._bus.read(self.servo_id, where.address, where.length))

    def write(self, register: str, value: int) -> None:
        """Write a register by the vendor's name, in its own unit."""
        where = self._registers[register]
        self._bus.write(self.servo_id, where.address, where.encode(value))

    def configure(
        self, min_tick: int, max_tick: int, velocity_deg_s: float, acceleration_deg_s2: float
    ) -> None:
        """Position mode within limits that the servo itself keeps, and a speed; leaves the torque off.

        The EEPROM is written only where it differs: it wears out, and it can be written only without torque.
        """
        self.torque(False)
        self.disarm_bus_watchdog()
        for register, value in {
            "Drive Mode": 0,  # not reversed, profile by velocity
            "Operating Mode": table.POSITION_MODE,
            "Return Delay Time": 0,
            "Min Position Limit": min_tick,
            "Max Position Limit": max_tick,
        }.items():
            if self.read(register) != value:
                self.write(register, value)
        self.set_profile(velocity_deg_s, acceleration_deg_s2)

    def set_profile(self, velocity_deg_s: float, acceleration_deg_s2: float) -> None:
        """How fast the servo goes to its goal. Needed anew after a change of mode, a restart and a tripped
        watchdog: each of them resets the profile to 0, which means as fast as it can.
        """
        self.write("Profile Acceleration", _units(acceleration_deg_s2, table.ACCELERATION_UNIT_DEG_S2))
        self.write("Profile Velocity", _units(velocity_deg_s, table.VELOCITY_UNIT_DEG_S))

    def torque(self, on: bool) -> None:
        """Hold the position, or let go."""
        self.write("Torque Enable", int(on))

    def hold(self, min_tick: int, max_tick: int) -> None:
        """Torque on, with the goal where the servo stands, or at the limit that it stands beyond."""
        self.write("Goal Position", min(max(self.read("Present Position"), min_tick), max_tick))
        self.torque(True)

    def arm_bus_watchdog(self, timeout_s: float) -> None:
        """Have the servo stop by itself when it hears no packet for ``timeout_s``."""
        self.write("Bus Watchdog", _units(timeout_s, table.BUS_WATCHDOG_UNIT_S))

    def disarm_bus_watchdog(self) -> None:
        """End the watch. Clears a tripped watchdog too, which has reset the profile: see ``set_profile``."""
        self.write("Bus Watchdog", 0)

    def bus_watchdog_tripped(self) -> bool:
        """Whether the watchdog has stopped the servo. It then refuses goals until it is disarmed."""
        return self.read("Bus Watchdog") == table.BUS_WATCHDOG_TRIPPED

    def hardware_errors(self) -> tuple[str, ...]:
        """What the servo's hardware error status says, empty where all is well."""
        status = self.read("Hardware Error Status")
        known = tuple(text for bit, text in table.HARDWARE_ERRORS.items() if status & bit)
        unknown = status & ~sum(table.HARDWARE_ERRORS)
        return (*known, f"unknown hardware error 0x{unknown:02X}") if unknown else known

    def decode_state(self, block: bytes, alert: bool, monotonic_s: float) -> ServoState:
        """The state in the 25 bytes from register 122 on."""

        def value(register: str) -> int:
            return self._registers[register].decode(block, _STATE_ADDRESS)

        # One address, two meanings: a measured current in the XM, an inferred load in the XL.
        measures_current = "Present Current" in self._registers
        return ServoState(
            position_tick=value("Present Position"),
            velocity_deg_s=value("Present Velocity") * table.VELOCITY_UNIT_DEG_S,
            current_a=value("Present Current") * table.CURRENT_UNIT_A if measures_current else None,
            load_percent=None if measures_current else value("Present Load") * table.LOAD_UNIT_PERCENT,
            voltage_v=value("Present Input Voltage") * table.VOLTAGE_UNIT_V,
            temperature_c=float(value("Present Temperature")),
            moving=bool(value("Moving")),
            in_position=bool(value("Moving Status") & _IN_POSITION),
            alert=alert,
            monotonic_s=monotonic_s,
        )


def read_states(bus: ServoBus, servos: Sequence[Servo]) -> list[ServoState]:
    """The state of all servos, in their order, with one instruction.

    Raises ``TransientError`` naming every servo that did not answer.
    """
    statuses = bus.sync_read([servo.servo_id for servo in servos], _STATE_ADDRESS, _STATE_LENGTH)
    now_s = time.monotonic()
    silent = [servo.name for servo in servos if servo.servo_id not in statuses]
    if silent:
        raise TransientError(" and ".join(silent), "no valid answer", "check power and the servo cable")
    return [
        servo.decode_state(statuses[servo.servo_id].parameters, statuses[servo.servo_id].alert, now_s)
        for servo in servos
    ]


def require_models(bus: ServoBus, expected: Mapping[int, str]) -> dict[int, int]:
    """The firmware versions by servo id, where every servo is there and of the expected model.

    Raises ``WrongDeviceError`` where another model answers, ``TransientError`` where one is silent; both list
    what was expected and what was found for each id.
    """
    found: dict[int, tuple[int, int]] = {}
    for servo_id in expected:
        try:
            found[servo_id] = bus.ping(servo_id)
        except TransientError:
            continue  # it is listed as silent below
    wrong = [i for i, (number, _) in found.items() if number != table.MODEL_NUMBERS[expected[i]]]
    if wrong or len(found) < len(expected):
        problem = f"expected {_list(expected)}, found " + _list(
            {i: _model_name(found[i][0]) if i in found else "no answer" for i in expected}
        )
        device = f"servo bus {bus.path} at {bus.baud} baud"
        if wrong:
            raise WrongDeviceError(device, problem, "correct `id` and `model`")
        raise TransientError(device, problem, "check servo power, cable, `id` and `baud`")
    return {servo_id: firmware for servo_id, (_, firmware) in found.items()}


def _list(by_id: Mapping[int, str]) -> str:
    return ", ".join(f"id {servo_id}: {what}" for servo_id, what in by_id.items())


def _model_name(number: int) -> str:
    names = {number: name for name, number in table.MODEL_NUMBERS.items()}
    return names.get(number, f"model number {number}")


def _units(value: float, unit: float) -> int:
    """``value`` in register units, at least 1: in all these registers 0 means without limit."""
    return max(1, round(value / unit))
