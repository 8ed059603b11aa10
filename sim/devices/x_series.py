"""Control tables of the X-series servos as data: addresses, defaults and write bounds.

Source: the manuals of XM430-W350 and XL430-W250, control table. Addresses below 64 are EEPROM, the rest RAM.
"""

from dataclasses import dataclass
from typing import NamedTuple

EEPROM_END = 64
TABLE_SIZE = 662
TICKS_PER_TURN = 4096
VELOCITY_UNIT_DEG_S = 0.229 * 6.0
ACCELERATION_UNIT_DEG_S2 = 214.577 / 10.0
WATCHDOG_UNIT_S = 0.020
INDIRECT_BANKS = ((168, 224, 28), (578, 634, 28))
"""First address register, first data register, number of pairs."""

POSITION_LIMIT = 1_048_575


class Field(NamedTuple):
    """One entry of a control table. ``low`` and ``high`` bound what may be written; else read-only."""

    name: str
    address: int
    length: int
    default: int = 0
    low: int | None = None
    high: int | None = None
    signed: bool = False

    @property
    def end(self) -> int:
        """First address behind the field."""
        return self.address + self.length


@dataclass(frozen=True)
class ServoModel:
    """The differences between X-series models.

    ``speed_deg_s`` is the fastest that the shaft turns. ``friction_current`` is in units of the register 126:
    2.69 mA where the servo ``measures_current``, else load in 0.1 %.
    """

    name: str
    number: int
    speed_deg_s: float
    measures_current: bool
    friction_current: int
    fields: tuple[Field, ...]


def _fields(
    *,
    number: int,
    temperature_limit_c: int,
    max_voltage: int,
    min_voltage: int,
    current_limit: int | None,
    velocity_limit: int,
    velocity_i: int,
    position_d: int,
    position_p: int,
) -> tuple[Field, ...]:
    common = (
        Field("model_number", 0, 2, number),
        Field("model_information", 2, 4),
        Field("firmware_version", 6, 1, 46),
        Field("id", 7, 1, 1, 0, 252),
        Field("baud_rate", 8, 1, 1, 0, 7),
        Field("return_delay_time", 9, 1, 250, 0, 254),
        Field("drive_mode", 10, 1, 0, 0, 15),
        Field("operating_mode", 11, 1, 3, 0, 16),
        Field("secondary_id", 12, 1, 255, 0, 255),
        Field("protocol_type", 13, 1, 2, 1, 2),
        Field("homing_offset", 20, 4, 0, -1_044_479, 1_044_479, signed=True),
        Field("moving_threshold", 24, 4, 10, 0, 1023),
        Field("temperature_limit", 31, 1, temperature_limit_c, 0, 100),
        Field("max_voltage_limit", 32, 2, max_voltage, min_voltage, max_voltage),
        Field("min_voltage_limit", 34, 2, min_voltage, min_voltage, max_voltage),
        Field("pwm_limit", 36, 2, 885, 0, 885),
        Field("velocity_limit", 44, 4, velocity_limit, 0, 1023),
        Field("max_position_limit", 48, 4, 4095, 0, 4095),
        Field("min_position_limit", 52, 4, 0, 0, 4095),
        Field("startup_configuration", 60, 1, 0, 0, 3),
        Field("shutdown", 63, 1, 0x34, 0, 0xFF),
        Field("torque_enable", 64, 1, 0, 0, 1),
        Field("led", 65, 1, 0, 0, 1),
        Field("status_return_level", 68, 1, 2, 0, 2),
        Field("registered_instruction", 69, 1),
        Field("hardware_error_status", 70, 1),
        Field("velocity_i_gain", 76, 2, velocity_i, 0, 16383),
        Field("velocity_p_gain", 78, 2, 100, 0, 16383),
        Field("position_d_gain", 80, 2, position_d, 0, 16383),
        Field("position_i_gain", 82, 2, 0, 0, 16383),
        Field("position_p_gain", 84, 2, position_p, 0, 16383),
        Field("feedforward_2nd_gain", 88, 2, 0, 0, 16383),
        Field("feedforward_1st_gain", 90, 2, 0, 0, 16383),
        Field("bus_watchdog", 98, 1, 0, 0, 127, signed=True),
        Field("goal_pwm", 100, 2, 885, -885, 885, signed=True),
        Field("goal_velocity", 104, 4, 0, -1023, 1023, signed=True),
        Field("profile_acceleration", 108, 4, 0, 0, 32767),
        Field("profile_velocity", 112, 4, 0, 0, 32767),
        Field("goal_position", 116, 4, 0, -POSITION_LIMIT, POSITION_LIMIT, signed=True),
        Field("realtime_tick", 120, 2),
        Field("moving", 122, 1),
        Field("moving_status", 123, 1),
        Field("present_pwm", 124, 2, signed=True),
        Field("present_current", 126, 2, signed=True),
        Field("present_velocity", 128, 4, signed=True),
        Field("present_position", 132, 4, signed=True),
        Field("velocity_trajectory", 136, 4, signed=True),
        Field("position_trajectory", 140, 4, signed=True),
        Field("present_input_voltage", 144, 2),
        Field("present_temperature", 146, 1),
        Field("backup_ready", 147, 1),
    )
    current = (
        ()
        if current_limit is None
        else (
            Field("current_limit", 38, 2, current_limit, 0, current_limit),
            Field("goal_current", 102, 2, current_limit, -current_limit, current_limit, signed=True),
        )
    )
    indirect = tuple(
        Field(f"indirect_address_{address}", address, 2, data, 64, TABLE_SIZE - 1)
        for first_address, first_data, count in INDIRECT_BANKS
        for address, data in zip(
            range(first_address, first_address + 2 * count, 2),
            range(first_data, first_data + count),
            strict=True,
        )
    )
    return tuple(sorted((*common, *current, *indirect), key=lambda field: field.address))


XM430_W350 = ServoModel(
    name="XM430-W350",
    number=1020,
    speed_deg_s=57.0 * 6.0,
    measures_current=True,
    friction_current=28,
    fields=_fields(
        number=1020,
        temperature_limit_c=80,
        max_voltage=160,
        min_voltage=95,
        current_limit=1193,
        velocity_limit=350,
        velocity_i=1920,
        position_d=0,
        position_p=800,
    ),
)
XL430_W250 = ServoModel(
    name="XL430-W250",
    number=1060,
    speed_deg_s=57.0 * 6.0,
    measures_current=False,
    friction_current=90,
    fields=_fields(
        number=1060,
        temperature_limit_c=72,
        max_voltage=140,
        min_voltage=60,
        current_limit=None,
        velocity_limit=265,
        velocity_i=1000,
        position_d=4000,
        position_p=640,
    ),
)
MODELS = {model.name: model for model in (XM430_W350, XL430_W250)}
BAUD_RATES = (9600, 57600, 115200, 1_000_000, 2_000_000, 3_000_000, 4_000_000, 4_500_000)
