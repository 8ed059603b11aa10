"""BMP390 and BMP388: barometers (data sheet BST-BMP390-DS002). The compensation is inverted numerically."""

import struct
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from sim.devices.i2c_chip import RegisterChip

CHIP_ID, REV_ID, ERROR, STATUS, DATA, SENSOR_TIME, EVENT, INT_STATUS = (
    *(0x00, 0x01, 0x02, 0x03, 0x04),
    *(0x0C, 0x10, 0x11),
)
IF_CONF, PWR_CTRL, OSR, ODR, CONFIG, TRIM, COMMAND = 0x1A, 0x1B, 0x1C, 0x1D, 0x1F, 0x31, 0x7E
CHIP_IDS = {"bmp390": 0x60, "bmp388": 0x50}
COMMAND_READY, PRESSURE_READY, TEMPERATURE_READY = 0x10, 0x20, 0x40
CONFIGURATION_ERROR = 0x04
PRESSURE_ENABLE, TEMPERATURE_ENABLE, NORMAL_MODE = 0x01, 0x02, 0x30
SOFT_RESET, FLUSH_FIFO = 0xB6, 0xB0
START_UP_S = 0.010
"""Longer than the data sheet's 2 ms: only cmd_rdy tells when commands are taken and the trim is there."""
NOTHING_YET = 0x800000
FASTEST_HZ = 200.0
NOISE_AT_OVERSAMPLING = 32
DEFAULTS = {OSR: 0x02}
WRITABLE = frozenset(range(0x15, 0x20))

TRIMS = {
    "bmp388": bytes.fromhex("236B5849F65CFFCEF42300EA636E79F3F6AA4312C4"),
    "bmp390": bytes.fromhex("986CA94AF9E31C61160601514ADE5D03FAF90E06F5"),
}
"""Non-volatile memory of real parts, registers 0x31 to 0x45."""


@dataclass(frozen=True)
class Trim:
    """Compensation with one part's coefficients, in double precision (data sheet, section 8)."""

    t: tuple[float, float, float]
    p: tuple[float, ...]

    @classmethod
    def of(cls, nvm: bytes) -> "Trim":
        """Scale the 21 bytes of the non-volatile memory."""
        t1, t2, t3, *p = struct.unpack("<HHbhhbbHHbbhbb", nvm)
        p[0] -= 1 << 14
        p[1] -= 1 << 14
        powers = (20, 29, 32, 37, -3, 6, 8, 15, 48, 48, 65)
        return cls(
            (t1 * 2.0**8, t2 / 2.0**30, t3 / 2.0**48),
            tuple(value / 2.0**power for value, power in zip(p, powers, strict=True)),
        )

    def temperature_c(self, raw: float) -> float:
        """Temperature of a raw reading."""
        d = raw - self.t[0]
        return d * self.t[1] + d * d * self.t[2]

    def pressure_pa(self, raw: float, temperature_c: float) -> float:
        """Pressure of a raw reading at a compensated temperature."""
        p1, p2, p3, p4, p5, p6, p7, p8, p9, p10, p11 = self.p
        x = temperature_c
        offset = p5 + p6 * x + p7 * x**2 + p8 * x**3
        gain = p1 + p2 * x + p3 * x**2 + p4 * x**3
        return offset + raw * gain + raw**2 * (p9 + p10 * x) + raw**3 * p11

    def raw_temperature(self, temperature_c: float) -> int:
        """The raw reading that compensates to ``temperature_c``."""
        return round(float(brentq(lambda raw: self.temperature_c(raw) - temperature_c, 0.0, 2.0**24)))

    def raw_pressure(self, pressure_pa: float, temperature_c: float) -> int:
        """The raw reading that compensates to ``pressure_pa``."""
        return round(
            float(brentq(lambda raw: self.pressure_pa(raw, temperature_c) - pressure_pa, 0.0, 2.0**24))
        )


class Bmp3(RegisterChip):
    """The chip, measuring ``pressure_pa()`` and ``temperature_c()``.

    ``noise_pa`` is one sigma of one reading at the highest oversampling without the filter.
    """

    def __init__(
        self,
        model: str,
        pressure_pa: Callable[[], float],
        temperature_c: Callable[[], float],
        *,
        clock: Callable[[], float],
        rng: np.random.Generator,
        noise_pa: float = 0.9,
        address: int = 0x76,
    ) -> None:
        super().__init__(address)
        self._chip_id = CHIP_IDS[model]
        self._nvm = TRIMS[model]
        self._trim = Trim.of(self._nvm)
        self._pressure_pa = pressure_pa
        self._temperature_c = temperature_c
        self._clock = clock
        self._rng = rng
        self._noise_pa = noise_pa
        self._reset()

    def power_cycle(self) -> None:
        """Reset, as after a drop of the supply voltage."""
        self._reset()

    def _reset(self) -> None:
        self._registers = dict(DEFAULTS)
        self._raw_pressure = self._raw_temperature = NOTHING_YET
        self._ready = 0
        self._error = 0
        self._event = 0x01  # power-on detected
        self._due_s: float | None = None
        self._filtered_pa: float | None = None
        self._started_s = self._clock()

    @property
    def _is_up(self) -> bool:
        return self._clock() - self._started_s >= START_UP_S

    def _register(self, register: int) -> int:
        return self._registers.get(register, 0)

    @property
    def _conversion_s(self) -> float:
        """Data sheet, section 3.9.2."""
        power, osr = self._register(PWR_CTRL), self._register(OSR)
        pressure_us = 392 + 2 ** (osr & 0x07) * 2020 if power & PRESSURE_ENABLE else 0
        temperature_us = 163 + 2 ** (osr >> 3 & 0x07) * 2020 if power & TEMPERATURE_ENABLE else 0
        return (234 + pressure_us + temperature_us) * 1e-6

    @property
    def _period_s(self) -> float:
        return (1 << min(self._register(ODR) & 0x1F, 17)) / FASTEST_HZ

    def _wake(self) -> None:
        now = self._clock()
        if self._due_s is None or now < self._due_s:
            return
        if self._register(PWR_CTRL) & NORMAL_MODE == NORMAL_MODE:
            samples = 1 + int((now - self._due_s) / self._period_s)
            self._due_s += samples * self._period_s
        else:
            samples = 1
            self._due_s = None
            self._registers[PWR_CTRL] &= ~NORMAL_MODE  # forced mode ends asleep
        for _ in range(min(samples, 1000)):
            self._convert()

    def _convert(self) -> None:
        enabled = self._register(PWR_CTRL)
        temperature_c = self._temperature_c()
        if enabled & TEMPERATURE_ENABLE:
            self._raw_temperature = self._trim.raw_temperature(temperature_c + self._rng.normal(0.0, 0.005))
            temperature_c = self._trim.temperature_c(self._raw_temperature)
            self._ready |= TEMPERATURE_READY
        if enabled & PRESSURE_ENABLE:
            oversampling = 2 ** (self._register(OSR) & 0x07)
            noise_pa = self._noise_pa * (NOISE_AT_OVERSAMPLING / oversampling) ** 0.5
            pressure_pa = self._pressure_pa() + self._rng.normal(0.0, noise_pa)
            coefficient = 2 ** (self._register(CONFIG) >> 1 & 0x07) - 1
            previous = pressure_pa if self._filtered_pa is None else self._filtered_pa
            self._filtered_pa = (previous * coefficient + pressure_pa) / (coefficient + 1)
            self._raw_pressure = self._trim.raw_pressure(self._filtered_pa, temperature_c)
            self._ready |= PRESSURE_READY

    def _read(self, register: int) -> int:
        if DATA <= register < DATA + 6:
            raw = self._raw_pressure if register < DATA + 3 else self._raw_temperature
            self._ready &= ~(PRESSURE_READY if register < DATA + 3 else TEMPERATURE_READY)
            return raw >> 8 * ((register - DATA) % 3) & 0xFF
        if TRIM <= register < TRIM + len(self._nvm):
            return self._nvm[register - TRIM] if self._is_up else 0
        if SENSOR_TIME <= register < SENSOR_TIME + 3:
            ticks = int(self._clock() * 25600)
            return ticks >> 8 * (register - SENSOR_TIME) & 0xFF
        if register == ERROR:
            error, self._error = self._error, 0
            return error
        if register == EVENT:
            event, self._event = self._event, 0
            return event
        if register == STATUS:
            return COMMAND_READY * self._is_up | self._ready
        if register == INT_STATUS:
            return 0x08 * bool(self._ready)
        return {CHIP_ID: self._chip_id, REV_ID: 0x01}.get(register, self._register(register))

    def _take(self, values: bytes) -> None:
        """A burst write consists of (register, value) pairs: writing does not advance the pointer."""
        for i, value in enumerate(values):
            if i % 2 == 0:
                self._write(self._pointer, value)
            else:
                self._pointer = value

    def _write(self, register: int, value: int) -> None:
        if not self._is_up:
            return
        if register == COMMAND and value == SOFT_RESET:
            self._reset()
        elif register in WRITABLE:
            self._registers[register] = value
            if register == PWR_CTRL:
                self._change_mode(value)

    def _change_mode(self, value: int) -> None:
        mode = value & NORMAL_MODE
        self._due_s = None
        if mode == 0:
            return
        if mode == NORMAL_MODE and self._conversion_s > self._period_s:
            self._error |= CONFIGURATION_ERROR
            self._registers[PWR_CTRL] &= ~NORMAL_MODE
            return
        self._due_s = self._clock() + self._conversion_s
