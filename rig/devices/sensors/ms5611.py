"""MS5611-01BA03 and MS5607-02BA03, barometers (TE, data sheets 06/2017 for the compensation, AN520 for the checksum).

Both have the same commands and address but different factors, and their memory does not distinguish them. Only the
pressure, wrong by a factor of two, shows that the other one is fitted (``rig.attitude.altitude_plausibility``).
"""

import struct
from dataclasses import dataclass
from typing import Literal

from rig import timebase
from rig.clock import Instant
from rig.devices.bus.i2c import I2cBus
from rig.devices.bus.i2c_chip import I2cChip
from rig.devices.closing import ClosedOnExit
from rig.devices.readings import PressureReading
from rig.devices.sensors.sampling import read_for, require_noise
from rig.errors import WrongDeviceError

DEFAULT_ADDRESS = 0x77

_RESET = 0x1E
_READ_PROM = 0xA0
_CONVERT_PRESSURE_4096 = 0x48
_CONVERT_TEMPERATURE_4096 = 0x58
_READ_ADC = 0x00

_RESET_S = 0.005
_CONVERSION_S = 0.010  # 9.04 ms at most; an earlier read invalidates the conversion
_BMP3_IDENTITIES = (0x60, 0x50)


@dataclass(frozen=True)
class Coefficients:
    """C1 to C6 of the data sheet."""

    c1: int
    c2: int
    c3: int
    c4: int
    c5: int
    c6: int


def crc4(prom: bytes) -> int:
    """The checksum over the eight words of the PROM; its own position, the last four bits, counts as zero."""
    remainder = 0
    for byte in prom[:15] + b"\x00":
        remainder ^= byte
        for _ in range(8):
            remainder = (remainder << 1 ^ 0x3000 if remainder & 0x8000 else remainder << 1) & 0xFFFF
    return remainder >> 12


@dataclass(frozen=True)
class Factors:
    """Factors in which the two chips differ: powers of two and, below 20 °C and -15 °C, integer factors."""

    offset: int
    offset_slope: int
    sensitivity: int
    sensitivity_slope: int
    cold_offset_16: int
    cold_sensitivity_4: int
    very_cold_offset: int
    very_cold_sensitivity_2: int


FACTORS = {
    "ms5611": Factors(16, 7, 15, 8, 40, 5, 7, 11),
    "ms5607": Factors(17, 6, 16, 7, 61, 8, 15, 16),
}


def compensate(
    c: Coefficients, raw_pressure: int, raw_temperature: int, model: Literal["ms5611", "ms5607"] = "ms5611"
) -> tuple[int, int]:
    """Pressure in Pa and temperature in 0.01 °C from D1 and D2, second order below 20 °C."""
    f = FACTORS[model]
    dt = raw_temperature - (c.c5 << 8)
    temperature = 2000 + (dt * c.c6 >> 23)
    offset = (c.c2 << f.offset) + (c.c4 * dt >> f.offset_slope)
    sensitivity = (c.c1 << f.sensitivity) + (c.c3 * dt >> f.sensitivity_slope)
    if temperature < 2000:
        below_20 = (temperature - 2000) ** 2
        below_minus_15 = (temperature + 1500) ** 2 if temperature < -1500 else 0
        offset -= (f.cold_offset_16 * below_20 >> 4) + f.very_cold_offset * below_minus_15
        sensitivity -= (f.cold_sensitivity_4 * below_20 >> 2) + (
            f.very_cold_sensitivity_2 * below_minus_15 >> 1
        )
        temperature -= dt * dt >> 31
    return (raw_pressure * sensitivity >> 21) - offset >> 15, temperature


class Ms5611(ClosedOnExit):
    """MS5611-01BA03 or MS5607-02BA03 by TE Connectivity, a barometer: idle between readings.

    Parameters
    ----------
    bus : I2cBus
        From `open_i2c`; ``close`` gives it back.
    address : int
        0x77, or 0x76 with the pin CSB high.
    model : {"ms5611", "ms5607"}
        Which of the two is fitted. The chip does not tell: of the wrong one the pressure is twice or half of what it is.

    Raises
    ------
    WrongDeviceError
        A BMP390 or BMP388 answers, which have the same addresses.
    TransientError
        The chip does not answer, or takes too long.
    DeviceError
        The checksum of the factory calibration is wrong, or there is none.

    Notes
    -----
    Data sheets 06/2017: conversions with 4096-fold oversampling (0x48, 0x58), second-order compensation below 20 °C; AN520 for
    the checksum.

    Examples
    --------
    >>> import rig
    >>> with rig.open_chip(rig.Ms5611, i2c_bus, 0x77) as chip:  # i2c_bus = "/dev/i2c-1"
    ...     reading = chip.read()
    >>> print(f"{reading.pressure_hpa:.0f} hPa at {reading.temperature_c:.0f} °C")
    900 hPa at 20 °C
    """

    def __init__(
        self, bus: I2cBus, address: int = DEFAULT_ADDRESS, *, model: Literal["ms5611", "ms5607"] = "ms5611"
    ) -> None:
        self._chip = I2cChip(bus, address, model.upper())
        self._model: Literal["ms5611", "ms5607"] = model
        self._require_no_bmp3()
        self._chip.transfer(bytes([_RESET]))
        timebase.sleep(_RESET_S)
        prom = b"".join(self._chip.read_register(_READ_PROM + 2 * word, 2) for word in range(8))
        if crc4(prom) != prom[15] & 0x0F:
            raise self._chip.broken("the checksum of its factory calibration is wrong")
        coefficients = struct.unpack(">6H", prom[2:14])
        if 0 in coefficients:  # an empty PROM has a valid checksum
            raise self._chip.broken("has no factory calibration")
        self._coefficients = Coefficients(*coefficients)

    def _require_no_bmp3(self) -> None:
        # It has no identity of its own. To this chip 0x00 is a reading of the ADC, which is 0 without a
        # conversion.
        found = self._chip.read_register(_READ_ADC)[0]
        if found in _BMP3_IDENTITIES:
            problem = (
                f"is a {'BMP390' if found == _BMP3_IDENTITIES[0] else 'BMP388'}, which has the same addresses"
            )
            raise WrongDeviceError(self._chip.name, problem, "correct the chip or `address`")

    def identify(self) -> str:
        """Model, address and bus."""
        return self._chip.name

    def read(self) -> PressureReading:
        """One conversion of each, some 20 ms.

        Returns
        -------
        PressureReading
            With the chip's temperature.

        Raises
        ------
        TransientError
            A conversion was spoilt, or cannot be true.
        """
        raw_temperature = self._convert(_CONVERT_TEMPERATURE_4096)
        raw_pressure = self._convert(_CONVERT_PRESSURE_4096)
        at = Instant.now()
        pressure_pa, temperature = compensate(self._coefficients, raw_pressure, raw_temperature, self._model)
        if not (30_000 <= pressure_pa <= 120_000 and -4000 <= temperature <= 8500):
            raise self._chip.implausible(f"{pressure_pa / 100:.0f} hPa at {temperature / 100:.0f} °C")
        return PressureReading(pressure_pa / 100, temperature / 100, at.monotonic_s, at.utc)

    def _convert(self, command: int) -> int:
        self._chip.transfer(bytes([command]))
        timebase.sleep(_CONVERSION_S)
        value = int.from_bytes(self._chip.read_register(_READ_ADC, 3), "big")
        if value == 0:
            raise self._chip.implausible("a conversion that was not finished or was read twice")
        return value

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
        require_noise(self._chip.name, [(r.pressure_hpa, r.temperature_c) for r in readings])
        return readings

    def close(self) -> None:
        """Close the bus handle; the chip is idle."""
        self._chip.release()
