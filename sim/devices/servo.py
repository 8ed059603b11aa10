"""One stateful X-series servo: access rules, motion, bus watchdog, hardware errors.

Sources: manuals of XM430-W350 and XL430-W250; the section is given where a rule is applied.
"""

import math
import threading
from collections.abc import Callable

import numpy as np

from sim.devices import motion
from sim.devices.dynamixel_packet import ALERT, StatusError
from sim.devices.gear_train import GearTrain
from sim.devices.motion_profile import (
    STRONGEST_ACCELERATION_DEG_S2,
    motion_profile,
    power_share,
    profile_acceleration_deg_s2,
)
from sim.devices.register_table import RegisterTable
from sim.devices.x_series import (
    EEPROM_END,
    TICKS_PER_TURN,
    VELOCITY_UNIT_DEG_S,
    WATCHDOG_UNIT_S,
    Field,
    ServoModel,
)

DEG_PER_TICK = 360.0 / TICKS_PER_TURN
REBOOT_S = 0.25
IN_POSITION_TICKS = 12
CURRENT_MODE, VELOCITY_MODE, POSITION_MODE, EXTENDED_MODE, CURRENT_POSITION_MODE, PWM_MODE = 0, 1, 3, 4, 5, 16
POSITION_MODES = (POSITION_MODE, EXTENDED_MODE, CURRENT_POSITION_MODE)
REVERSE, TORQUE_BY_GOAL = 1, 8
VOLTAGE_ERROR, OVERHEATING_ERROR, ENCODER_ERROR, SHOCK_ERROR, OVERLOAD_ERROR = 0x01, 0x04, 0x08, 0x10, 0x20
LIMIT_OF_GOAL = {"goal_pwm": "pwm_limit", "goal_current": "current_limit", "goal_velocity": "velocity_limit"}
GOALS = (*LIMIT_OF_GOAL, "goal_position")
GAINS = (
    *("velocity_i_gain", "velocity_p_gain", "position_d_gain", "position_i_gain", "position_p_gain"),
    *("feedforward_2nd_gain", "feedforward_1st_gain"),
)
PROTOCOL_2 = 2
STARTUP_TORQUE, RAM_RESTORE = 1, 2
NO_ID = 253
"""Secondary IDs from this value on are disabled."""

RESTORED = (*GAINS, "profile_acceleration", "profile_velocity")
"""Registers that RAM Restore sets at start-up."""

MULTI_TURN_CLEAR = bytes([0x01, 0x44, 0x58, 0x4C, 0x22])


class Servo:
    """A servo on the bus. Instructions and queries of its shaft are thread-safe.

    Internal positions are ticks of the output shaft, without drive mode and homing offset; they count over whole turns.
    ``eeprom`` presets registers as an installer or another program left them. Faults are injected through ``fail``,
    ``block``, ``silent`` (a broken wire), ``false_alert``, ``gears``, ``supply_v`` and ``temperature_c``.
    """

    def __init__(
        self,
        model: ServoModel,
        servo_id: int,
        *,
        clock: Callable[[], float],
        rng: np.random.Generator,
        shaft_tick: float = 2048.0,
        gears: GearTrain | None = None,
        supply_v: float = 12.0,
        temperature_c: float = 31.0,
        eeprom: dict[str, int] | None = None,
    ) -> None:
        self.model = model
        self.silent = False
        self.false_alert = False
        self.supply_v = supply_v
        self.temperature_c = temperature_c
        self._clock = clock
        self._rng = rng
        self.gears = gears or GearTrain()
        self._blocked = False
        self._lock = threading.RLock()
        self._table = RegisterTable(model)
        self._table["id"] = servo_id
        for name, value in (eeprom or {}).items():
            self._table[name] = value
        self._motion = motion.rest(shaft_tick, clock())
        self._pushed = 1.0
        self._stopped_from_deg_s = 0.0
        self._tripped = False
        self._kept: tuple[int, bytes] | None = None
        self._deaf_until_s = -math.inf
        self._backup = {name: self._table[name] for name in RESTORED}
        self._power_up()

    # -- interface to the bus

    def register(self, name: str) -> int:
        """A register's content by its name in the control table (measured values: as last read)."""
        with self._lock:
            return self._table[name]

    def is_listening(self) -> bool:
        """Whether it receives Protocol 2.0: not while rebooting, with a broken wire, or set to Protocol 1.0."""
        return self.is_there() and self._table["protocol_type"] >= PROTOCOL_2

    def is_there(self) -> bool:
        """Whether it receives anything at all."""
        return not self.silent and self._clock() >= self._deaf_until_s

    def has_secondary_id(self, servo_id: int) -> bool:
        """Whether an id is its Secondary ID: it executes such instructions without an answer."""
        secondary = self._table["secondary_id"]
        return secondary == servo_id and secondary < NO_ID and servo_id != self._table["id"]

    def feed_watchdog(self) -> None:
        """Reset the bus watchdog: the host is alive."""
        with self._lock:
            self._last_packet_s = self._advance()

    def alert(self) -> int:
        """The alert bit of a status packet, set during a hardware error."""
        with self._lock:
            self._advance()
            return ALERT if self._table["hardware_error_status"] or self.false_alert else 0

    def shaft(self) -> tuple[float, bool]:
        """True position of the head on this shaft, degrees from tick 0; and whether it moves.

        Differs from the registers by backlash, by the swing after a stop and by encoder noise.
        """
        with self._lock:
            now = self._advance()
            position, velocity = self._motion.at(now)
            degrees = position * DEG_PER_TICK + self._pushed * self.gears.backlash_deg / 2
            return degrees + self.gears.swing_deg(
                now - self._motion.end_s, self._stopped_from_deg_s
            ), velocity != 0.0 or now < self._motion.end_s

    # -- instructions

    def read(self, address: int, length: int) -> tuple[int, bytes]:
        """Answer a read: (error number, data)."""
        with self._lock:
            self._advance()
            self._measure()
            return self._table.read(address, length)

    def turn_by_hand(self, by_deg: float) -> None:
        """Turn the free shaft by hand; the turn count continues. ``ValueError`` if the torque is on."""
        with self._lock:
            now = self._advance()
            if self._table["torque_enable"]:
                raise ValueError("the torque is on: nobody turns the shaft by hand")
            self._motion = motion.rest(self._motion.at(now)[0] + by_deg / DEG_PER_TICK, now)

    def write(self, address: int, data: bytes, *, ram_only: bool = False) -> int:
        """Apply a write, all or nothing; returns the error number. ``ram_only`` for its Secondary ID."""
        with self._lock:
            self._advance()
            if ram_only and address < EEPROM_END:
                return StatusError.ACCESS
            error, changes = self._table.fields_of(address, data)
            for field, value in changes:
                error = error or self._refusal(field, value)
            if not error:
                for field, value in changes:
                    self._apply(field, value)
            return error

    def keep(self, address: int, data: bytes) -> int:
        """Store a write until ``act`` (Reg Write)."""
        with self._lock:
            self._kept = (address, data)
            self._table["registered_instruction"] = 1
            return StatusError.NONE

    def act(self) -> int:
        """Execute the stored write (Action)."""
        with self._lock:
            if self._kept is None:
                return StatusError.RESULT_FAIL
            address, data = self._kept
            self._kept = None
            self._table["registered_instruction"] = 0
            return self.write(address, data)

    def clear(self, parameters: bytes) -> int:
        """Clear the multi-turn count; only when stationary."""
        with self._lock:
            if parameters != MULTI_TURN_CLEAR or self._advance() < self._motion.end_s:
                return StatusError.RESULT_FAIL
            self._to_single_turn()
            return StatusError.NONE

    def reboot(self) -> int:
        """Reboot: RAM to defaults, torque off, no communication for a moment."""
        with self._lock:
            self._advance()
            self._table.reset(from_address=EEPROM_END)
            if self._table["startup_configuration"] & RAM_RESTORE:
                for name, value in self._backup.items():
                    self._table[name] = value
            self._power_up()
            self._table["torque_enable"] = self._table["startup_configuration"] & STARTUP_TORQUE
            self._deaf_until_s = self._clock() + REBOOT_S
            return StatusError.NONE

    def lose_power(self) -> None:
        """Lose power: torque off at once; ``reboot`` follows when the power returns."""
        with self._lock:
            self._advance()
            self._release()

    def factory_reset(self, option: int, *, broadcast: bool) -> int:
        """All registers to their defaults: 0xFF all, 1 all but the id, 2 all but id and baud rate."""
        kept = {0xFF: (), 1: ("id",), 2: ("id", "baud_rate")}
        if option not in kept or (option == 0xFF and broadcast):
            return StatusError.RESULT_FAIL
        with self._lock:
            self._table.reset(keep=kept[option])
            return self.reboot()

    def fail(self, bits: int) -> None:
        """Inject a hardware error. If the register Shutdown includes it, the torque is off until a reboot."""
        with self._lock:
            self._table["hardware_error_status"] |= bits
            if self._shut_down() and self._table["torque_enable"]:
                self._release()

    def block(self, blocked: bool) -> None:
        """Block the shaft at its present position, or release it."""
        with self._lock:
            self._blocked = blocked
            if blocked:
                self._brake(self._advance())
            elif self._table["torque_enable"]:
                self._follow("goal_position")

    # -- rules of access

    def _refusal(self, field: Field, value: int) -> int:
        """Why ``value`` must not be written, as an error number; 0 if it may."""
        if field.low is None or field.high is None:
            return StatusError.ACCESS
        if field.address < EEPROM_END and self._table["torque_enable"]:
            return StatusError.ACCESS
        if field.name in GOALS and self._tripped:
            return StatusError.DATA_RANGE
        if field.name == "goal_position" and self._table["operating_mode"] == POSITION_MODE:
            within = self._table["min_position_limit"] <= value <= self._table["max_position_limit"]
            return StatusError.NONE if within else StatusError.DATA_LIMIT
        if field.name in LIMIT_OF_GOAL and abs(value) > self._table[LIMIT_OF_GOAL[field.name]]:
            return StatusError.DATA_LIMIT
        if field.name == "operating_mode" and value not in self._modes():
            return StatusError.DATA_RANGE
        return StatusError.NONE if field.low <= value <= field.high else StatusError.DATA_RANGE

    def _modes(self) -> tuple[int, ...]:
        currents = (CURRENT_MODE, CURRENT_POSITION_MODE) if self.model.measures_current else ()
        return (VELOCITY_MODE, POSITION_MODE, EXTENDED_MODE, PWM_MODE, *currents)

    def _apply(self, field: Field, value: int) -> None:
        if field.name == "torque_enable":
            self._switch_torque(bool(value))
            return
        self._table[field.name] = value
        if field.name == "operating_mode":
            self._reset_for_mode()
        elif field.name == "bus_watchdog":
            self._tripped = self._tripped and value != 0
            self._table["bus_watchdog"] = -1 if self._tripped else value
        elif field.name in GOALS:
            if self._table["drive_mode"] & TORQUE_BY_GOAL and not self._shut_down():
                self._table["torque_enable"] = 1
            self._follow(field.name)

    def _switch_torque(self, on: bool) -> None:
        if not on:
            self._release()
        elif not self._table["torque_enable"] and not self._shut_down():
            # After a shutdown only a reboot re-enables torque: the write is answered without effect.
            self._to_single_turn()
            self._last_packet_s = self._clock()
            self._table["torque_enable"] = 1

    # -- state

    def _power_up(self) -> None:
        now = self._clock()
        position, _ = self._motion.at(now)
        self._motion = motion.rest(position, now)
        self._tripped = False
        self._kept = None
        self._last_packet_s = now
        self._to_single_turn()

    def _reset_for_mode(self) -> None:
        """A mode change resets gains, profile and the multi-turn count (manual, Operating Mode)."""
        for name in GAINS:
            self._table[name] = self._table.field(name).default
        self._no_profile()
        self._to_single_turn()

    def _no_profile(self) -> None:
        self._table["profile_velocity"] = 0
        self._table["profile_acceleration"] = 0

    def _to_single_turn(self) -> None:
        """Reduce the present position to one turn, and set the goal to it, so that nothing moves."""
        position, _ = self._motion.at(self._clock())
        self._turns = 0
        self._turns = -math.floor((self._present(position) - self._homing()) / TICKS_PER_TURN)
        self._table["goal_position"] = round(self._present(position))

    def _homing(self) -> int:
        offset = self._table["homing_offset"]
        return offset if self._table["operating_mode"] != POSITION_MODE or abs(offset) <= 1024 else 0

    @property
    def _direction(self) -> int:
        return -1 if self._table["drive_mode"] & REVERSE else 1

    def _present(self, shaft_tick: float) -> float:
        return self._direction * shaft_tick + self._homing() + self._turns * TICKS_PER_TURN

    def _shaft_of(self, present: float) -> float:
        return self._direction * (present - self._homing() - self._turns * TICKS_PER_TURN)

    def _release(self) -> None:
        """Torque off: friction stops the shaft."""
        self._table["torque_enable"] = 0
        self._brake(self._clock())

    def _brake(self, time_s: float) -> None:
        position, velocity = self._motion.at(time_s)
        self._motion = motion.stop(position, velocity, STRONGEST_ACCELERATION_DEG_S2 / DEG_PER_TICK, time_s)
        self._stopped_from_deg_s = velocity * DEG_PER_TICK

    def _shut_down(self) -> bool:
        return bool(self._table["hardware_error_status"] & self._table["shutdown"])

    def _advance(self) -> float:
        """Update the state: errors from voltage and temperature, bus watchdog. Returns the present time."""
        now = self._clock()
        if (
            not self._table["min_voltage_limit"]
            <= round(self.supply_v * 10)
            <= self._table["max_voltage_limit"]
        ):
            self.fail(VOLTAGE_ERROR)
        if self.temperature_c > self._table["temperature_limit"]:
            self.fail(OVERHEATING_ERROR)
        watchdog = self._table["bus_watchdog"]
        trip_s = self._last_packet_s + watchdog * WATCHDOG_UNIT_S
        if watchdog > 0 and self._table["torque_enable"] and now > trip_s:
            self._brake(trip_s)
            self._table["bus_watchdog"] = -1
            self._no_profile()
            self._tripped = True
        return now

    # -- motion

    def _follow(self, goal_name: str) -> None:
        """Start the motion for a new goal, if the operating mode uses that goal."""
        mode = self._table["operating_mode"]
        if not self._table["torque_enable"]:
            return
        if goal_name == "goal_position" and mode in POSITION_MODES:
            self._move_to(self._shaft_of(self._table["goal_position"]))
        elif goal_name == "goal_velocity" and mode == VELOCITY_MODE:
            self._turn_at(self._table["goal_velocity"] * VELOCITY_UNIT_DEG_S)
        elif goal_name == "goal_pwm" and mode == PWM_MODE:
            self._turn_at(
                self._table["goal_pwm"] / self._table.field("goal_pwm").default * self.model.speed_deg_s
            )
        elif goal_name == "goal_current" and mode == CURRENT_MODE:
            # Without load any non-zero current reaches full speed.
            self._turn_at(float(np.sign(self._table["goal_current"])) * self.model.speed_deg_s)

    def _turn_at(self, speed_deg_s: float) -> None:
        now = self._clock()
        position, velocity = self._motion.at(now)
        speed = self._direction * float(np.clip(speed_deg_s, -self.model.speed_deg_s, self.model.speed_deg_s))
        acceleration = profile_acceleration_deg_s2(self._table) / DEG_PER_TICK
        self._stopped_from_deg_s = velocity * DEG_PER_TICK
        self._motion = motion.turn(position, velocity, speed / DEG_PER_TICK, acceleration, now)

    def _move_to(self, goal: float) -> None:
        if self._blocked or not power_share(self._table):
            return
        now = self._clock()
        position, velocity = self._motion.at(now)
        way_deg = abs(goal - position) * DEG_PER_TICK
        speed_deg_s, acceleration_deg_s2 = motion_profile(self._table, self.model, way_deg)
        rest_at = goal
        if abs(goal - position) > 0.5:
            rest_at += self._rng.normal() * self.gears.settle_sigma_deg / DEG_PER_TICK
            self._pushed = math.copysign(1.0, goal - position)
            self._stopped_from_deg_s = self._pushed * min(
                speed_deg_s, math.sqrt(way_deg * acceleration_deg_s2)
            )
        planned = motion.move(
            position, velocity, rest_at, speed_deg_s / DEG_PER_TICK, acceleration_deg_s2 / DEG_PER_TICK, now
        )
        shape = planned.shape
        if not self._table["profile_acceleration"]:
            shape = motion.RECTANGLE if self._table["profile_velocity"] else motion.STEP
        self._motion = motion.Motion(planned.phases, goal, shape)

    def _measure(self) -> None:
        """Update the registers of measured values."""
        now = self._clock()
        position, velocity = self._motion.at(now)
        torque = self._table["torque_enable"]
        speed_deg_s = self._direction * velocity * DEG_PER_TICK
        share_of_speed = speed_deg_s / self.model.speed_deg_s
        ongoing = bool(torque) and now < self._motion.end_s
        reading = round(self._present(position) + self._rng.normal() * self.gears.encoder_sigma_ticks)
        raw_velocity = round(speed_deg_s / VELOCITY_UNIT_DEG_S)
        effort = np.sign(velocity) * self._direction + share_of_speed
        drawn = round(effort * self.model.friction_current + self._rng.normal() * 1.5)
        in_position = abs(reading - self._table["goal_position"]) <= IN_POSITION_TICKS
        above_threshold = abs(speed_deg_s) > self._table["moving_threshold"] * VELOCITY_UNIT_DEG_S
        for name, value in {
            "realtime_tick": int(now * 1000) % 32768,
            "moving": above_threshold or ongoing,
            "moving_status": (in_position and torque)
            | ongoing << 1
            | (self._motion.shape << 4 if ongoing else 0),
            "present_pwm": round(885 * share_of_speed) * torque,
            "present_current": drawn * torque,
            "present_velocity": raw_velocity,
            "present_position": reading,
            "velocity_trajectory": raw_velocity * torque,
            "position_trajectory": round(self._present(position)),
            "present_input_voltage": round(self.supply_v * 10 - abs(effort) * torque),
            "present_temperature": round(self.temperature_c),
        }.items():
            self._table[name] = int(value)
