"""Messages for the errno of an I2C transfer, with what to do.

The meanings are the kernel's: Documentation/i2c/fault-codes.rst, "I2C and SMBus fault codes".
"""

import errno
from pathlib import Path

from smbus2.smbus2 import I2cFunc

from rig import sysfs
from rig.config.i2c_names import same_bus
from rig.errors import DeviceError, TransientError

_LASTING = (
    errno.EOPNOTSUPP,
    errno.EINVAL,
    errno.EACCES,
    errno.EPERM,
    errno.ENOTTY,
    errno.ENOSYS,
)
"""Errors that a retry cannot fix."""

_NO_ACKNOWLEDGE = ("does not acknowledge", "check its power, wiring and `address`")
_WORDS = {
    errno.EREMOTEIO: _NO_ACKNOWLEDGE,
    errno.ENXIO: _NO_ACKNOWLEDGE,
    errno.ETIMEDOUT: ("timed out", "check for a stuck clock line; power-cycle the chip"),
    errno.EIO: ("the bus failed", "check pull-ups and wiring; power-cycle the chip"),
    errno.EAGAIN: (
        "lost the bus to another master, or to noise",
        "let only one master drive the bus; keep its lines short and away from motors",
    ),
    errno.EBADMSG: (
        "sent a packet with a wrong checksum (PEC)",
        "keep the lines short and away from motors; check pull-ups",
    ),
    errno.EPROTO: (
        "broke the I2C protocol",
        "see that the chip at this `address` is the configured one; power-cycle it",
    ),
    errno.ENODEV: ("its I2C adapter has gone away", "plug the adapter in again, or load its kernel driver"),
    errno.ENOENT: ("its I2C adapter has gone away", "plug the adapter in again, or load its kernel driver"),
    errno.ESHUTDOWN: (
        "the I2C adapter is suspended",
        "keep the computer awake; switch the adapter's power management off",
    ),
    errno.EACCES: (
        "this user may not use the bus",
        "add the user to the group of the bus's device file, often i2c",
    ),
    errno.EPERM: (
        "this user may not use the bus",
        "add the user to the group of the bus's device file, often i2c",
    ),
    errno.EINVAL: (
        "the kernel does not accept such a transfer",
        "see that `address` is a 7-bit address, without the read bit",
    ),
    errno.ENOTTY: ("the device file is no I2C bus", "correct `bus`"),
    errno.ENOMEM: ("the kernel is out of memory", "end other programs"),
    errno.ENOSYS: ("the kernel has no such transfer", "connect the chip to another adapter"),
}


class BridgeLostError(OSError):
    """The network connection to a bridge failed, not the bus behind it."""

    def __init__(self, number: int, problem: str, bridge: str, remedy: str) -> None:
        super().__init__(number, problem)
        self.problem, self.bridge, self.remedy = problem, bridge, remedy


def transfer_error(
    error: OSError, chip: str, bus: str, address: int, write_length: int, read_length: int
) -> DeviceError:
    """The error of a transfer with ``chip``: ``TransientError`` if a retry may succeed, else ``DeviceError``."""
    if isinstance(error, BridgeLostError):
        return TransientError(f"{chip}: I2C bridge {error.bridge}", error.problem, error.remedy)
    number = error.errno or 0
    if number == errno.EBUSY:
        problem, remedy = _busy(bus, address)
    elif number == errno.EOPNOTSUPP:
        problem, remedy = _unsupported(bus, write_length, read_length)
    elif number in (errno.ENXIO, errno.ENODEV) and bus.startswith("/") and not Path(bus).exists():
        problem, remedy = _WORDS[errno.ENODEV]
    else:
        problem, remedy = _WORDS.get(number, ("the bus failed", "check the wiring"))
    kind = DeviceError if number in _LASTING else TransientError
    return kind(chip, f"{problem} ({_reason(error)})", remedy)


def _reason(error: OSError) -> str:
    name = errno.errorcode.get(error.errno or 0)
    words = error.strerror or str(error)
    return f"{words}, {name}" if name in ("EBUSY", "EOPNOTSUPP", "ENOTSUP") else words


def _busy(bus: str, address: int) -> tuple[str, str]:
    held = held_by_driver(bus, address)
    if held:
        return held
    return (
        "the bus is busy: its lines are held low, or a kernel driver holds the chip",
        f"look for a driver (/sys/bus/i2c/devices/{_bus_number_or_n(bus)}-{address:04x}/driver) and unbind it, end other "
        "programs on the bus, or power-cycle its chips",
    )


def held_by_driver(bus: str, address: int) -> tuple[str, str] | None:
    """Problem and remedy if a kernel driver is bound to the chip; else None."""
    number = _bus_number(bus)
    driver = None if number is None else sysfs.i2c_driver(number, address)
    if driver is None:
        return None
    return (
        f"is in use by the kernel driver {driver}",
        f"unbind it (echo {number}-{address:04x} | sudo tee /sys/bus/i2c/drivers/{driver}/unbind), and for good: take the "
        f"overlay that names the chip out of the boot configuration, or blacklist {driver}",
    )


def _unsupported(bus: str, write_length: int, read_length: int) -> tuple[str, str]:
    number = _bus_number_or_n(bus)
    what = " and ".join(
        [f"writes {write_length} bytes"] * (write_length > 0)
        + [f"reads {read_length} bytes"] * (read_length > 0)
    )
    return (
        f"the I2C adapter cannot do a transfer that {what or 'carries nothing'}",
        f"see what it can (i2cdetect -F {number}): it needs the function I2C (I2C_FUNC_I2C), for messages of that length; "
        "connect the chip to an adapter that has it",
    )


def _bus_number(bus: str) -> int | None:
    """Number N of a local bus; None for one behind a bridge."""
    path = same_bus(bus)
    return sysfs.i2c_number(path) if path.startswith("/") else None


def _bus_number_or_n(bus: str) -> str:
    number = _bus_number(bus)
    return "N" if number is None else str(number)


def lacks_plain_i2c(functions: int) -> str | None:
    """What an adapter without plain I2C transfers can do, in words; None if it has them."""
    if functions & I2cFunc.I2C:
        return None
    smbus = {
        "byte": I2cFunc.SMBUS_READ_BYTE_DATA,
        "word": I2cFunc.SMBUS_READ_WORD_DATA,
        "block": I2cFunc.SMBUS_READ_I2C_BLOCK,
    }
    has = [name for name, bit in smbus.items() if functions & bit]
    return f"only SMBus ({', '.join(has)})" if has else "no transfers"
