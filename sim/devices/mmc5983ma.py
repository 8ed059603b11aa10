"""MMC5983MA: three-axis AMR magnetometer, 18 bit (data sheet Rev. A)."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from sim.devices.i2c_chip import RegisterChip

XOUT_0, XYZ_LOW, TOUT, STATUS, CONTROL_0, CONTROL_1, CONTROL_2, CONTROL_3, PRODUCT_ID = (
    *(0x00, 0x06, 0x07, 0x08),
    *(0x09, 0x0A, 0x0B, 0x0C),
    0x2F,
)
IDENTITY = 0x30
TAKE_FIELD, TAKE_TEMPERATURE, SET, RESET, AUTO_SET_RESET = 0x01, 0x02, 0x08, 0x10, 0x20
CONTINUOUS, SOFT_RESET = 0x08, 0x80
FIELD_DONE, TEMPERATURE_DONE, OTP_READ_DONE = 0x01, 0x02, 0x10
CONVERSION_S = (0.008, 0.004, 0.002, 0.0005)
NOISE_BY_BANDWIDTH = (1.0, 1.5, 2.0, 3.0)  # against that of the narrowest
CONTINUOUS_RATE_HZ = (0.0, 1.0, 10.0, 20.0, 50.0, 100.0, 200.0, 1000.0)
SOFT_RESET_S = 0.010
OTP_READ_S = 0.015  # from the reset until the trim is loaded
COUNTS_PER_UT = 163.84
ZERO_FIELD = 131072
FULL_SCALE = 262143


class Mmc5983ma(RegisterChip):
    """The chip, measuring ``field_ut()`` (3,) in its own axes.

    ``bridge_offset_ut`` is the zero error that SET and RESET separate: a RESET inverts the field but not the offset.
    ``noise_ut`` is one sigma per axis of one conversion at 100 Hz bandwidth.
    """

    def __init__(
        self,
        field_ut: Callable[[], NDArray[np.float64]],
        temperature_c: Callable[[], float],
        *,
        clock: Callable[[], float],
        rng: np.random.Generator,
        noise_ut: float = 0.04,
        bridge_offset_ut: tuple[float, float, float] = (0.0, 0.0, 0.0),
        address: int = 0x30,
    ) -> None:
        super().__init__(address)
        self._field_ut = field_ut
        self._temperature_c = temperature_c
        self._clock = clock
        self._rng = rng
        self._noise_ut = noise_ut
        self._bridge_offset_ut = np.array(bridge_offset_ut)
        self._reset()
        self._deaf_until_s = clock()

    def power_cycle(self) -> None:
        """Reset, as after a drop of the supply voltage."""
        self._reset()

    def _reset(self) -> None:
        self._control = [0, 0, 0, 0]
        self._polarity = 1.0
        self._counts = [0, 0, 0]
        self._temperature = 0
        self._status = 0
        self._otp_read_at_s = self._clock() + OTP_READ_S
        self._field_due_s: float | None = None
        self._temperature_due_s: float | None = None
        self._deaf_until_s = self._clock() + SOFT_RESET_S

    def transfer(self, write: bytes, read_length: int) -> bytes:
        """See ``I2cChip``. Does not acknowledge during a reset."""
        if self._clock() < self._deaf_until_s:
            raise OSError(121, "no acknowledge: soft reset under way")
        return super().transfer(write, read_length)

    def _wake(self) -> None:
        now = self._clock()
        if now >= self._otp_read_at_s:
            self._status |= OTP_READ_DONE
        if self._field_due_s is not None and now >= self._field_due_s:
            self._counts = self._pending
            self._status |= FIELD_DONE
            self._field_due_s = None
        if self._temperature_due_s is not None and now >= self._temperature_due_s:
            self._temperature = int(np.clip(round((self._temperature_c() + 75.0) / 0.8), 0, 255))
            self._status |= TEMPERATURE_DONE
            self._temperature_due_s = None
        if self._control[2] & CONTINUOUS and self._field_due_s is None:
            rate_hz = CONTINUOUS_RATE_HZ[self._control[2] & 0x07]
            if rate_hz:
                self._start(max(1.0 / rate_hz, self._conversion_s))

    @property
    def _conversion_s(self) -> float:
        return CONVERSION_S[self._control[1] & 0x03]

    def _start(self, duration_s: float) -> None:
        """Begin a measurement; the field is the one of this moment."""
        noise_ut = self._noise_ut * NOISE_BY_BANDWIDTH[self._control[1] & 0x03]
        bridge_ut = self._polarity * self._field_ut() + self._bridge_offset_ut
        counts = ZERO_FIELD + (bridge_ut + self._rng.normal(0.0, noise_ut, 3)) * COUNTS_PER_UT
        inhibited = (self._control[1] & 0x04, self._control[1] & 0x18, self._control[1] & 0x18)
        self._pending = [
            old if off else int(np.clip(round(new), 0, FULL_SCALE))
            for old, new, off in zip(self._counts, counts, inhibited, strict=True)
        ]
        self._field_due_s = self._clock() + duration_s

    def _read(self, register: int) -> int:
        if XOUT_0 <= register < XYZ_LOW:
            axis, low = divmod(register, 2)
            return self._counts[axis] >> (2 if low else 10) & 0xFF
        if register == XYZ_LOW:
            return sum((self._counts[axis] & 0x03) << (6 - 2 * axis) for axis in range(3))
        # Control registers are write-only.
        return {TOUT: self._temperature, STATUS: self._status, PRODUCT_ID: IDENTITY}.get(register, 0)

    def _write(self, register: int, value: int) -> None:
        if register == STATUS:
            self._status &= ~(value & (FIELD_DONE | TEMPERATURE_DONE))
        elif register == CONTROL_0:
            self._command(value)
        elif register == CONTROL_1 and value & SOFT_RESET:
            self._reset()
        elif CONTROL_1 <= register <= CONTROL_3:
            self._control[register - CONTROL_0] = value
            if register == CONTROL_2 and not value & CONTINUOUS:
                self._field_due_s = None

    def _command(self, value: int) -> None:
        """Control 0: its commands clear themselves, Auto_SR_en stays. Without the trim nothing is measured."""
        if not self._status & OTP_READ_DONE:
            return
        self._control[0] = value & AUTO_SET_RESET
        if value & SET:
            self._polarity = 1.0
        if value & RESET:
            self._polarity = -1.0
        if value & TAKE_FIELD:
            if value & AUTO_SET_RESET:
                self._polarity = 1.0
            self._status &= ~FIELD_DONE
            self._start(self._conversion_s)
        elif value & TAKE_TEMPERATURE:
            self._status &= ~TEMPERATURE_DONE
            self._temperature_due_s = self._clock() + CONVERSION_S[0]
