"""The registers of the servos that the rig knows: XM430-W350 and XL430-W250.

Addresses and lengths are those of the vendor's own tables, which dynamixel-sdk ships as data. What those lack
is here: which registers are signed, and the size of a unit (e-manual, "Control Table" of each model).
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

MODEL_NUMBERS = {"XM430-W350": 1020, "XL430-W250": 1060}

HARDWARE_ERRORS = {
    0x01: "input voltage out of range",
    0x04: "overheated",
    0x08: "motor encoder fault",
    0x10: "electrical shock or too little power",
    0x20: "overload",
}

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
    """Where a value lies in a servo's control table, and how its bytes are read (little-endian)."""

    name: str
    address: int
    length: int
    signed: bool

    def encode(self, value: int) -> bytes:
        """The bytes to write. Raises ``OverflowError`` where the value does not fit."""
        return value.to_bytes(self.length, "little", signed=self.signed)

    def decode(self, data: bytes, start: int | None = None) -> int:
        """The value in ``data``, which begins at address ``start`` (default: its own)."""
        offset = 0 if start is None else self.address - start
        return int.from_bytes(data[offset : offset + self.length], "little", signed=self.signed)


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
