"""Speed and acceleration of a servo's moves, from its profile and PWM registers (manuals: Profile Velocity, Acceleration)."""

from sim.devices.register_table import RegisterTable
from sim.devices.x_series import ACCELERATION_UNIT_DEG_S2, VELOCITY_UNIT_DEG_S, ServoModel

STRONGEST_ACCELERATION_DEG_S2 = 2000.0
"""Limit of the motor: profile acceleration 0 is not infinite."""

TIME_BASED = 4
"""Drive Mode, bit 2: the profile registers hold times."""

FULL_PWM = 885
TINY = 1e-6


def motion_profile(table: RegisterTable, model: ServoModel, distance_deg: float) -> tuple[float, float]:
    """Top speed and acceleration for a distance, from the profile registers (Drive Mode)."""
    raw = table["profile_velocity"]
    if raw and table["drive_mode"] & TIME_BASED:
        # Raw values are ms: the whole time, and the ramp, which is at most half of it.
        ramp_s = min(table["profile_acceleration"], raw / 2) / 1000.0
        speed_deg_s = distance_deg / (raw / 1000.0 - ramp_s)
        acceleration_deg_s2 = speed_deg_s / ramp_s if ramp_s else STRONGEST_ACCELERATION_DEG_S2
    else:
        speed_deg_s = raw * VELOCITY_UNIT_DEG_S if raw else model.speed_deg_s
        acceleration_deg_s2 = profile_acceleration_deg_s2(table)
    return (
        min(max(speed_deg_s, TINY), model.speed_deg_s * power_share(table)),
        min(max(acceleration_deg_s2, TINY), STRONGEST_ACCELERATION_DEG_S2),
    )


def profile_acceleration_deg_s2(table: RegisterTable) -> float:
    """Acceleration of the profile register; 0 there means as fast as possible."""
    raw = table["profile_acceleration"]
    if not raw:
        return STRONGEST_ACCELERATION_DEG_S2
    return min(raw * ACCELERATION_UNIT_DEG_S2, STRONGEST_ACCELERATION_DEG_S2)


def power_share(table: RegisterTable) -> float:
    """Share of full speed that the motor reaches: PWM Limit and Goal PWM limit the position controller's output."""
    if not table["position_p_gain"] and not table["position_i_gain"]:
        return 0.0
    return min(table["pwm_limit"], abs(table["goal_pwm"])) / FULL_PWM
