"""Servos that have shut down are restarted: a branch that held the head for a moment does not end the day.

A Dynamixel takes its torque off after an overload, an overheating or a voltage out of range, and keeps it off until an
instruction or its power restarts it. What held it may still be there: restarts grow rarer, and after a few without a capture
that worked they end. An encoder fault and an electrical shock are not tried: who restarts after those may burn something.
"""

import time
from collections.abc import Callable, Sequence
from contextlib import closing
from functools import partial

import structlog

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
"""From the first sight of an error to a restart: the first, the second and the last without a capture that worked."""


def restart_servos(section: PanTiltSection) -> list[str]:
    """Restart the servos that have shut down for what may pass; returns which, with their errors.

    They are without torque then. Raises ``RigError``, also where one was turned beyond one turn by hand: a restart would forget
    that it was.
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
    """When to restart. For one thread, which has the head to itself."""

    def __init__(self, restart: Callable[[], Sequence[str]], waits_s: Sequence[float] = WAITS_S) -> None:
        self._restart = restart
        self._waits_s = waits_s
        self._done = 0
        self._seen_s: float | None = None

    def hardware_error_seen(self) -> Sequence[str]:
        """The head has a hardware error at this moment; returns what was restarted for it."""
        now_s = time.monotonic()
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
        """The head has no hardware error at this moment."""
        self._seen_s = None

    def capture_succeeded(self) -> None:
        """A capture moved the head: what was, is over."""
        self._done = 0

    @property
    def exhausted(self) -> bool:
        """Whether no restart is left."""
        return self._done >= len(self._waits_s)
