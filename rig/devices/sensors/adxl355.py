"""ADXL355, three-axis accelerometer of 20 bits, used as inclinometer (Analog Devices, data sheet Rev. D).

At 62.5 Hz the low-pass corner is at 15.6 Hz; a mean over one second has a noise of 16 µg, or 0.0009° of tilt.
"""

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
from rig.errors import WrongDeviceError
from rig.fault_notes import note_fault

DEFAULT_ADDRESS = 0x1D

_DEVID_AD = 0x00
_DEVID_MST = 0x01
_PARTID = 0x02
_REVID = 0x03
_STATUS = 0x04
_TEMP2 = 0x06  # TEMP2, TEMP1, XDATA3 ... ZDATA1: eleven bytes that one burst keeps together
_FILTER = 0x28
_RANGE = 0x2C
_POWER_CTL = 0x2D
_RESET = 0x2F
_SHADOW = 0x50

_IDENTITY = {_DEVID_AD: 0xAD, _DEVID_MST: 0x1D, _PARTID: 0xED}
_DATA_READY = 0x01
_NVM_BUSY = 0x10
_FILTER_62_5_HZ = 0x06
_RANGE_2_G = 0x81
_STANDBY = 0x01
_MEASURE = 0x00
_RESET_CODE = 0x52
_RESET_TRIES = 5
_RESET_S = 0.005

_G_PER_COUNT = 3.9e-6  # at ±2 g
_ADXL357_FACTOR = 5.0
"""The ADXL357 has the same identity, and 51,200 counts to 1 g where this chip has 256,000 (data sheet ADXL356/357 Rev. A)."""
_SAMPLE_S = 1 / 62.5
_SETTLING_SAMPLES = 4
_READY_TIMEOUT_S = 0.5


def decode_axis(data: bytes) -> int:
    """Counts of one axis from its three bytes: left-justified 20-bit two's complement, high byte first."""
    return int.from_bytes(data, "big", signed=True) >> 4


def decode_temperature_c(data: bytes) -> float:
    """Degrees Celsius from TEMP2 and TEMP1: 12 bits, unsigned, falling as it warms; the rest is reserved."""
    return 25.0 + ((int.from_bytes(data, "big") & 0x0FFF) - 1885) / -9.05


def _acceleration_g(data: bytes) -> tuple[float, float, float]:
    """The three axes from the eleven bytes of temperature and sample."""
    x, y, z = (decode_axis(data[i : i + 3]) for i in (2, 5, 8))
    return x * _G_PER_COUNT, y * _G_PER_COUNT, z * _G_PER_COUNT


class Adxl355(ClosedOnExit):
    """ADXL355 by Analog Devices, an accelerometer of three axes and 20 bits: set up for ±2 g and 62.5 Hz, and measuring.

    Parameters
    ----------
    bus : I2cBus
        From `open_i2c`; ``close`` gives it back.
    address : int
        0x1D, or 0x53 with the pin ASEL high.

    Raises
    ------
    WrongDeviceError
        Another chip answers, an ADXL357 too, which shows gravity in another scale.
    TransientError
        The chip does not answer, or takes too long.
    DeviceError
        The chip loses its factory trim when it is reset.

    Notes
    -----
    Data sheet Rev. D: the identity is in registers 0x00 to 0x02, the low-pass of 15.6 Hz in FILTER (0x28), the range in RANGE
    (0x2C); temperature and sample are read in one burst from TEMP2 (0x06) on. One count is 3.9 µg.

    Examples
    --------
    >>> import rig
    >>> with rig.open_chip(rig.Adxl355, i2c_bus, 0x1D) as chip:  # i2c_bus = "/dev/i2c-1"
    ...     one = chip.read()
    ...     some = chip.read_many(0.2)
    >>> print(f"{one.x_g:.2f} {one.y_g:.2f} {one.z_g:.2f} g at {one.temperature_c:.0f} °C")
    0.00 0.00 1.00 g at 20 °C
    >>> len(some) > 5
    True
    """

    def __init__(self, bus: I2cBus, address: int = DEFAULT_ADDRESS) -> None:
        self._chip = I2cChip(bus, address, "ADXL355")
        for register, value in _IDENTITY.items():
            self._chip.require_identity(
                register, value, "0xE9 in 0x02 is an ADXL359" if register == _PARTID else ""
            )
        self._reset()
        self._chip.write_register(_FILTER, _FILTER_62_5_HZ)
        self._chip.write_register(_RANGE, _RANGE_2_G)
        self._chip.write_register(_POWER_CTL, _MEASURE)
        timebase.sleep(_SETTLING_SAMPLES * _SAMPLE_S)
        self._require_its_scale(self._chip.read_register(_TEMP2, 11))

    def _require_its_scale(self, sample: bytes) -> None:
        """Raise ``WrongDeviceError`` if gravity is measured as an ADXL357 would."""
        size_g = math.hypot(*_acceleration_g(sample))
        if 0.9 <= size_g * _ADXL357_FACTOR <= 1.1:
            raise WrongDeviceError(
                self._chip.name,
                f"shows gravity as {size_g:.3f} g, in the scale of an ADXL357 (±10 to ±40 g), whose identity is the same",
                "fit an ADXL355",
            )

    def _reset(self) -> None:
        # The trim values in the shadow registers are sometimes not loaded by a reset; Linux repeats it, too.
        self._wait_for_trim()  # of a chip that has just been switched on
        before = self._chip.read_register(_SHADOW, 5)
        for _ in range(_RESET_TRIES):
            self._chip.write_register(_RESET, _RESET_CODE)
            timebase.sleep(_RESET_S)
            if self._wait_for_trim() and self._chip.read_register(_SHADOW, 5) == before:
                return
        raise self._chip.broken("loses its factory trim when it is reset")

    def _wait_for_trim(self) -> bool:
        """Whether the trim was loaded from the non-volatile memory in time."""
        return wait_until(lambda: not self._status() & _NVM_BUSY, Deadline.after(_READY_TIMEOUT_S), _RESET_S)

    def _status(self) -> int:
        return self._chip.read_register(_STATUS)[0]

    def identify(self) -> str:
        """Model, revision, address and bus."""
        return f"{self._chip.name}, revision {self._chip.read_register(_REVID)[0]}"

    def read(self, *, without_temperature: bool = False) -> AccelerationReading:
        """The next sample, 16 ms after the last.

        Parameters
        ----------
        without_temperature : bool
            Take a sample whose temperature cannot be: it is NaN then, and noted.

        Returns
        -------
        AccelerationReading
            Of three axes, g, and the chip's temperature.

        Raises
        ------
        TransientError
            No sample comes, or one that no accelerometer at rest can give.
        """
        ready = wait_until(
            lambda: bool(self._status() & _DATA_READY), Deadline.after(_READY_TIMEOUT_S), _SAMPLE_S / 4
        )
        if not ready:
            raise self._chip.no_answer_in_time("a sample", _READY_TIMEOUT_S)
        data = self._chip.read_register(_TEMP2, 11)
        at = Instant.now()
        temperature_c = decode_temperature_c(data[:2])
        x_g, y_g, z_g = _acceleration_g(data)
        if not -40.0 <= temperature_c <= 125.0:
            if not without_temperature:
                raise self._chip.implausible(f"{temperature_c:.0f} °C")
            note_fault(
                self._chip.name, f"says {temperature_c:.0f} °C of itself", "went on without a temperature"
            )
            temperature_c = math.nan
        if not 0.5 <= math.hypot(x_g, y_g, z_g) <= 1.5:
            raise self._chip.implausible(f"{math.hypot(x_g, y_g, z_g):.2f} g in all")
        return AccelerationReading(x_g, y_g, z_g, temperature_c, at.monotonic_s, at.utc)

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
        require_noise(self._chip.name, [(r.x_g, r.y_g, r.z_g) for r in readings])
        return readings

    def close(self) -> None:
        """Enter standby and close the bus handle."""
        try:
            self._chip.write_register(_POWER_CTL, _STANDBY)
        finally:
            self._chip.release()
