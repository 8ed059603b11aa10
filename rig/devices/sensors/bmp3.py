"""BMP390 and BMP388, barometers (Bosch, BST-BMP390-DS002-07 section 8 for the compensation)."""

import struct
from dataclasses import dataclass
from typing import Literal

from rig import timebase
from rig.clock import Instant
from rig.devices.bus.deadline import Deadline, wait_until
from rig.devices.bus.i2c import I2cBus
from rig.devices.bus.i2c_chip import I2cChip
from rig.devices.closing import ClosedOnExit
from rig.devices.readings import PressureReading
from rig.devices.sensors.sampling import read_for, require_noise

FROZEN_REPEATS = 8
DEFAULT_ADDRESS = 0x76

_CHIP_ID = 0x00
_ERR_REG = 0x02
_STATUS = 0x03
_DATA = 0x04  # pressure, temperature: shadowed against change only within one burst
_EVENT = 0x10
_PWR_CTRL = 0x1B
_OSR = 0x1C
_CONFIG = 0x1F
_TRIM = 0x31
_CMD = 0x7E

_IDENTITIES = {"bmp390": 0x60, "bmp388": 0x50}
_POWER_ON = 0x01
_COMMAND_READY = 0x10
_BOTH_READY = 0x60
_SOFT_RESET = 0xB6
_FORCED = 0x13  # one conversion of both
_PRESSURE_16_TEMPERATURE_2 = 1 << 3 | 4
_FILTER_OFF = 0x00
_NO_CONVERSION_YET = 0x800000
_ERRORS = {0x01: "fatal error", 0x02: "command error", 0x04: "configuration error"}

_RESET_S = 0.005
_CONVERSION_S = (234 + 392 + 16 * 2020 + 163 + 2 * 2020) * 1e-6
_POLL_S = 0.005
_TIMEOUT_S = 0.3


@dataclass(frozen=True)
class Trim:
    """The factory's compensation coefficients, scaled to floating point (data sheet 8.4)."""

    t: tuple[float, float, float]
    p: tuple[float, ...]  # P1 to P11

    @classmethod
    def decode(cls, data: bytes) -> "Trim":
        """From the 21 bytes of registers 0x31 to 0x45."""
        t1, t2, t3, p1, p2, p3, p4, p5, p6, p7, p8, p9, p10, p11 = struct.unpack("<HHbhhbbHHbbhbb", data)
        return cls(
            (t1 * 2.0**8, t2 / 2.0**30, t3 / 2.0**48),
            (
                (p1 - 2.0**14) / 2.0**20,
                (p2 - 2.0**14) / 2.0**29,
                p3 / 2.0**32,
                p4 / 2.0**37,
                p5 * 2.0**3,
                p6 / 2.0**6,
                p7 / 2.0**8,
                p8 / 2.0**15,
                p9 / 2.0**48,
                p10 / 2.0**48,
                p11 / 2.0**65,
            ),
        )


def compensate(trim: Trim, raw_pressure: int, raw_temperature: int) -> tuple[float, float]:
    """Pressure in Pa and temperature in °C from the two raw values (data sheet 8.5 and 8.6)."""
    t1, t2, t3 = trim.t
    p1, p2, p3, p4, p5, p6, p7, p8, p9, p10, p11 = trim.p
    d = raw_temperature - t1
    t = d * t2 + d * d * t3
    u = float(raw_pressure)
    offset = p5 + t * (p6 + t * (p7 + t * p8))
    slope = p1 + t * (p2 + t * (p3 + t * p4))
    return offset + u * slope + u * u * (p9 + p10 * t) + u**3 * p11, t


class Bmp3(ClosedOnExit):
    """BMP390 or BMP388 by Bosch, a barometer: asleep between readings.

    Parameters
    ----------
    bus : I2cBus
        From `open_i2c`; ``close`` gives it back.
    address : int
        0x76, or 0x77 with the pin SDO high.
    model : {"bmp390", "bmp388"}
        Which of the two is fitted.

    Raises
    ------
    WrongDeviceError
        Another chip answers, the other one of the two as well.
    TransientError
        The chip does not answer, or takes too long.
    DeviceError
        The chip has no factory trim.

    Notes
    -----
    BST-BMP390-DS002-07: sixteen-fold oversampling of the pressure, twofold of the temperature, no filter (section 3.5); the
    compensation is that of section 8, in floating point.

    Examples
    --------
    >>> import rig
    >>> with rig.open_chip(rig.Bmp3, i2c_bus, 0x76) as chip:  # i2c_bus = "/dev/i2c-1"
    ...     reading = chip.read()
    >>> print(f"{reading.pressure_hpa:.0f} hPa at {reading.temperature_c:.0f} °C")
    900 hPa at 20 °C
    """

    def __init__(
        self, bus: I2cBus, address: int = DEFAULT_ADDRESS, *, model: Literal["bmp390", "bmp388"] = "bmp390"
    ) -> None:
        self._chip = I2cChip(bus, address, model.upper())
        hint = "0x60 is a BMP390, 0x50 a BMP388, 0x00 often an MS5611, which has the same addresses"
        self._chip.require_identity(_CHIP_ID, _IDENTITIES[model], hint)
        self._await(_COMMAND_READY, "the start")
        self._chip.write_register(_CMD, _SOFT_RESET)
        timebase.sleep(_RESET_S)
        self._await(_COMMAND_READY, "the reset")
        trim = self._chip.read_register(_TRIM, 21)
        if len(set(trim)) == 1:
            raise self._chip.broken("has no factory trim")
        self._trim = Trim.decode(trim)
        self._chip.write_register(_OSR, _PRESSURE_16_TEMPERATURE_2)
        self._chip.write_register(_CONFIG, _FILTER_OFF)
        self._chip.read_register(_EVENT)  # reading clears what the reset above left there

    def identify(self) -> str:
        """Model, address and bus."""
        return self._chip.name

    def read(self) -> PressureReading:
        """One conversion, some 40 ms.

        Returns
        -------
        PressureReading
            With the chip's temperature.

        Raises
        ------
        TransientError
            The conversion does not end, or cannot be true.
        DeviceError
            The chip reports an error of its own.
        """
        if self._chip.read_register(_EVENT)[0] & _POWER_ON:
            raise self._chip.implausible("it has restarted and lost its configuration")
        self._chip.write_register(_PWR_CTRL, _FORCED)
        timebase.sleep(_CONVERSION_S)
        self._await(_BOTH_READY, "a conversion")
        data = self._chip.read_register(_DATA, 6)
        at = Instant.now()
        self._require_no_error()
        raw_pressure, raw_temperature = (int.from_bytes(data[i : i + 3], "little") for i in (0, 3))
        if _NO_CONVERSION_YET in (raw_pressure, raw_temperature):
            raise self._chip.implausible("the value of a chip that has not measured yet")
        pressure_pa, temperature_c = compensate(self._trim, raw_pressure, raw_temperature)
        if not (30_000 <= pressure_pa <= 125_000 and -40 <= temperature_c <= 85):
            raise self._chip.implausible(f"{pressure_pa / 100:.0f} hPa at {temperature_c:.0f} °C")
        return PressureReading(pressure_pa / 100, temperature_c, at.monotonic_s, at.utc)

    def _await(self, bits: int, what: str) -> None:
        def ready() -> bool:
            return self._chip.read_register(_STATUS)[0] & bits == bits

        if not wait_until(ready, Deadline.after(_TIMEOUT_S), _POLL_S):
            raise self._chip.no_answer_in_time(what, _TIMEOUT_S)

    def _require_no_error(self) -> None:
        errors = self._chip.read_register(_ERR_REG)[0]
        reported = [text for bit, text in _ERRORS.items() if errors & bit]
        if reported:
            raise self._chip.broken(f"reports a {' and a '.join(reported)}")

    def read_many(self, duration_s: float) -> list[PressureReading]:
        """Read for some time.

        Parameters
        ----------
        duration_s : float
            For how long, in seconds.

        Returns
        -------
        list of PressureReading
            In order, at least one.

        Raises
        ------
        TransientError
            A reading does not come, or cannot be true.
        DeviceError
            All readings are the same: the chip is frozen.
        """
        readings = read_for(self.read, duration_s)
        require_noise(self._chip.name, [(r.pressure_hpa, r.temperature_c) for r in readings], FROZEN_REPEATS)
        return readings

    def close(self) -> None:
        """Close the bus handle; the chip is in sleep mode."""
        self._chip.release()
