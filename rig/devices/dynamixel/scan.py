"""Scans for servos at all baud rates, for messages about silent ones."""

from collections.abc import Mapping

from rig.devices.bus.serial_port import SerialPort
from rig.devices.dynamixel import control_table as table
from rig.devices.dynamixel.servo_bus import ServoBus
from rig.errors import DeviceError

BAUDS = (57600, 1_000_000, 115200, 2_000_000, 3_000_000, 4_000_000, 4_500_000, 9600)
"""The baud rates of X-series servos, the factory setting first."""

ALL_ANSWER_S = 0.8
"""Duration of a broadcast ping: each servo answers in turn, 3 ms for each id (as in the vendor's SDK)."""
SOME_ANSWER_S = 0.2
"""Time for answers of servos with usual (low) ids."""

Found = Mapping[int, int]
"""Model numbers by id."""


def servos_at(path: str, baud: int, wait_s: float = SOME_ANSWER_S) -> Found:
    """The servos that answer on a port at a baud rate; none if the port cannot be used."""
    try:
        bus = ServoBus(SerialPort(path, baud))
    except DeviceError:
        return {}
    try:
        return bus.ping_all(wait_s)
    except DeviceError:
        return {}
    finally:
        bus.close()


def scan_hint(path: str, baud: int) -> str | None:
    """What answers on a port instead of the configured servos, as an instruction; None if nothing does.

    Nothing moves: servos are only pinged, at one baud rate after the other.
    """
    here = servos_at(path, baud, ALL_ANSWER_S)
    if here:
        return (
            f"at {baud} baud {_listed(here)}: correct `id`, or give the servos theirs with Dynamixel Wizard"
        )
    for other in BAUDS:
        found = servos_at(path, other) if other != baud else {}
        if found:
            return f"at {other} baud {_listed(found)}: set `baud` to {other}, or the servos to {baud} with Dynamixel Wizard"
    return None


def _listed(found: Found) -> str:
    names = {number: name for name, number in table.MODEL_NUMBERS.items()}
    each = [f"id {i} ({names.get(number, f'model number {number}')})" for i, number in sorted(found.items())]
    return f"{' and '.join([', '.join(each[:-1]), each[-1]] if len(each) > 1 else each)} answer{'s' if len(each) == 1 else ''}"
