"""The pan-tilt head: moves and states in degrees; the torque is off after use in every case.

Pan is clockwise-positive seen from above, tilt up-positive; 0, 0 is where both servos stand at their
``zero_tick``.
"""

import logging
import math
from dataclasses import dataclass
from functools import partial
from types import TracebackType
from typing import Self

from rig import event_bus, timebase
from rig.config.keep_out import lies_in_a_zone, route
from rig.devices.bus.deadline import Deadline
from rig.devices.bus.retry import retry
from rig.devices.bus.serial_port import SerialPort
from rig.devices.dynamixel import control_table as table
from rig.devices.dynamixel.protocol2 import StatusError
from rig.devices.dynamixel.servo import Servo, ServoState
from rig.devices.dynamixel.servo_bus import RefusedError, ServoBus
from rig.devices.dynamixel.servo_group import read_states, require_models
from rig.devices.pan_tilt_axis import TICK_DEG, Axis
from rig.devices.pan_tilt_parameters import PanTiltParameters
from rig.errors import DeviceError, GoalError, RigError, TransientError
from rig.fault_notes import note_fault

_log = logging.getLogger(__name__)

_HEAD = "pan and tilt head"
_POLL_S = 0.02
_STILL_S = 0.2
_STILL_TICKS = 1  # encoder noise
_RELAX_REPLUG_S = 0.5  # short wait for a lost port at shutdown
# A proportional controller droops under the camera's weight; a larger error means an obstacle.
_GOAL_TOLERANCE_DEG = 1.0
_COMMAND_LATENCY_S = 0.3  # from reading a moving head's position to its new goal, on a busy computer
_PATH_TOLERANCE_DEG = 4.0  # beyond either end of a move: overshoot, and motion when the torque comes on


class StoppedError(TransientError):
    """The head stopped during a move without an obstacle: bus watchdog, or lost torque."""


@dataclass(frozen=True)
class HeadState:
    """Where the head is and how its servos are.

    Attributes
    ----------
    pan_deg, tilt_deg : float
        The joints' angles.
    moving : bool
        Whether a servo moves.
    ticks : tuple of int
        Positions of (pan, tilt), 4096 to one turn.
    volts : tuple of float
        Supply voltages of (pan, tilt), V.
    temps : tuple of float
        Temperatures of (pan, tilt), °C.
    alerts : tuple of str
        Sentences that name a servo and its hardware error; empty where all is well.
    monotonic_s : float
        When, on ``time.monotonic``'s clock.
    """

    pan_deg: float
    tilt_deg: float
    moving: bool
    ticks: tuple[int, int]
    volts: tuple[float, float]
    temps: tuple[float, float]
    alerts: tuple[str, ...]
    monotonic_s: float


class PanTilt:
    """The pan-tilt head of two Dynamixel X servos, connected and without torque; leaving a ``with`` block switches it off.

    Connecting checks that both servos are there and of the configured model, undoes what other programs have left in them,
    and gives them mode, limits and speed.

    The servos' own bus watchdog is armed by ``move_to`` and disarmed once ``wait_settled`` has seen the head
    stand: a program that dies lets the head stop, and one that measures for some seconds need not talk to it.

    Parameters
    ----------
    parameters : PanTiltSection
        ``[pan_tilt]`` of a configuration: port, ids, models, limits, speeds.

    Raises
    ------
    DeviceError
        Port or servos are absent, others, or broken.

    Examples
    --------
    >>> import rig
    >>> servo = {"model": "XM430-W350", "zero_tick": 2048, "direction": 1}
    >>> section = rig.PanTiltSection.model_validate(
    ...     {
    ...         "port": servo_port,  # "/dev/ttyUSB0"
    ...         "pan": {"id": 1, "min_deg": -170.0, "max_deg": 170.0, **servo},
    ...         "tilt": {"id": 2, "min_deg": -40.0, "max_deg": 60.0, **servo},
    ...     }
    ... )
    >>> with rig.PanTilt(section) as head:
    ...     state = head.go_to(pan_deg=10.0, tilt_deg=5.0)
    >>> print(f"pan {state.pan_deg:.0f}, tilt {state.tilt_deg:.0f} deg at {state.volts[0]:.1f} V")
    pan 10, tilt 5 deg at 12.0 V
    """

    def __init__(self, parameters: PanTiltParameters) -> None:
        self._parameters = parameters
        self._bus = ServoBus(SerialPort(parameters.port, parameters.baud))
        try:
            self._axes = (
                Axis("pan", self._bus, parameters.pan),
                Axis("tilt", self._bus, parameters.tilt),
            )
            self._servos = [axis.servo for axis in self._axes]
            self._firmware = self._check_servos()
        except BaseException:
            self._bus.close()
            raise
        self._goal_deg: tuple[float, float] | None = None
        self._from_deg = math.nan, math.nan
        self._braking_distance_deg = 0.0
        self._path_error: DeviceError | None = None
        self._holding: set[int] = set()
        try:
            # First of all: a servo with a Secondary ID executes the other's instructions.
            for servo in self._servos:
                retry(servo.set_status_return_all)
            for servo in self._servos:
                retry(servo.disable_secondary_id)
            for axis in self._axes:
                self._configure(axis)
        except BaseException as error:
            self._close_after(error)
            raise

    def _check_servos(self) -> dict[int, int]:
        expected = {servo.servo_id: servo.model for servo in self._servos}
        firmware = retry(partial(require_models, self._bus, expected))
        for servo in self._servos:
            if self._parameters.bus_watchdog_ms and firmware[servo.servo_id] < table.BUS_WATCHDOG_FIRMWARE:
                raise DeviceError(
                    servo.name,
                    f"firmware {firmware[servo.servo_id]} has no bus watchdog",
                    "update it with Dynamixel Wizard, or set bus_watchdog_ms = 0",
                )
        return firmware

    def _configure(self, axis: Axis) -> None:
        speed = self._parameters.velocity_deg_s, self._parameters.acceleration_deg_s2
        retry(partial(axis.servo.clear_eeprom, self._firmware[axis.servo.servo_id]))
        retry(partial(axis.servo.configure, axis.min_tick, axis.max_tick, *speed))
        retry(axis.servo.clear_ram)  # last, as a mode change resets the gains

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None:
            self.close()
        else:
            self._close_after(error)

    def identify(self) -> str:
        """Models, firmware versions and ids."""
        return ", ".join(
            f"{axis.name} {axis.servo.model} firmware {self._firmware[axis.servo.servo_id]} "
            f"(id {axis.servo.servo_id})"
            for axis in self._axes
        )

    def go_to(self, pan_deg: float, tilt_deg: float) -> HeadState:
        """Move to both angles, around the keep-out zones, and wait until the head has settled.

        A head that lost its torque or was stopped by its bus watchdog on the way is set up anew and sent on.

        Parameters
        ----------
        pan_deg : float
            Clockwise-positive seen from above, from where the pan servo stands at its ``zero_tick``.
        tilt_deg : float
            Up-positive.

        Returns
        -------
        HeadState
            Where it stands.

        Raises
        ------
        GoalError
            An angle is outside its limits, or in a keep-out zone. Nothing has moved.
        DeviceError
            A servo reports a hardware error, stopped on the way, or cannot be commanded.
        """
        self._goal_ticks(pan_deg, tilt_deg)
        state = self.state()
        self.require_one_turn(state)
        low, high = self._limits_deg()
        here = state.pan_deg, state.tilt_deg
        stops = route(here, (pan_deg, tilt_deg), self._parameters.keep_out, low, high)
        for stop in self._with_take_up(here, stops):
            state = retry(
                partial(self._move_segment, *stop), tries=3, within_s=3 * self._parameters.settle_timeout_s
            )
        return state

    def _with_take_up(
        self, here: tuple[float, float], stops: list[tuple[float, float]]
    ) -> list[tuple[float, float]]:
        """The waypoints, with one slightly below the last if the pan approaches it from above.

        All readings are then taken with the backlash on the same side, and a common error does no harm.
        """
        pan_deg, tilt_deg = stops[-1]
        from_deg = stops[-2][0] if len(stops) > 1 else here[0]
        below = pan_deg - self._parameters.take_up_deg, tilt_deg
        low, high = self._limits_deg()
        straight = (
            from_deg - TICK_DEG > pan_deg > below[0] > low[0]
            and len(route(below, stops[-1], self._parameters.keep_out, low, high)) == 1
        )
        return [*stops[:-1], below, stops[-1]] if straight else stops

    def _move_segment(self, pan_deg: float, tilt_deg: float) -> HeadState:
        self.move_to(pan_deg, tilt_deg)
        return self.wait_settled()

    def _limits_deg(self) -> tuple[tuple[float, float], tuple[float, float]]:
        pan, tilt = self._parameters.pan, self._parameters.tilt
        return (pan.min_deg, tilt.min_deg), (pan.max_deg, tilt.max_deg)

    def _goal_ticks(self, pan_deg: float, tilt_deg: float) -> list[int]:
        return [axis.goal_tick(a) for axis, a in zip(self._axes, (pan_deg, tilt_deg), strict=True)]

    def move_to(self, pan_deg: float, tilt_deg: float) -> None:
        """Start a direct move to both angles; ``wait_settled`` waits for its end.

        Parameters
        ----------
        pan_deg, tilt_deg : float
            As for `go_to`.

        Raises
        ------
        GoalError
            An angle is outside its limits, or the way leads through a keep-out zone. Nothing has moved.
        DeviceError
            A servo reports a hardware error, was turned beyond its range by hand, or cannot be commanded.
        """
        goals = self._goal_ticks(pan_deg, tilt_deg)
        if self._path_error:
            raise self._path_error
        state = self.state()
        self._require_healthy(state)
        self.require_one_turn(state)
        low, high = self._limits_deg()
        here, goal_deg = (state.pan_deg, state.tilt_deg), (pan_deg, tilt_deg)
        if len(route(here, goal_deg, self._parameters.keep_out, low, high)) > 1:
            raise GoalError(
                f"the straight way to pan {pan_deg:.1f}, tilt {tilt_deg:.1f} deg leads through a keep-out zone; "
                "go round it in several moves"
            )
        for axis in self._axes:
            self._enable_torque(axis)
        for axis, goal in zip(self._axes, goals, strict=True):
            retry(partial(self._send_goal, axis.servo, goal))
        self._from_deg = here
        speed, braking = self._parameters.velocity_deg_s, self._parameters.acceleration_deg_s2
        self._braking_distance_deg = (
            speed * _COMMAND_LATENCY_S + speed**2 / (2.0 * braking) if state.moving else 0.0
        )
        self._goal_deg = pan_deg, tilt_deg

    def require_one_turn(self, state: HeadState) -> None:
        """Refuse a head that was turned out of its range by hand: torque would send it the long way.

        Parameters
        ----------
        state : HeadState
            From `state`.

        Raises
        ------
        DeviceError
            The message names the servo.
        """
        for servo, tick in zip(self._servos, state.ticks, strict=True):
            servo.require_one_turn(tick)

    @staticmethod
    def _send_goal(servo: Servo, goal: int) -> None:
        try:
            servo.write("Goal Position", goal)
        except RefusedError as error:
            if error.number == StatusError.DATA_RANGE and servo.bus_watchdog_tripped():
                remedy = "it received no packet in time (bus watchdog): raise bus_watchdog_ms, or move again"
                raise StoppedError(servo.name, "its bus watchdog stopped it", remedy) from error
            raise

    def _enable_torque(self, axis: Axis) -> None:
        """Torque on, watchdog enabled and profile set, whatever happened since the last move."""
        servo = axis.servo
        torque = retry(partial(servo.read, "Torque Enable"))
        if not torque or servo.servo_id not in self._holding:  # never enabled, switched off, or power lost
            if servo.servo_id in self._holding:
                note_fault(servo.name, "lost its torque: a restart or a power cut", "set up anew")
            self._configure(axis)
            retry(partial(servo.hold, axis.min_tick, axis.max_tick))
            self._holding.add(servo.servo_id)
        elif retry(servo.bus_watchdog_tripped):
            # The bus watchdog tripped. A new goal means that the program is alive again, so clear it.
            note_fault(servo.name, "had been stopped by its bus watchdog", "cleared and sent on")
            retry(servo.disarm_bus_watchdog)
            speed = self._parameters.velocity_deg_s, self._parameters.acceleration_deg_s2
            retry(partial(servo.set_profile, *speed))
        if self._parameters.bus_watchdog_ms:
            retry(partial(servo.arm_bus_watchdog, self._parameters.bus_watchdog_ms / 1000))

    def state(self) -> HeadState:
        """Angles and health, from one sync read.

        Returns
        -------
        HeadState
            At this moment.

        Raises
        ------
        DeviceError
            A servo is silent; the message names it.
        """
        states = retry(partial(read_states, self._bus, self._servos))
        pan, tilt = states
        state = HeadState(
            pan_deg=self._axes[0].angle_deg(pan.position_tick),
            tilt_deg=self._axes[1].angle_deg(tilt.position_tick),
            moving=pan.moving or tilt.moving,
            ticks=(pan.position_tick, tilt.position_tick),
            volts=(pan.voltage_v, tilt.voltage_v),
            temps=(pan.temperature_c, tilt.temperature_c),
            alerts=self._alerts(states),
            monotonic_s=pan.monotonic_s,
        )
        event_bus.publish(state)
        return state

    def _alerts(self, states: list[ServoState]) -> tuple[str, ...]:
        alerts = []
        for servo, state in zip(self._servos, states, strict=True):
            if not state.alert:
                continue
            errors = retry(servo.hardware_errors)
            if errors:
                alerts.append(f"{servo.name}: {', '.join(errors)}")
            else:  # the alert bit summarises the error bits: without one there is no reason to stop
                note_fault(servo.name, "raised its alert bit without a hardware error", "went on")
        return tuple(alerts)

    def _require_healthy(self, state: HeadState) -> None:
        if state.alerts:
            problem = " and ".join(state.alerts)
            raise DeviceError(_HEAD, problem, "remove the cause, then power-cycle the servos")

    def wait_settled(self, timeout_s: float | None = None) -> HeadState:
        """Wait until the head stands: no servo moving and no position changing for 0.2 s.

        Asking keeps the bus watchdog fed.

        Parameters
        ----------
        timeout_s : float, optional
            How long to wait, in seconds; by default the configured ``settle_timeout_s``.

        Returns
        -------
        HeadState
            The state then.

        Raises
        ------
        DeviceError
            The head still moves then, reports a hardware error, or stands away from its goal.
        """
        deadline = Deadline.after(self._parameters.settle_timeout_s if timeout_s is None else timeout_s)
        state = self.state()
        still = state
        while state.monotonic_s - still.monotonic_s < _STILL_S:
            self._require_healthy(state)
            self._require_on_path(state)
            last_try = deadline.expired
            timebase.sleep(_POLL_S)
            state = self.state()
            changes = [abs(a - b) for a, b in zip(state.ticks, still.ticks, strict=True)]
            if state.moving or max(changes) > _STILL_TICKS:
                still = state
                if last_try:
                    raise DeviceError(
                        _HEAD,
                        f"still moves at pan {state.pan_deg:.1f}, tilt {state.tilt_deg:.1f} deg",
                        "raise settle_timeout_s, or look for what shakes it",
                    )
        self._require_healthy(state)
        self._require_on_path(state)
        self._require_at_goal(state)
        for servo in self._servos:
            retry(servo.disarm_bus_watchdog)
        return state

    def _require_on_path(self, state: HeadState) -> None:
        """Switch the torque off and raise ``DeviceError`` if the head leaves the rectangle between the ends of its move
        (for which the keep-out zones were checked) or enters a zone.
        """
        if self._goal_deg is None:
            return
        angles = state.pan_deg, state.tilt_deg
        for axis, from_deg, goal_deg, angle_deg in zip(
            self._axes, self._from_deg, self._goal_deg, angles, strict=True
        ):
            low, high = sorted((from_deg, goal_deg))
            tolerance_deg = _PATH_TOLERANCE_DEG + self._braking_distance_deg
            strayed = not low - tolerance_deg <= angle_deg <= high + tolerance_deg
            if not (strayed or lies_in_a_zone(angles, self._parameters.keep_out)):
                continue
            self._require_power(axis, f"at {angle_deg:.1f} deg on its way to {goal_deg:.1f} deg")
            self._path_error = DeviceError(
                axis.servo.name,
                f"went astray: at {angle_deg:.1f} deg on its way from {from_deg:.1f} to {goal_deg:.1f} deg",
                "look at the cable and at what turns the head, then power-cycle the servos",
            )
            self.relax()
            raise self._path_error

    def _require_at_goal(self, state: HeadState) -> None:
        if self._goal_deg is None:
            return
        angles = state.pan_deg, state.tilt_deg
        for axis, goal_deg, angle_deg in zip(self._axes, self._goal_deg, angles, strict=True):
            if abs(angle_deg - goal_deg) <= _GOAL_TOLERANCE_DEG:
                continue
            where = f"at {angle_deg:.1f} deg on its way to {goal_deg:.1f} deg"
            self._require_power(axis, where)
            raise DeviceError(axis.servo.name, f"stopped {where}", "look for what blocks it")

    @staticmethod
    def _require_power(axis: Axis, where: str) -> None:
        """Raise ``StoppedError`` if a servo was stopped by its bus watchdog or lost its torque."""
        if retry(axis.servo.bus_watchdog_tripped):
            raise StoppedError(
                axis.servo.name,
                f"its bus watchdog stopped it {where}",
                "it received no packet in time (bus watchdog): raise bus_watchdog_ms, or move again",
            )
        if not retry(partial(axis.servo.read, "Torque Enable")):
            raise StoppedError(
                axis.servo.name,
                f"lost its torque {where}",
                "check the servo's power supply, then move again",
            )

    def relax(self) -> None:
        """Torque off, for each servo even where another fails.

        Raises
        ------
        DeviceError
            It could not be switched off; the message names all servos that failed.
        """
        self._goal_deg = None
        self._holding.clear()
        failures = []
        for servo in self._servos:
            try:
                retry(partial(servo.torque, False), replug_s=_RELAX_REPLUG_S)
            except RigError as error:
                failures.append(str(error))
        if failures:
            raise DeviceError(
                _HEAD,
                f"torque could not be switched off ({' | '.join(failures)})",
                "switch the servo power off",
            )

    def close(self) -> None:
        """Torque off, and the port closed even if that fails. Raises ``DeviceError`` as ``relax`` does."""
        try:
            self.relax()
        finally:
            self._bus.close()

    def _close_after(self, error: BaseException) -> None:
        """Close without hiding ``error``, which is propagating."""
        try:
            self.close()
        except RigError as failure:
            if isinstance(error, RigError):  # its message is the one line that the operator reads
                error.args = (
                    f"{error}. The head's torque could not be switched off: switch the servo power off",
                )
                return
            _log.error("%s", failure)
            error.add_note(str(failure))
