"""Registers of the supported servos: XM430-W350 and XL430-W250.

Addresses and lengths come from the vendor's tables, which dynamixel-sdk ships as data. Added here: which registers are
signed, and their units (e-manual, "Control Table" of each model).
"""

from dataclasses import dataclass
from functools import cache
from importlib.resources import files

TICKS_PER_TURN = 4096
VELOCITY_UNIT_DEG_S = 0.229 * 360.0 / 60.0  # 0.229 rev/min
ACCELERATION_UNIT_DEG_S2 = 214.577 * 360.0 / 3600.0  # 214.577 rev/min²
CURRENT_UNIT_A = 0.00269
LOAD_UNIT_PERCENT = 0.1
VOLTAGE_UNIT_V = 0.1
BUS_WATCHDOG_UNIT_S = 0.020
BUS_WATCHDOG_TRIPPED = -1
BUS_WATCHDOG_FIRMWARE = 38

POSITION_MODE = 3
NO_SECONDARY_ID = 255
MIN_DISABLED_SECONDARY_ID = 253
"""A Secondary ID from this value on is disabled."""

PROTOCOL_2 = 2
STATUS_RETURN_ALL = 2
"""Status Return Level: 0 answers a ping only, 1 a ping and a read."""

REVERSE_MODE = 0x01
"""Drive Mode, bit 0: positions count in reverse."""

FACTORY_SHUTDOWN = 0x34
STARTUP_CONFIGURATION_FIRMWARE = 45

MODEL_NUMBERS = {"XM430-W350": 1020, "XL430-W250": 1060}

VOLTAGE_ERROR, OVERHEATING_ERROR = 0x01, 0x04
HARDWARE_ERRORS = {
    0x01: "input voltage out of range",
    0x04: "overheated",
    0x08: "motor encoder fault",
    0x10: "electrical shock or too little power",
    0x20: "overload",
}

FACTORY_EEPROM: dict[str, dict[str, int]] = {
    "XM430-W350": {
        "Moving Threshold": 10,
        "PWM Limit": 885,
        "Current Limit": 1193,
        "Velocity Limit": 350,
    },
    "XL430-W250": {"Moving Threshold": 10, "PWM Limit": 885, "Velocity Limit": 265},
}
"""Factory values of the EEPROM registers that affect how goals are followed (e-manual, "Control Table")."""

FACTORY_PROTECTION: dict[str, dict[str, tuple[int, int]]] = {
    "XM430-W350": {
        "Temperature Limit": (1, 80),
        "Min Voltage Limit": (95, 160),
        "Max Voltage Limit": (95, 160),
    },
    "XL430-W250": {
        "Temperature Limit": (1, 72),
        "Min Voltage Limit": (60, 140),
        "Max Voltage Limit": (60, 140),
    },
}
"""Factory limits of the protection registers, which an installer may narrow: 1 °C, and 0.1 V."""

FACTORY_RAM: dict[str, dict[str, int]] = {
    "XM430-W350": {
        "Velocity I Gain": 1920,
        "Velocity P Gain": 100,
        "Position D Gain": 0,
        "Position I Gain": 0,
        "Position P Gain": 800,
        "Feedforward 2nd Gain": 0,
        "Feedforward 1st Gain": 0,
        "Goal PWM": 885,
        "Goal Current": 1193,
    },
    "XL430-W250": {
        "Velocity I Gain": 1000,
        "Velocity P Gain": 100,
        "Position D Gain": 4000,
        "Position I Gain": 0,
        "Position P Gain": 640,
        "Feedforward 2nd Gain": 0,
        "Feedforward 1st Gain": 0,
        "Goal PWM": 885,
    },
}
"""Factory values in RAM. Goal PWM and Goal Current are limits in position mode."""

_SIGNED = frozenset(
    {
        "Homing Offset",
        "Bus Watchdog",
        "Goal PWM",
        "Goal Current",
        "Goal Velocity",
        "Goal Position",
        "Present PWM",
        "Present Current",
        "Present Load",
        "Present Velocity",
        "Present Position",
        "Velocity Trajectory",
        "Position Trajectory",
    }
)


@dataclass(frozen=True)
class Register:
    """A register of the control table: address, length and sign (little-endian)."""

    name: str
    address: int
    length: int
    signed: bool

    def encode(self, value: int) -> bytes:
        """The bytes to write. Raises ``OverflowError`` if the value does not fit."""
        return value.to_bytes(self.length, "little", signed=self.signed)

    def decode(self, data: bytes, start: int | None = None) -> int:
        """The value in ``data``, which begins at address ``start`` (default: its own)."""
        offset = 0 if start is None else self.address - start
        return int.from_bytes(data[offset : offset + self.length], "little", signed=self.signed)


STARTUP_CONFIGURATION = Register("Startup Configuration", 60, 1, signed=False)
"""Not in the vendor's tables: torque on, and RAM restored from a backup, at start-up. From firmware 45 on."""


@cache
def control_table(model: str) -> dict[str, Register]:
    """The registers of ``model`` ("XM430-W350") by the vendor's names ("Goal Position").

    Raises ``KeyError`` for a model that is not in ``MODEL_NUMBERS``.
    """
    folder = files("dynamixel_easy_sdk") / "control_table"
    models = dict(_rows((folder / "dynamixel.model").read_text(encoding="utf-8"), "Number\tName"))
    table = (folder / models[str(MODEL_NUMBERS[model])]).read_text(encoding="utf-8")
    return {
        name: Register(name, int(address), int(length), name in _SIGNED)
        for address, length, name in _rows(table, "Address\tSize\tData Name")
    }


def _rows(text: str, heading: str) -> list[list[str]]:
    """The tab-separated rows that follow ``heading``."""
    lines = text.splitlines()
    return [line.split("\t") for line in lines[lines.index(heading) + 1 :] if line.strip()]
