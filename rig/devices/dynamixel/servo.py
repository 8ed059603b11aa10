"""One Dynamixel servo in position mode: set-up, goal, state and errors."""

import logging
from collections.abc import Iterable
from dataclasses import dataclass

from rig.devices.dynamixel import control_table as table
from rig.devices.dynamixel.servo_bus import ServoBus
from rig.errors import DeviceError, TransientError
from rig.fault_notes import note_fault

_log = logging.getLogger(__name__)

STATE_ADDRESS = 122  # Moving ... Present Temperature, one contiguous block
STATE_LENGTH = 25
_IN_POSITION = 0x01
_EEPROM = 9, 55  # Return Delay Time ... Shutdown: address and length of one read
_RAM = 64, 40  # Torque Enable ... Goal Current
_JUMP_TICKS = 64  # 5.6 deg: more than sag, or motion when the torque comes on


@dataclass(frozen=True)
class ServoState:
    """What one servo says about itself (e-manual, "Control Table", registers 122 to 146).

    Attributes
    ----------
    position_tick : int
        4096 to one turn.
    velocity_deg_s : float
        Of the shaft.
    current_a : float or None
        Measured by an XM430; an XL430 does not.
    load_percent : float or None
        Inferred by an XL430.
    voltage_v : float
        Of the supply.
    temperature_c : float
        Inside the servo.
    moving, in_position, alert : bool
        As the servo sees it; an alert has its cause in the hardware error status.
    monotonic_s : float
        When, on ``time.monotonic``'s clock.
    """

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
    """A Dynamixel X servo on a bus, its registers by the vendor's names.

    Parameters
    ----------
    bus : ServoBus
        That it hangs on.
    servo_id : int
        Its id, 0 to 252.
    model : {"XM430-W350", "XL430-W250"}
        Whose control table it has (e-manual, "Control Table").
    name : str
        How errors call it: ``"pan"``.

    Raises
    ------
    TransientError
        Of each method: the servo does not answer.
    DeviceError
        Of each method: the servo refuses the instruction, or the port is lost.

    Examples
    --------
    >>> import rig
    >>> with rig.ServoBus(rig.SerialPort(servo_port, 1_000_000)) as bus:  # servo_port = "/dev/ttyUSB0"
    ...     servo = rig.Servo(bus, 1, "XM430-W350", "pan")
    ...     servo.write("LED", 1)
    ...     print(f"{servo.read('Present Input Voltage') / 10:.1f} V, {servo.read('Present Temperature')} °C")
    12.0 V, 31 °C
    """

    def __init__(self, bus: ServoBus, servo_id: int, model: str, name: str) -> None:
        self._bus = bus
        self._registers = table.control_table(model)
        self.servo_id = servo_id
        self.model = model
        self.name = f"{name} servo (id {servo_id}) on {bus.path}"
        self._counts_wrongly = False

    def read(self, register: str) -> int:
        """Read a register.

        Parameters
        ----------
        register : str
            The vendor's name (e-manual, "Control Table"): ``"Present Position"``.

        Returns
        -------
        int
            In the register's own unit.

        Raises
        ------
        TransientError
            The servo does not answer.
        DeviceError
            The servo refuses, or the port is lost.
        """
        where = self._registers[register]
        return where.decode(self._bus.read(self.servo_id, where.address, where.length))

    def write(self, register: str, value: int) -> None:
        """Write a register.

        Parameters
        ----------
        register : str
            The vendor's name (e-manual, "Control Table"): ``"Present Position"``.
        value : int
            In the register's own unit.

        Raises
        ------
        TransientError
            The servo does not answer.
        DeviceError
            The servo refuses, or the port is lost.
        """
        where = self._registers[register]
        self._bus.write(self.servo_id, where.address, where.encode(value))

    def set_status_return_all(self) -> None:
        """Set Status Return Level 2, answer everything: another program may have left it at pings only.

        Raises ``TransientError`` if it still does not answer a read.
        """
        try:
            if self.read("Status Return Level") == table.STATUS_RETURN_ALL:
                return
        except TransientError as error:  # at level 0 it answers no reads; a lost answer is retried
            _log.debug("%s", error)
        where = self._registers["Status Return Level"]
        level = where.encode(table.STATUS_RETURN_ALL)
        self._bus.write_unanswered(self.servo_id, where.address, level)
        if self.read("Status Return Level") != table.STATUS_RETURN_ALL:
            raise TransientError(
                self.name,
                "answers a ping and keeps its Status Return Level",
                "set register 68 to 2 with Dynamixel Wizard",
            )
        _log.info("%s: was set to answer not everything (Status Return Level); set to 2", self.name)

    def ensure_reads_answered(self) -> None:
        """``set_status_return_all`` for a servo that does not answer reads; nothing is written to others."""
        try:
            self.read("Status Return Level")
        except TransientError as error:
            _log.debug("%s", error)
            self.set_status_return_all()

    def disable_secondary_id(self) -> None:
        """Torque off and Secondary ID disabled: with one the servo also executes another servo's instructions,
        unanswered.

        Call it for all servos of a bus before any other instruction.
        """
        self.torque(False)
        if self.read("Secondary(Shadow) ID") < table.MIN_DISABLED_SECONDARY_ID:
            self.write("Secondary(Shadow) ID", table.NO_SECONDARY_ID)
            _log.info("%s: had a Secondary ID; switched off", self.name)

    def clear_eeprom(self, firmware: int) -> None:
        """Reset EEPROM registers that another program may have changed and that alter the meaning of commands; torque
        off.

        Drive Mode and Operating Mode, and the position limits, are ``configure``'s. Raises what ``require_one_turn`` raises
        where the servo counts the other way round and was turned by hand.

        Parameters
        ----------
        firmware : int
            Its version, from `ServoBus.ping`.

        Raises
        ------
        TransientError
            The servo does not answer.
        DeviceError
            The servo refuses, or the port is lost.
        """
        self.torque(False)
        block = self._bus.read(self.servo_id, *_EEPROM)

        def value(register: str) -> int:
            return self._registers[register].decode(block, _EEPROM[0])

        wanted = {
            **table.FACTORY_EEPROM[self.model],
            "Protocol Type": table.PROTOCOL_2,
            "Homing Offset": 0,
            "Shutdown": value("Shutdown") | table.FACTORY_SHUTDOWN,
        }
        for name, (low, high) in table.FACTORY_PROTECTION[self.model].items():
            if not low <= value(name) <= high:
                wanted[name] = low if name.startswith("Min") else high
        is_reversed = bool(value("Drive Mode") & table.REVERSE_MODE)
        if (value("Operating Mode") != table.POSITION_MODE or is_reversed) and not self._counts_wrongly:
            # Changing these resets the turn count, and with it the information that the head was turned too
            # far.
            position = self.read("Present Position")
            self.require_one_turn(
                position - self._effective_homing_offset(value("Homing Offset"), value("Operating Mode"))
            )
        self._counts_wrongly |= is_reversed
        if self._counts_wrongly:
            self._set_normal_direction()
        if value("Homing Offset"):
            self._log_zero_shift(
                f"had a Homing Offset of {value('Homing Offset')} ticks, left by another program",
                "set to 0; look at zero_tick, which counts without it",
            )
        self._write_where_different((name, wanted[name], value(name)) for name in wanted)
        startup = table.STARTUP_CONFIGURATION
        if firmware >= table.STARTUP_CONFIGURATION_FIRMWARE and startup.decode(block, _EEPROM[0]):
            self._bus.write(self.servo_id, startup.address, startup.encode(0))
            _log.info("%s: was set to start with torque or another program's RAM; set to 0", self.name)

    def _set_normal_direction(self) -> None:
        """Set Drive Mode 0 and reset the turn count, which was reversed. Safe to repeat after an interruption."""
        self.write("Drive Mode", 0)
        if not 0 <= self.read("Present Position") < table.TICKS_PER_TURN:
            self._bus.clear_multi_turn(self.servo_id)
        self._counts_wrongly = False
        self._log_zero_shift(
            "counted the other way round (Drive Mode)", "set right; look at zero_tick and direction"
        )

    @staticmethod
    def _effective_homing_offset(homing_offset: int, operating_mode: int) -> int:
        """The effective Homing Offset: in position mode none if it exceeds a quarter turn."""
        quarter = table.TICKS_PER_TURN // 4
        return 0 if operating_mode == table.POSITION_MODE and abs(homing_offset) > quarter else homing_offset

    def _log_zero_shift(self, problem: str, action: str) -> None:
        """Log a change of the meaning of zero_tick: it is found only once."""
        note_fault(self.name, problem, action)
        _log.warning("%s: %s; %s", self.name, problem, action)

    def clear_ram(self) -> None:
        """Set factory gains and limits: with others, such as 0, the servo does not reach its goal."""
        block = self._bus.read(self.servo_id, *_RAM)
        self._write_where_different(
            (name, wanted, self._registers[name].decode(block, _RAM[0]))
            for name, wanted in table.FACTORY_RAM[self.model].items()
        )

    def _write_where_different(self, registers: Iterable[tuple[str, int, int]]) -> None:
        for name, wanted, found in registers:
            if found != wanted:
                self.write(name, wanted)
                _log.info("%s: %s was %d, set to %d", self.name, name, found, wanted)

    def configure(
        self, min_tick: int, max_tick: int, velocity_deg_s: float, acceleration_deg_s2: float
    ) -> None:
        """Set position mode, the servo's own position limits, and a speed; torque off, status return on.

        The EEPROM is written only where it differs: it wears out, and it can be written only without torque.

        Parameters
        ----------
        min_tick, max_tick : int
            Limits, 0 to 4095.
        velocity_deg_s, acceleration_deg_s2 : float
            Of a move.

        Raises
        ------
        TransientError
            The servo does not answer.
        DeviceError
            The servo refuses, or the port is lost.
        """
        self.set_status_return_all()
        self.torque(False)
        self.disarm_bus_watchdog()
        for register, value in {
            "Homing Offset": 0,
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
        """Set how fast the servo goes to its goal.

        Needed anew after a change of mode, a restart and a tripped watchdog: each of them resets the profile to 0, which means
        as fast as it can.

        Parameters
        ----------
        velocity_deg_s, acceleration_deg_s2 : float
            Of a move.

        Raises
        ------
        TransientError
            The servo does not answer.
        DeviceError
            The servo refuses, or the port is lost.
        """
        self.write("Profile Acceleration", _units(acceleration_deg_s2, table.ACCELERATION_UNIT_DEG_S2))
        self.write("Profile Velocity", _units(velocity_deg_s, table.VELOCITY_UNIT_DEG_S))

    def torque(self, on: bool) -> None:
        """Hold the position, or let go.

        Parameters
        ----------
        on : bool
            Which of the two.

        Raises
        ------
        TransientError
            The servo does not answer.
        DeviceError
            The servo refuses, or the port is lost.
        """
        self.write("Torque Enable", int(on))

    def hold(self, min_tick: int, max_tick: int) -> None:
        """Torque on with the goal at the present position, or at the limit that it is beyond.

        Torque folds a position beyond one turn back into it, which would send the head the long way.

        Parameters
        ----------
        min_tick, max_tick : int
            Limits, 0 to 4095.

        Raises
        ------
        DeviceError
            The servo stands beyond one turn, or jumps when the torque comes on. The torque is off then.
        """
        before = self.read("Present Position")
        self.require_one_turn(before)
        goal = min(max(before, min_tick), max_tick)
        self.write("Goal Position", goal)
        self.torque(True)
        after = self.read("Present Position")
        if not min(before, goal) - _JUMP_TICKS <= after <= max(before, goal) + _JUMP_TICKS:
            self.torque(False)
            raise DeviceError(
                self.name,
                f"its position went from tick {before} to {after} when the torque came on",
                "turn the head to the middle of its range by hand, then power-cycle the servos",
            )

    def require_one_turn(self, position_tick: int) -> None:
        """Refuse a position beyond one turn.

        Parameters
        ----------
        position_tick : int
            As the servo counts it.

        Raises
        ------
        DeviceError
            By hand without torque, or by another program, the servo was turned too far.
        """
        if not 0 <= position_tick < table.TICKS_PER_TURN:
            way = "forward" if position_tick > 0 else "backward"
            raise DeviceError(
                self.name,
                f"stands at tick {position_tick}, beyond one turn (0 to {table.TICKS_PER_TURN - 1}): it was turned too far "
                f"{way} while the torque was off, or by another program",
                "turn it back by hand; the servo would go the long way round and pull the cable",
            )

    def arm_bus_watchdog(self, timeout_s: float) -> None:
        """Have the servo stop by itself when it hears no packet for some time.

        Parameters
        ----------
        timeout_s : float
            0.02 to 2.54 s.

        Raises
        ------
        TransientError
            The servo does not answer.
        DeviceError
            The servo refuses, or the port is lost.
        """
        self.write("Bus Watchdog", _units(timeout_s, table.BUS_WATCHDOG_UNIT_S))

    def disarm_bus_watchdog(self) -> None:
        """Disable the bus watchdog. Also clears a tripped one, which has reset the profile: see ``set_profile``."""
        self.write("Bus Watchdog", 0)

    def bus_watchdog_tripped(self) -> bool:
        """Whether the watchdog has stopped the servo, which then rejects goals until it is disabled."""
        return self.read("Bus Watchdog") == table.BUS_WATCHDOG_TRIPPED

    def hardware_errors(self) -> tuple[str, ...]:
        """Hardware errors by name; empty if there are none."""
        status = self.read("Hardware Error Status")
        known = tuple(
            text + self._against_limits(bit) for bit, text in table.HARDWARE_ERRORS.items() if status & bit
        )
        unknown = status & ~sum(table.HARDWARE_ERRORS)
        return (*known, f"unknown hardware error 0x{unknown:02X}") if unknown else known

    def _against_limits(self, error_bit: int) -> str:
        """For an error with a limit narrower than the factory's: value and limit in words."""
        factory = table.FACTORY_PROTECTION[self.model]

        def narrowed(name: str) -> bool:
            low, high = factory[name]
            return self.read(name) not in (0, low if name.startswith("Min") else high)

        if error_bit == table.VOLTAGE_ERROR and (
            narrowed("Min Voltage Limit") or narrowed("Max Voltage Limit")
        ):
            volts, low, high = (
                self.read(name) * table.VOLTAGE_UNIT_V
                for name in ("Present Input Voltage", "Min Voltage Limit", "Max Voltage Limit")
            )
            return f" ({volts:.1f} V; it is set to {low:.1f} to {high:.1f} V)"
        if error_bit == table.OVERHEATING_ERROR and narrowed("Temperature Limit"):
            return f" ({self.read('Present Temperature')} °C; its limit is set to {self.read('Temperature Limit')} °C)"
        return ""

    def decode_state(self, block: bytes, alert: bool, monotonic_s: float) -> ServoState:
        """Decode the state of the servo.

        Parameters
        ----------
        block : bytes
            The 25 bytes from register 122 on.
        alert : bool
            The alert bit of the status packet.
        monotonic_s : float
            When they were read.

        Returns
        -------
        ServoState
            What they say.
        """

        def value(register: str) -> int:
            return self._registers[register].decode(block, STATE_ADDRESS)

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


def _units(value: float, unit: float) -> int:
    """``value`` in register units, at least 1: in all these registers 0 means without limit."""
    return max(1, round(value / unit))
