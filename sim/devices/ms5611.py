"""MS5611-01BA03 and MS5607-02BA03: barometers with commands instead of registers (data sheets 06/2017)."""

from collections.abc import Callable

import numpy as np

RESET, READ_ADC, CONVERT_PRESSURE, CONVERT_TEMPERATURE, READ_PROM = 0x1E, 0x00, 0x40, 0x50, 0xA0
CONVERSION_S = {0: 0.0006, 2: 0.00117, 4: 0.00228, 6: 0.00454, 8: 0.00904}  # the data sheet's longest
RESET_S = 0.0028
COEFFICIENTS = (40127, 36924, 23317, 23282, 33464, 28312)
COEFFICIENTS_5607 = (46372, 43981, 29059, 27842, 31553, 28165)
FULL_SCALE = 1 << 24


def crc4(words: list[int]) -> int:
    """CRC of the eight words of the PROM, the low byte of the last one left out (AN520)."""
    data = b"".join(word.to_bytes(2, "big") for word in [*words[:7], words[7] & 0xFF00])
    remainder = 0
    for byte_pair in range(0, 16, 2):
        for shift in (0, 1):
            remainder ^= data[byte_pair + shift]
            for _ in range(8):
                remainder = (remainder << 1 ^ 0x3000 if remainder & 0x8000 else remainder << 1) & 0xFFFF
    return remainder >> 12


def compensate(pressure_raw: int, temperature_raw: int, c: tuple[int, ...] = COEFFICIENTS) -> tuple[int, int]:
    """Temperature (0.01 C) and pressure (Pa), first and second order, in whole numbers (data sheet)."""
    difference = temperature_raw - c[4] * 2**8
    first_order = 2000 + difference * c[5] // 2**23
    offset = c[1] * 2**16 + c[3] * difference // 2**7
    sensitivity = c[0] * 2**15 + c[2] * difference // 2**8
    temperature = first_order
    if first_order < 2000:
        cold = (first_order - 2000) ** 2
        temperature -= difference**2 // 2**31
        offset_2, sensitivity_2 = 5 * cold // 2, 5 * cold // 4
        if first_order < -1500:
            very_cold = (first_order + 1500) ** 2
            offset_2 += 7 * very_cold
            sensitivity_2 += 11 * very_cold // 2
        offset -= offset_2
        sensitivity -= sensitivity_2
    return temperature, (pressure_raw * sensitivity // 2**21 - offset) // 2**15


def compensate_5607(
    pressure_raw: int, temperature_raw: int, c: tuple[int, ...] = COEFFICIENTS_5607
) -> tuple[int, int]:
    """The compensation of the MS5607."""
    difference = temperature_raw - c[4] * 2**8
    first_order = 2000 + difference * c[5] // 2**23
    offset = c[1] * 2**17 + c[3] * difference // 2**6
    sensitivity = c[0] * 2**16 + c[2] * difference // 2**7
    temperature = first_order
    if first_order < 2000:
        cold = (first_order - 2000) ** 2
        temperature -= difference**2 // 2**31
        offset -= 61 * cold // 2**4
        sensitivity -= 2 * cold
        if first_order < -1500:
            very_cold = (first_order + 1500) ** 2
            offset -= 15 * very_cold
            sensitivity -= 8 * very_cold
    return temperature, (pressure_raw * sensitivity // 2**21 - offset) // 2**15


def _smallest(reaches: Callable[[int], bool]) -> int:
    """The smallest raw reading for which ``reaches`` holds, which then holds for all larger ones."""
    low, high = 0, FULL_SCALE - 1
    while low < high:
        middle = (low + high) // 2
        low, high = (low, middle) if reaches(middle) else (middle + 1, high)
    return low


class Ms5611:
    """The chip, measuring ``pressure_pa()`` and ``temperature_c()``; ``noise_pa``: one sigma at OSR 4096."""

    coefficients = COEFFICIENTS
    compensate = staticmethod(compensate)

    def __init__(
        self,
        pressure_pa: Callable[[], float],
        temperature_c: Callable[[], float],
        *,
        clock: Callable[[], float],
        rng: np.random.Generator,
        noise_pa: float = 1.2,
        address: int = 0x77,
    ) -> None:
        self.address = address
        self._pressure_pa = pressure_pa
        self._temperature_c = temperature_c
        self._clock = clock
        self._rng = rng
        self._noise_pa = noise_pa
        words = [0x0051, *self.coefficients, 0x4500]
        self._prom = [*words[:7], words[7] | crc4(words)]
        self._answer = b""
        self._converted = 0
        self._done_s = 0.0
        self._deaf_until_s = clock()

    def transfer(self, write: bytes, read_length: int) -> bytes:
        """See ``I2cChip``. Does not acknowledge while its PROM reloads."""
        if self._clock() < self._deaf_until_s:
            raise OSError(121, "no acknowledge: reset under way")
        for command in write:
            self._command(command)
        answer, self._answer = self._answer, b""
        return (answer + bytes(read_length))[:read_length]

    def power_cycle(self) -> None:
        """Reset, as after a drop of the supply voltage."""
        self._command(RESET)

    def _command(self, command: int) -> None:
        if command == RESET:
            self._converted = 0
            self._deaf_until_s = self._clock() + RESET_S
        elif command == READ_ADC:
            self._answer = self._result().to_bytes(3, "big")
        elif command & 0xF0 == READ_PROM:
            self._answer = self._prom[command >> 1 & 0x07].to_bytes(2, "big")
        elif command & 0xF0 in (CONVERT_PRESSURE, CONVERT_TEMPERATURE) and command & 0x0F in CONVERSION_S:
            oversampling = command & 0x0F
            self._converted = self._convert(command & 0xF0, self._noise_pa * 2 ** ((8 - oversampling) / 4))
            self._done_s = self._clock() + CONVERSION_S[oversampling]

    def _convert(self, what: int, noise_pa: float) -> int:
        centi_c = round(self._temperature_c() * 100)
        raw_temperature = _smallest(lambda raw: self.compensate(0, raw)[0] >= centi_c)
        if what == CONVERT_TEMPERATURE:
            return raw_temperature
        pressure_pa = round(self._pressure_pa() + self._rng.normal(0.0, noise_pa))
        return _smallest(lambda raw: self.compensate(raw, raw_temperature)[1] >= pressure_pa)

    def _result(self) -> int:
        """The conversion's result, once; 0 if read too early, which invalidates it, or a second time."""
        result = self._converted if self._clock() >= self._done_s else 0
        self._converted = 0
        return result


class Ms5607(Ms5611):
    """The MS5607: the same commands, but raw values of another pressure."""

    coefficients = COEFFICIENTS_5607
    compensate = staticmethod(compensate_5607)
