"""One axis of the head: a servo, and the conversion between its ticks and joint angles."""

import math

from rig.devices.dynamixel import control_table as table
from rig.devices.dynamixel.servo import Servo
from rig.devices.dynamixel.servo_bus import ServoBus
from rig.devices.pan_tilt_parameters import AxisParameters
from rig.errors import GoalError

TICK_DEG = 360.0 / table.TICKS_PER_TURN


class Axis:
    """One servo with the conversion between ticks and angles."""

    def __init__(self, name: str, bus: ServoBus, parameters: AxisParameters) -> None:
        self.name = name
        self.parameters = parameters
        self.servo = Servo(bus, parameters.id, parameters.model, name)
        self.min_tick, self.max_tick = sorted((self.tick(parameters.min_deg), self.tick(parameters.max_deg)))

    def tick(self, angle_deg: float) -> int:
        return self.parameters.zero_tick + round(self.parameters.direction * angle_deg / TICK_DEG)

    def angle_deg(self, tick: int) -> float:
        return (tick - self.parameters.zero_tick) * self.parameters.direction * TICK_DEG

    def goal_tick(self, angle_deg: float) -> int:
        low, high = self.parameters.min_deg, self.parameters.max_deg
        if not math.isfinite(angle_deg) or not low <= angle_deg <= high:
            raise GoalError(
                f"{self.name} goal {angle_deg:g} deg is outside its limits {low:g} to {high:g} deg; "
                f"ask for less or turn the vehicle ([pan_tilt.{self.name}] min_deg, max_deg)"
            )
        return self.tick(angle_deg)
