"""What the kernel reports under /sys about buses and ports: names, drivers bound to chips, adapter settings.

No function here raises: what cannot be read is None.
"""

import os
import re
import stat
from collections.abc import Iterator
from pathlib import Path

SYS = Path("/sys")

_BUS_NAME = re.compile(r"i2c-(\d+)")


def i2c_adapters() -> dict[int, str]:
    """Number and name of each I2C adapter that the kernel knows, with or without a device file in /dev."""
    found = {}
    for folder in (SYS / "bus/i2c/devices", SYS / "class/i2c-dev", SYS / "class/i2c-adapter"):
        for entry in _entries(folder):
            number = _BUS_NAME.fullmatch(entry.name)
            if number and int(number[1]) not in found:
                found[int(number[1])] = _text(entry / "name") or _text(entry / "device/name") or ""
    return dict(sorted(found.items()))


def i2c_parent(number: int) -> str | None:
    """The device of an adapter ("i2c_designware.0", "fe804000.i2c"): it distinguishes adapters of the same name."""
    for folder in (SYS / "bus/i2c/devices", SYS / "class/i2c-dev"):
        entry = folder / f"i2c-{number}"
        if entry.exists():
            return entry.resolve().parent.name
    return None


def i2c_number(path: str) -> int | None:
    """Bus number N of a device file: by its device number, else by its name or that of its link target."""
    try:
        status = Path(path).stat()
        if stat.S_ISCHR(status.st_mode) and os.major(status.st_rdev) == 89:  # I2C_MAJOR
            return os.minor(status.st_rdev)
    except OSError:
        pass
    for name in (os.path.realpath(path), path):
        number = _BUS_NAME.fullmatch(Path(name).name)
        if number:
            return int(number[1])
    return None


def i2c_driver(bus: int, address: int) -> str | None:
    """The kernel driver bound to a chip; None if there is none."""
    return _link_name(SYS / f"bus/i2c/devices/{bus}-{address:04x}/driver")


def serial_latency_file(path: str) -> Path:
    """The latency timer setting of a USB serial adapter (FTDI)."""
    return SYS / f"bus/usb-serial/devices/{Path(path).resolve().name}/latency_timer"


def serial_latency_ms(path: str) -> int | None:
    """Latency timer of a USB serial adapter (FTDI), milliseconds; None if it has no such setting."""
    for file in (
        serial_latency_file(path),
        SYS / f"class/tty/{Path(path).resolve().name}/device/latency_timer",
    ):
        text = _text(file)
        if text is not None and text.isdigit():
            return int(text)
    return None


def _entries(folder: Path) -> Iterator[Path]:
    try:
        yield from sorted(folder.iterdir())
    except OSError:
        return


def _text(path: Path) -> str | None:
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return None


def _link_name(path: Path) -> str | None:
    try:
        return path.readlink().name
    except OSError:
        return None
