"""Restarts servos after a hardware shutdown, such as an overload from a branch against the head.

A Dynamixel switches its torque off after overload, overheating or a voltage out of range, until it is rebooted or
power-cycled. The cause may persist: restarts back off, and stop after a few without a successful capture. Encoder
faults and electrical shocks are not reset, as that may cause damage.
"""

from collections.abc import Callable, Sequence
from contextlib import closing
from functools import partial

import structlog

from rig import timebase
from rig.config.sections import PanTiltSection
from rig.devices.bus.retry import retry
from rig.devices.bus.serial_port import SerialPort
from rig.devices.dynamixel.servo import Servo
from rig.devices.dynamixel.servo_bus import ServoBus
from rig.errors import RigError

_log = structlog.get_logger(__name__)

RECOVERABLE = 0x01 | 0x04 | 0x20
"""Bits of the hardware error status: input voltage, overheated, overload."""
WAITS_S = 10.0, 60.0, 360.0
"""Wait from an error to the first, the second and the last restart without a successful capture."""


def restart_servos(section: PanTiltSection) -> list[str]:
    """Reboot the servos with recoverable errors; returns which, with their errors.

    Their torque is off then. Raises ``RigError``, also if one was turned beyond one turn by hand: a reboot would lose
    the turn count.
    """
    restarted = []
    with closing(ServoBus(SerialPort(section.port, section.baud))) as bus:
        for name, joint in (("pan", section.pan), ("tilt", section.tilt)):
            servo = Servo(bus, joint.id, joint.model, name)
            retry(servo.set_status_return_all)
            status = retry(partial(servo.read, "Hardware Error Status"))
            if status and not status & ~RECOVERABLE:
                errors = retry(servo.hardware_errors)
                servo.require_one_turn(retry(partial(servo.read, "Present Position")))
                retry(partial(bus.reboot, joint.id))
                retry(servo.hardware_errors)  # until it is back
                restarted.append(f"{servo.name}: {', '.join(errors)}")
    return restarted


class ServoRestarts:
    """Schedules restarts. For one thread that holds the head."""

    def __init__(self, restart: Callable[[], Sequence[str]], waits_s: Sequence[float] = WAITS_S) -> None:
        self._restart = restart
        self._waits_s = waits_s
        self._done = 0
        self._seen_s: float | None = None

    def hardware_error_seen(self) -> Sequence[str]:
        """The head has a hardware error now; returns what was restarted."""
        now_s = timebase.monotonic_s()
        if self._seen_s is None:
            self._seen_s = now_s
        if self.exhausted or now_s < self._seen_s + self._waits_s[self._done]:
            return ()
        self._done += 1
        self._seen_s = None
        try:
            restarted = self._restart()
        except RigError as error:
            _log.error("servos cannot be restarted", problem=str(error))
            return ()
        if restarted:
            _log.warning("servos restarted", why="; ".join(restarted), left=len(self._waits_s) - self._done)
        return restarted

    def healthy(self) -> None:
        """The head has no hardware error now."""
        self._seen_s = None

    def capture_succeeded(self) -> None:
        """A capture succeeded: reset the schedule."""
        self._done = 0

    @property
    def exhausted(self) -> bool:
        """Whether no restart is left."""
        return self._done >= len(self._waits_s)
