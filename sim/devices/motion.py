"""Motion of a shaft: a velocity profile in closed form, evaluated at any time without a thread."""

import math
from dataclasses import dataclass

STEP, RECTANGLE, TRIANGLE, TRAPEZOID = range(4)
"""Profile types, as bits 5:4 of the register Moving Status have them."""


@dataclass(frozen=True)
class Phase:
    """A phase of constant acceleration. Units of length are the caller's (here ticks)."""

    start_s: float
    position: float
    velocity: float
    acceleration: float
    duration_s: float


@dataclass(frozen=True)
class Motion:
    """Consecutive phases; before the first and after the last the shaft is stationary."""

    phases: tuple[Phase, ...]
    goal: float
    shape: int = STEP

    @property
    def end_s(self) -> float:
        """Time at which the motion ends."""
        last = self.phases[-1]
        return last.start_s + last.duration_s

    def at(self, time_s: float) -> tuple[float, float]:
        """Position and velocity at ``time_s``."""
        for phase in reversed(self.phases):
            if time_s >= phase.start_s:
                break
        elapsed = min(max(time_s - phase.start_s, 0.0), phase.duration_s)
        ended = time_s >= self.end_s
        velocity = phase.velocity + phase.acceleration * elapsed
        position = phase.position + phase.velocity * elapsed + phase.acceleration * elapsed**2 / 2
        return position, 0.0 if ended else velocity


def rest(position: float, time_s: float) -> Motion:
    """A stationary shaft."""
    return Motion((Phase(time_s, position, 0.0, 0.0, 0.0),), position)


def turn(
    position: float, velocity: float, goal_velocity: float, acceleration: float, time_s: float
) -> Motion:
    """Accelerate to ``goal_velocity`` and keep it without end."""
    ramp_s = abs(goal_velocity - velocity) / acceleration
    signed = math.copysign(acceleration, goal_velocity - velocity)
    ramp = Phase(time_s, position, velocity, signed, ramp_s)
    reached = position + (velocity + goal_velocity) / 2 * ramp_s
    hold = Phase(time_s + ramp_s, reached, goal_velocity, 0.0, math.inf if goal_velocity else 0.0)
    return Motion((ramp, hold), reached)


def stop(position: float, velocity: float, deceleration: float, time_s: float) -> Motion:
    """Brake to a standstill."""
    return turn(position, velocity, 0.0, deceleration, time_s)


def move(
    position: float, velocity: float, goal: float, top_speed: float, acceleration: float, time_s: float
) -> Motion:
    """The fastest motion to a standstill at ``goal`` within ``top_speed`` and ``acceleration``, from any velocity."""
    braking = velocity * abs(velocity) / (2 * acceleration)
    way = goal - position
    direction = math.copysign(1.0, way - braking) if way != braking else math.copysign(1.0, velocity)
    peak = min(top_speed, math.sqrt(max(direction * way * acceleration + velocity**2 / 2, 0.0)))
    cruise = direction * peak
    ramp_s = abs(cruise - velocity) / acceleration
    brake_s = peak / acceleration
    left = way - (velocity + cruise) / 2 * ramp_s - cruise / 2 * brake_s
    cruise_s = max(left / cruise, 0.0) if peak > 0 else 0.0
    phases: list[Phase] = []
    for first, second, duration_s in (
        (velocity, cruise, ramp_s),
        (cruise, cruise, cruise_s),
        (cruise, 0.0, brake_s),
    ):
        phases.append(
            Phase(time_s, position, first, (second - first) / duration_s if duration_s else 0.0, duration_s)
        )
        position += (first + second) / 2 * duration_s
        time_s += duration_s
    return Motion(tuple(phases), goal, TRAPEZOID if cruise_s > 1e-6 else TRIANGLE)
