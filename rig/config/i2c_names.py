"""Names of I2C buses in a configuration: a device file, its number, an adapter's name, or a bridge."""

import difflib
import os
import re

from rig import sysfs
from rig.errors import ConfigError

BRIDGE_URL = re.compile(r"tcp://(?P<host>[^/:\s]+|\[[^]]+\]):(?P<port>\d{1,5})/(?P<bus>\d{1,3})")

_NUMBER = re.compile(r"(?:i2c-)?(\d{1,4})")
_NO_NAME = re.compile(r"(com\d+|/.*|.*://.*|tty\w*|[^a-z]*)", re.IGNORECASE | re.DOTALL)
_NAMES_SHOWN = 4
_FORMS = "/dev/i2c-N or tcp://HOST:PORT/BUS"


def checked_bus(bus: object) -> object:
    """A configured bus in the form that ``open_i2c`` takes; ``ValueError``, one sentence, for an impossible one.

    ``1``, ``"1"`` and ``"i2c-1"`` are /dev/i2c-1. A device file may have any name (udev adds links). An adapter may be
    named as in ``i2cdetect -l``, or by its device ("i2c_designware.0"): bus numbers change with the order in which
    adapters are found.
    """
    if isinstance(bus, int) and not isinstance(bus, bool):
        bus = str(bus)
    if not isinstance(bus, str):
        raise ValueError(f"{bus!r} is no I2C bus; give {_FORMS}")
    number = _NUMBER.fullmatch(bus)
    if number:
        return f"/dev/i2c-{int(number[1])}"
    if re.fullmatch(r"/dev/[^\s/][^\s]*", bus) or BRIDGE_URL.fullmatch(bus):
        return bus
    if _NO_NAME.fullmatch(bus):
        raise ValueError(f"{bus!r} is no I2C bus; give {_FORMS}")
    return bus


def adapter_path(name: str) -> str:
    """The device file of the adapter whose name contains ``name``. ``ConfigError`` if none or several match."""
    adapters = sysfs.i2c_adapters()
    exact = [number for number, known in adapters.items() if name in (known, sysfs.i2c_parent(number))]
    partly = [number for number, known in adapters.items() if name and name.lower() in known.lower()]
    found = exact or partly
    if len(found) == 1:
        return f"/dev/i2c-{found[0]}"
    if found:
        raise ConfigError(
            f"`bus` = {name!r}: {len(found)} I2C adapters are called so: {_listed(found, adapters)}; give more of the name, "
            "the name of its device (/sys/bus/i2c/devices/i2c-N leads to it), or the device file"
        )
    alike = difflib.get_close_matches(name, adapters.values(), n=1, cutoff=0.5)
    meant = f"did you mean {alike[0]!r}? " if alike else ""
    there = (
        f"there is {_listed(list(adapters), adapters)}" if adapters else "this computer has no I2C adapter"
    )
    raise ConfigError(
        f"`bus` = {name!r}: expected a device file (/dev/i2c-1), tcp://HOST:PORT/BUS or the name of an I2C adapter; "
        f"{meant}{there}"
    )


def same_bus(bus: str) -> str:
    """A canonical name for comparison: the device file with links resolved, or the bridge."""
    if not bus.startswith("/") and not BRIDGE_URL.fullmatch(bus):
        try:
            bus = adapter_path(bus)
        except ConfigError:
            return bus
    if not bus.startswith("/"):
        return bus.lower()
    number = sysfs.i2c_number(bus)
    return os.path.realpath(bus) if number is None else f"/dev/i2c-{number}"


def buses_there() -> str:
    """The buses of this computer, for messages about a missing one."""
    adapters = sysfs.i2c_adapters()
    return f"there is {_listed(list(adapters), adapters)}" if adapters else "there is no I2C bus"


def _listed(numbers: list[int], adapters: dict[int, str]) -> str:
    shown = ", ".join(
        f"i2c-{number}" + (f" ({adapters[number]})" if adapters[number] else "")
        for number in numbers[:_NAMES_SHOWN]
    )
    more = len(numbers) - _NAMES_SHOWN
    return shown + (f" and {more} more" if more > 0 else "")
