"""A chip on an I2C bus: registers and commands, with errors that name the chip."""

from collections.abc import Callable
from typing import TypeVar

from rig.devices.bus.i2c import I2cBus, open_i2c
from rig.devices.bus.i2c_errors import held_by_driver, transfer_error
from rig.errors import DeviceError, TransientError, WrongDeviceError

Chip = TypeVar("Chip")


def open_chip(driver: Callable[[I2cBus, int], Chip], url: str, address: int) -> Chip:
    """Open the driver of one chip on an I2C bus; the bus is given back where the driver refuses the chip.

    Parameters
    ----------
    driver : callable
        `Adxl355`, `Iis2iclx`, `Mmc5983ma`, `Bmp3`, `Ms5611`, or ``functools.partial`` of one of them.
    url : str
        The bus, as for `open_i2c`.
    address : int
        Of the chip, 7 bits.

    Returns
    -------
    driver
        Set up, to be closed, or used in a ``with`` block.

    Raises
    ------
    ConfigError
        ``url`` names no bus.
    WrongDeviceError
        Another chip answers.
    TransientError
        The chip does not answer.
    DeviceError
        The bus cannot be opened, or a driver of the Linux kernel holds the chip: both would set it up and take each other's
        samples.

    Examples
    --------
    >>> import rig
    >>> with rig.open_chip(rig.Adxl355, i2c_bus, 0x1D) as chip:  # i2c_bus = "/dev/i2c-1"
    ...     print(chip.identify())
    ADXL355 at 0x1D on ..., revision 1

    A driver with an option:

    >>> from functools import partial
    >>> with rig.open_chip(partial(rig.Ms5611, model="ms5611"), i2c_bus, 0x77) as chip:
    ...     print(f"{chip.read().pressure_hpa:.0f} hPa")
    900 hPa
    """
    bus = open_i2c(url)
    try:
        held = held_by_driver(str(bus), address)
        if held:
            raise DeviceError(f"chip at 0x{address:02X} on {bus}", *held)
        return driver(bus, address)
    except BaseException:
        bus.close()
        raise


class I2cChip:
    """One chip at one address. Every bus failure becomes a ``DeviceError`` that names the chip, usually a
    ``TransientError``.
    """

    def __init__(self, bus: I2cBus, address: int, model: str) -> None:
        self._bus = bus
        self._address = address
        self.name = f"{model} at 0x{address:02X} on {bus}"

    def transfer(self, write: bytes, read_length: int = 0) -> bytes:
        """One transaction of exactly ``read_length`` bytes; ``TransientError``, or ``DeviceError`` for a lasting
        failure.
        """
        try:
            data = self._bus.transfer(self._address, write, read_length)
        except OSError as error:
            raise transfer_error(
                error, self.name, str(self._bus), self._address, len(write), read_length
            ) from error
        if len(data) != read_length:
            raise TransientError(self.name, f"gave {len(data)} of {read_length} bytes", "check the wiring")
        return data

    def read_register(self, register: int, length: int = 1) -> bytes:
        """``length`` bytes from ``register`` on, in one burst."""
        return self.transfer(bytes([register]), length)

    def write_register(self, register: int, value: int) -> None:
        """One byte into ``register``."""
        self.transfer(bytes([register, value]))

    def require_identity(self, register: int, expected: int, hint: str = "") -> None:
        """Raise ``WrongDeviceError`` unless ``register`` holds ``expected``; ``hint`` says what else it may be.
        ``TransientError`` if its value changes between reads: bad wiring.
        """
        found = self.read_register(register)[0]
        if found != expected:
            if self.read_register(register)[0] != found:
                raise self.implausible("the identity is another one with each reading")
            problem = f"identity register 0x{register:02X} holds 0x{found:02X} instead of 0x{expected:02X}"
            raise WrongDeviceError(
                self.name, problem + (f" ({hint})" if hint else ""), "correct the chip or `address`"
            )

    def implausible(self, what: str) -> TransientError:
        """The error of an impossible reading: one bad transfer or, if it persists, a broken chip."""
        return TransientError(
            self.name, f"implausible reading: {what}", "check the wiring; replace the chip if it stays"
        )

    def no_answer_in_time(self, what: str, seconds: float) -> TransientError:
        """The error of a chip that did not finish in time."""
        return TransientError(self.name, f"{what} took longer than {seconds:g} s", "power-cycle the chip")

    def broken(self, problem: str) -> DeviceError:
        """The error of a chip that answers but does not work."""
        return DeviceError(self.name, problem, "power-cycle it; replace it if that does not help")

    def release(self) -> None:
        """Close the bus handle."""
        self._bus.close()
