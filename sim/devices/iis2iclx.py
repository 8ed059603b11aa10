"""IIS2ICLX: two-axis inclinometer, 16 bit (data sheet and AN5509, register map); and a related chip with the same
identity.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from sim.devices.i2c_chip import RegisterChip
from sim.devices.sampling import Sampler

FUNC_CFG_ACCESS, CTRL5_C, CTRL6_C, CTRL7_XL, X_OFS_USR, Y_OFS_USR = 0x01, 0x14, 0x15, 0x16, 0x73, 0x74
WHO_AM_I, CTRL1_XL, CTRL3_C, CTRL8_XL, STATUS, OUT_TEMP_L, OUT_X_L = 0x0F, 0x10, 0x12, 0x17, 0x1E, 0x20, 0x28
IDENTITY = 0x6B
ODR_HZ = (0.0, 12.5, 26.0, 52.0, 104.0, 208.0, 416.0, 833.0)
MG_PER_LSB = (0.015, 0.122, 0.031, 0.061)  # by the code in CTRL1_XL: 0.5, 3, 1, 2 g
RATE_OVER_BANDWIDTH = (4, 10, 20, 45, 100, 200, 400, 800)  # by the code in CTRL8_XL, with LPF2
EMBEDDED_BANK, SENSOR_HUB_BANK = 0x80, 0x40
OFFSET_ON_OUTPUT, COARSE_OFFSET, SELF_TEST = 0x02, 0x08, 0x03
OFFSET_G = (2.0**-10, 2.0**-6)
HIGH_PASS = 0x04
SELF_TEST_G = 0.1
LPF2_ENABLE, BOOT, BLOCK_UPDATE, AUTO_INCREMENT, SOFT_RESET = 0x02, 0x80, 0x40, 0x04, 0x01
ACCELERATION_READY, TEMPERATURE_READY = 0x01, 0x04
RESET_S = 0.001
UNSETTLED_SAMPLES = 3
WRITABLE = frozenset([*range(0x01, 0x0F), *range(0x10, 0x1A), *range(0x56, 0x60), 0x73, 0x74])


class Iis2iclx(RegisterChip):
    """The chip, measuring the first two of ``acceleration_g()`` in its own axes.

    ``noise_density_g`` is in g per square root of hertz. Offsets and drift belong to ``acceleration_g``.
    """

    axes = 2
    mg_per_lsb = MG_PER_LSB

    def __init__(
        self,
        acceleration_g: Callable[[], NDArray[np.float64]],
        temperature_c: Callable[[], float],
        *,
        clock: Callable[[], float],
        rng: np.random.Generator,
        noise_density_g: float = 15e-6,
        address: int = 0x6A,
    ) -> None:
        super().__init__(address)
        self._acceleration_g = acceleration_g
        self._temperature_c = temperature_c
        self._clock = clock
        self._sampler = Sampler(noise_density_g, rng, UNSETTLED_SAMPLES)
        self._busy_until_s = clock()
        self._reset()

    def power_cycle(self) -> None:
        """Reset, as after a drop of the supply voltage."""
        self._reset()

    def _reset(self) -> None:
        self._registers = {CTRL3_C: AUTO_INCREMENT}
        self._latest = bytes(2 * self.axes)
        self._output = bytearray(2 * self.axes)
        self._unread: set[int] = set()
        self._temperature = bytes(2)
        self._ready = 0
        self._restart()

    def _restart(self) -> None:
        control = self._registers.get(CTRL1_XL, 0)
        divider = RATE_OVER_BANDWIDTH[self._registers.get(CTRL8_XL, 0) >> 5] if control & LPF2_ENABLE else 2
        self._sampler.start(self._clock(), ODR_HZ[min(control >> 4, 7)], divider)

    def _seen_g(self) -> NDArray[np.float64]:
        """Acceleration seen by the sensor, including self-test, user offsets and high-pass that may have been left on."""
        registers = self._registers
        if registers.get(CTRL8_XL, 0) & HIGH_PASS:
            return np.zeros(self.axes)
        seen_g = self._acceleration_g()[: self.axes].copy()
        seen_g += SELF_TEST_G * bool(registers.get(CTRL5_C, 0) & SELF_TEST)
        if registers.get(CTRL7_XL, 0) & OFFSET_ON_OUTPUT:
            unit_g = OFFSET_G[bool(registers.get(CTRL6_C, 0) & COARSE_OFFSET)]
            for axis, register in enumerate((X_OFS_USR, Y_OFS_USR)):
                seen_g[axis] -= unit_g * np.int8(
                    registers.get(register, 0) - 256 * (registers.get(register, 0) > 127)
                )
        return np.asarray(seen_g)

    def _wake(self) -> None:
        for sample in self._sampler.take(self._clock(), self._seen_g()):
            mg_per_lsb = self.mg_per_lsb[self._registers.get(CTRL1_XL, 0) >> 2 & 0x03]
            counts = np.clip(np.round(sample * 1000 / mg_per_lsb), -32768, 32767)
            self._latest = counts.astype("<i2").tobytes()
            temperature = round((self._temperature_c() - 25.0) * 256)
            self._temperature = temperature.to_bytes(2, "little", signed=True)
            self._ready |= ACCELERATION_READY | TEMPERATURE_READY
        blocked = self._registers[CTRL3_C] & BLOCK_UPDATE and self._unread
        if not blocked:
            self._output[:] = self._latest

    def _read(self, register: int) -> int:
        if register != FUNC_CFG_ACCESS and self._other_bank():
            return 0
        if register == WHO_AM_I:
            return IDENTITY
        if register == CTRL3_C and self._clock() < self._busy_until_s:
            return self._registers[CTRL3_C] | SOFT_RESET
        if register == STATUS:
            return self._ready
        if OUT_TEMP_L <= register < OUT_TEMP_L + 2:
            self._ready &= ~TEMPERATURE_READY
            return self._temperature[register - OUT_TEMP_L]
        if OUT_X_L <= register < OUT_X_L + 2 * self.axes:
            return self._read_output(register - OUT_X_L)
        return self._registers.get(register, 0)

    def _read_output(self, index: int) -> int:
        """With block update an axis is latched from the read of its first byte to that of its second."""
        self._ready &= ~ACCELERATION_READY
        partner = index ^ 1
        if partner in self._unread or index in self._unread:
            self._unread.discard(index)
        else:
            self._unread.add(partner)
        return self._output[index]

    def _increments(self, register: int) -> bool:
        return bool(self._registers[CTRL3_C] & AUTO_INCREMENT) and register >= 0

    def _other_bank(self) -> bool:
        """Whether the register bank of the embedded functions or of the sensor hub is selected."""
        return bool(self._registers.get(FUNC_CFG_ACCESS, 0) & (EMBEDDED_BANK | SENSOR_HUB_BANK))

    def _write(self, register: int, value: int) -> None:
        if self._clock() < self._busy_until_s:
            return  # the reset under way would undo it
        if register not in WRITABLE or (register != FUNC_CFG_ACCESS and self._other_bank()):
            return
        if register == CTRL3_C and value & (SOFT_RESET | BOOT):
            self._reset()
            self._busy_until_s = self._clock() + RESET_S
            return
        self._registers[register] = value
        if register in (CTRL1_XL, CTRL8_XL):
            self._restart()


class Ism330dhcx(Iis2iclx):
    """ISM330DHCX, equivalent here to LSM6DSR and ASM330LHH: three axes, 2 to 16 g, the same identity as the IIS2ICLX.

    Its range codes stand for four times those of the IIS2ICLX (data sheet ISM330DHCX Rev. 7, 4.1).
    """

    axes = 3
    mg_per_lsb = (0.061, 0.488, 0.122, 0.244)
