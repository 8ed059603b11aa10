"""ADXL355: three-axis accelerometer, 20 bit (data sheet ADXL354/355 Rev. D, register map); and the coarser ADXL357."""

from collections import deque
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from sim.devices.i2c_chip import RegisterChip
from sim.devices.sampling import Sampler

STATUS, FIFO_ENTRIES, TEMP2, TEMP1, XDATA3, ZDATA1, FIFO_DATA = 0x04, 0x05, 0x06, 0x07, 0x08, 0x10, 0x11
OFFSET_X_H, FILTER, FIFO_SAMPLES, RANGE, POWER_CTL, SELF_TEST, RESET, SHADOW = (
    *(0x1E, 0x28, 0x29, 0x2C, 0x2D, 0x2E, 0x2F),
    0x50,
)
IDENTITY = {0x00: 0xAD, 0x01: 0x1D, 0x02: 0xED, 0x03: 0x01}
DEFAULTS = {FIFO_SAMPLES: 0x60, RANGE: 0x81, POWER_CTL: 0x01}
WRITABLE = range(OFFSET_X_H, SELF_TEST + 1)
STANDBY_ONLY = range(OFFSET_X_H, FILTER + 1)
DATA_READY, FIFO_FULL, FIFO_OVERRUN, NVM_BUSY = 0x01, 0x02, 0x04, 0x10
STANDBY, TEMPERATURE_OFF = 0x01, 0x02
RESET_CODE = 0x52
RESET_S = 0.030
"""Longer than the 5 ms that other drivers sleep: only NVM_BUSY tells when the trim is there."""
UNSETTLED_SAMPLES = 3
FIFO_LOCATIONS = 96
LSB_G = 1 / 256_000
ODR_MAX_HZ = 4000.0
CORNER = 4.0  # output data rate over low-pass corner
SELF_TEST_G = np.array([0.3, 0.3, 1.5])


class Adxl355(RegisterChip):
    """The chip, measuring ``acceleration_g()`` (3,) in its own axes, +1 along an axis that points up.

    ``noise_density_g`` is in g per square root of hertz. Offsets and drift belong to ``acceleration_g``.
    """

    lsb_g = LSB_G
    """At the smallest range."""

    def __init__(
        self,
        acceleration_g: Callable[[], NDArray[np.float64]],
        temperature_c: Callable[[], float],
        *,
        clock: Callable[[], float],
        rng: np.random.Generator,
        noise_density_g: float = 22.5e-6,
        address: int = 0x1D,
    ) -> None:
        super().__init__(address)
        self._acceleration_g = acceleration_g
        self._temperature_c = temperature_c
        self._clock = clock
        self._rng = rng
        self._shadow = bytes(rng.integers(1, 256, 5, dtype=np.uint8))
        self._sampler = Sampler(noise_density_g, rng, UNSETTLED_SAMPLES)
        self._reset()
        self._busy_until_s = clock()

    def power_cycle(self) -> None:
        """Reset, as after a drop of the supply voltage."""
        self._reset()

    def _reset(self) -> None:
        self._registers = dict(DEFAULTS)
        self._data = bytes(9)
        self._temperature = 0
        self._ready = self._overrun = False
        self._fifo: deque[bytes] = deque(maxlen=FIFO_LOCATIONS)
        self._fifo_byte = 0
        self._busy_until_s = self._clock() + RESET_S

    def _wake(self) -> None:
        if self._registers[POWER_CTL] & STANDBY:
            return
        truth = self._acceleration_g() + SELF_TEST_G * (self._registers.get(SELF_TEST, 0) & 0x03 == 0x03)
        if self._registers.get(FILTER, 0) & 0x70:
            truth = np.zeros(3)  # the high-pass takes gravity away
        for sample in self._sampler.take(self._clock(), truth):
            self._data = self._encode(sample)
            self._ready = True
            self._overrun |= len(self._fifo) >= FIFO_LOCATIONS
            for axis in range(3):
                word = bytearray(self._data[3 * axis : 3 * axis + 3])
                word[2] |= axis == 0
                self._fifo.append(bytes(word))
        if not self._registers[POWER_CTL] & TEMPERATURE_OFF:
            reading = 1885 - 9.05 * (self._temperature_c() - 25.0) + self._rng.normal(0.0, 1.0)
            self._temperature = int(np.clip(round(reading), 0, 4095))

    def _encode(self, acceleration_g: NDArray[np.float64]) -> bytes:
        lsb_g = self.lsb_g * 2 ** ((self._registers[RANGE] & 0x03) - 1)
        data = b""
        for axis, value in enumerate(acceleration_g):
            high, low = (self._registers.get(OFFSET_X_H + 2 * axis + i, 0) for i in range(2))
            offset = int.from_bytes(bytes([high, low]), "big", signed=True) * 16
            counts = int(np.clip(round(value / lsb_g) + offset, -(2**19), 2**19 - 1))
            data += (counts << 4 & 0xFFFFFF).to_bytes(3, "big")
        return data

    def _read(self, register: int) -> int:
        if register in IDENTITY:
            return IDENTITY[register]
        if self._clock() < self._busy_until_s:
            return NVM_BUSY if register == STATUS else 0
        if register == STATUS:
            full = FIFO_FULL * (len(self._fifo) >= self._registers[FIFO_SAMPLES])
            overrun, self._overrun = self._overrun, False
            return DATA_READY * self._ready | full | FIFO_OVERRUN * overrun
        if register == FIFO_ENTRIES:
            return len(self._fifo)
        if register == FIFO_DATA:
            return self._next_fifo_byte()
        if XDATA3 <= register <= ZDATA1:
            self._ready = False
            return self._data[register - XDATA3]
        if SHADOW <= register < SHADOW + len(self._shadow):
            return self._shadow[register - SHADOW]
        return {TEMP2: self._temperature >> 8, TEMP1: self._temperature & 0xFF}.get(
            register, self._registers.get(register, 0)
        )

    def _next_fifo_byte(self) -> int:
        """Three bytes a location; the marker bits tell the X axis (bit 0) and an empty FIFO (bit 1)."""
        word = self._fifo[0] if self._fifo else b"\x00\x00\x02"
        byte = word[self._fifo_byte]
        self._fifo_byte = (self._fifo_byte + 1) % 3
        if self._fifo_byte == 0 and self._fifo:
            self._fifo.popleft()
        return byte

    def _increments(self, register: int) -> bool:
        return register != FIFO_DATA

    def _write(self, register: int, value: int) -> None:
        measuring = not self._registers[POWER_CTL] & STANDBY
        if register == RESET and value == RESET_CODE:
            self._reset()
        elif register in WRITABLE and not (measuring and register in STANDBY_ONLY):
            self._registers[register] = value
            if register == POWER_CTL and not value & STANDBY:
                rate_hz = ODR_MAX_HZ / 2 ** min(self._registers.get(FILTER, 0) & 0x0F, 10)
                self._sampler.start(self._clock(), rate_hz, CORNER)


class Adxl357(Adxl355):
    """ADXL357: the same registers and identity, ranges of 10, 20 and 40 g (data sheet ADXL356/357 Rev. A, 51,200 LSB/g)."""

    lsb_g = 1 / 51_200
