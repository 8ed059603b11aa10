"""IIS2ICLX, two-axis inclinometer of 16 bits (STMicroelectronics, data sheet and AN5509).

At 52 Hz with the low-pass at a quarter of that, a mean over one second has a noise of 11 µg, or 0.0006° of tilt. The
range is ±1 g, for any tilt, where one count is 0.0018°; noise of two counts provides dither.
"""

import logging
import math
from functools import partial

from rig import timebase
from rig.clock import Instant
from rig.devices.bus.deadline import Deadline, wait_until
from rig.devices.bus.i2c import I2cBus
from rig.devices.bus.i2c_chip import I2cChip
from rig.devices.closing import ClosedOnExit
from rig.devices.readings import AccelerationReading
from rig.devices.sensors.sampling import MIN_READINGS, read_for, require_noise
from rig.errors import TransientError, WrongDeviceError
from rig.fault_notes import note_fault

_log = logging.getLogger(__name__)

DEFAULT_ADDRESS = 0x6A

_FUNC_CFG_ACCESS = 0x01  # there in every bank of registers
_WHO_AM_I = 0x0F
_CTRL1_XL = 0x10
_CTRL3_C = 0x12
_CTRL8_XL = 0x17
_STATUS = 0x1E
_OUT_TEMP = 0x20
_OUT_X = 0x28
_OUT_Z = 0x2C  # reserved in this chip, the third axis in related ones

_IDENTITY = 0x6B  # which is also one of its two addresses
_OTHER_BANKS = (0x80, 0x40)  # embedded functions, sensor hub
_USER_BANK = 0x00
_ODR_52_HZ = 3 << 4
_RANGE_1_G = 2 << 2  # the codes are not in order: 0 to 3 are 0.5, 3, 1 and 2 g
_G_PER_COUNT = {0.5: 0.015e-3, 1.0: 0.031e-3, 2.0: 0.061e-3, 3.0: 0.122e-3}
_LOW_PASS_2 = 1 << 1
_LOW_PASS_2_ODR_4 = 0x00
_BLOCK_DATA_UPDATE = 1 << 6
_AUTO_INCREMENT = 1 << 2
_SOFTWARE_RESET = 0x01
_ACCELERATION_READY = 0x01

_RANGE_G = 1.0
_RELATIVES_FACTOR = 0.122 / 0.031
"""ISM330DHCX, LSM6DSR and ASM330LHH have 0.122 mg per count where this chip, with the same setting, has 0.031."""

_MIN_Z_G = 0.3  # the chip lies flat in the head: a third axis has most of gravity
_SAMPLE_S = 1 / 52
_SETTLING_SAMPLES = 5
_RESET_POLL_S = 0.001
_READY_TIMEOUT_S = 0.5


def decode_acceleration_g(data: bytes, range_g: float) -> float:
    """Acceleration of one axis, g, from its two bytes (signed, low byte first); ranges are 0.5, 1, 2, 3 g."""
    return int.from_bytes(data, "little", signed=True) * _G_PER_COUNT[range_g]


def decode_temperature_c(data: bytes) -> float:
    """Degrees Celsius from the two bytes of OUT_TEMP."""
    return 25.0 + int.from_bytes(data, "little", signed=True) / 256.0


class Iis2iclx(ClosedOnExit):
    """IIS2ICLX by STMicroelectronics, an inclinometer of two axes and 16 bits: set up for ±1 g and 52 Hz, and measuring.

    Parameters
    ----------
    bus : I2cBus
        From `open_i2c`; ``close`` gives it back.
    address : int
        0x6A, or 0x6B with the pin SA0 high.

    Raises
    ------
    WrongDeviceError
        Another chip answers, a relative of three axes with the same identity too.
    TransientError
        The chip does not answer, or takes too long.
    DeviceError
        The bus is lost.

    Notes
    -----
    Data sheet and AN5509: WHO_AM_I (0x0F), output data rate, range and low-pass in CTRL1_XL (0x10), samples from OUTX_L_A
    (0x28) on. One count is 31 µg.

    Examples
    --------
    >>> import rig
    >>> with rig.open_chip(rig.Iis2iclx, i2c_bus, 0x6A) as chip:  # i2c_bus = "/dev/i2c-1"
    ...     reading = chip.read()
    >>> print(f"{reading.x_g:.2f} {reading.y_g:.2f} g, {reading.z_g}")
    0.00 0.00 g, None
    """

    def __init__(self, bus: I2cBus, address: int = DEFAULT_ADDRESS) -> None:
        self._chip = I2cChip(bus, address, "IIS2ICLX")
        self._leave_other_banks()
        self._chip.require_identity(_WHO_AM_I, _IDENTITY)
        self._chip.write_register(_CTRL3_C, _SOFTWARE_RESET)
        if not wait_until(self._reset_done, Deadline.after(_READY_TIMEOUT_S), _RESET_POLL_S):
            raise self._chip.no_answer_in_time("the reset", _READY_TIMEOUT_S)
        self._chip.write_register(_CTRL3_C, _BLOCK_DATA_UPDATE | _AUTO_INCREMENT)
        self._chip.write_register(_CTRL8_XL, _LOW_PASS_2_ODR_4)
        self._chip.write_register(_CTRL1_XL, _ODR_52_HZ | _RANGE_1_G | _LOW_PASS_2)
        timebase.sleep(_SETTLING_SAMPLES * _SAMPLE_S)
        self._require_two_axes(self._chip.read_register(_OUT_X, 4))

    def _leave_other_banks(self) -> None:
        """Select the user register bank, which another program may have left."""
        if self._chip.read_register(_WHO_AM_I)[0] == _IDENTITY:
            return
        if self._chip.read_register(_FUNC_CFG_ACCESS)[0] in _OTHER_BANKS:
            self._chip.write_register(_FUNC_CFG_ACCESS, _USER_BANK)

    def _require_two_axes(self, x_and_y: bytes) -> None:
        """Raise ``WrongDeviceError`` for a three-axis chip with the same identity, whose tilt would be a quarter."""
        try:
            z = self._chip.read_register(_OUT_Z, 2)
        except TransientError as error:  # what is reserved need not answer
            _log.debug("%s", error)
            return
        x_g, y_g, z_g = (
            decode_acceleration_g(data, _RANGE_G) * _RELATIVES_FACTOR
            for data in (x_and_y[:2], x_and_y[2:], z)
        )
        if abs(z_g) >= _MIN_Z_G and 0.9 <= math.hypot(x_g, y_g, z_g) <= 1.1:
            raise WrongDeviceError(
                self._chip.name,
                "has a third axis, and gravity in the scale of an ISM330DHCX, LSM6DSR or ASM330LHH, whose identity "
                "(0x6B) is the same",
                "fit an IIS2ICLX, or correct [inclinometer] chip and `address`",
            )

    def _reset_done(self) -> bool:
        return not self._chip.read_register(_CTRL3_C)[0] & _SOFTWARE_RESET

    def identify(self) -> str:
        """Model, address and bus."""
        return self._chip.name

    def read(self, *, without_temperature: bool = False) -> AccelerationReading:
        """The next sample, 19 ms after the last.

        Parameters
        ----------
        without_temperature : bool
            Take a sample whose temperature cannot be: it is NaN then, and noted.

        Returns
        -------
        AccelerationReading
            Of two axes, g, and the chip's temperature; ``z_g`` is None.

        Raises
        ------
        TransientError
            No sample comes, or one that no accelerometer at rest can give.
        """
        if not wait_until(self._sample_ready, Deadline.after(_READY_TIMEOUT_S), _SAMPLE_S / 4):
            raise self._chip.no_answer_in_time("a sample", _READY_TIMEOUT_S)
        data = self._chip.read_register(_OUT_X, 4)
        at = Instant.now()
        temperature_c = decode_temperature_c(self._chip.read_register(_OUT_TEMP, 2))
        x_g, y_g = (decode_acceleration_g(data[i : i + 2], _RANGE_G) for i in (0, 2))
        if not -40.0 <= temperature_c <= 105.0:
            if not without_temperature:
                raise self._chip.implausible(f"{temperature_c:.0f} °C")
            note_fault(
                self._chip.name, f"says {temperature_c:.0f} °C of itself", "went on without a temperature"
            )
            temperature_c = math.nan
        if max(abs(x_g), abs(y_g)) > _RANGE_G or math.hypot(x_g, y_g) > 1.2:
            raise self._chip.implausible(f"{x_g:.2f} g and {y_g:.2f} g")
        return AccelerationReading(x_g, y_g, None, temperature_c, at.monotonic_s, at.utc)

    def _sample_ready(self) -> bool:
        return bool(self._chip.read_register(_STATUS)[0] & _ACCELERATION_READY)

    def read_many(self, duration_s: float) -> list[AccelerationReading]:
        """Read for some time.

        Parameters
        ----------
        duration_s : float
            For how long, in seconds.

        Returns
        -------
        list of AccelerationReading
            In order, at least ten.

        Raises
        ------
        TransientError
            A reading does not come, or cannot be true.
        DeviceError
            All readings are the same: the chip is frozen.
        """
        readings = read_for(partial(self.read, without_temperature=True), duration_s, MIN_READINGS)
        require_noise(self._chip.name, [(r.x_g, r.y_g) for r in readings])
        return readings

    def close(self) -> None:
        """Power down and close the bus handle."""
        try:
            self._chip.write_register(_CTRL1_XL, 0)
        finally:
            self._chip.release()
