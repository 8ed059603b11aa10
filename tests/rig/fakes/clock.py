"""A clock that only sleeping and transfers on a bus move on: tests of waits take no time and come out the same each time."""

import time

import pytest

from sim.devices.i2c_chip import I2cChip

TRANSFER_S = 0.0003  # some twelve bytes at 400 kHz


class FakeClock:
    """In place of ``time.monotonic`` and ``time.sleep``: a simulated chip, which knows no clock of ``rig``, runs on it too."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now_s = 1000.0
        self.slept_s: list[float] = []
        monkeypatch.setattr(time, "monotonic", self)
        monkeypatch.setattr(time, "sleep", self.sleep)

    def __call__(self) -> float:
        return self.now_s

    def sleep(self, seconds: float) -> None:
        self.slept_s.append(seconds)
        self.now_s += seconds


class TimedBus:
    """One simulated chip on a bus whose transfers take time on a ``FakeClock``; keeps what was written."""

    def __init__(self, chip: I2cChip, clock: FakeClock) -> None:
        self._chip = chip
        self._clock = clock
        self.writes: list[bytes] = []

    def __str__(self) -> str:
        return "timed bus"

    def transfer(self, address: int, write: bytes, read_length: int) -> bytes:
        assert address == self._chip.address
        self._clock.now_s += TRANSFER_S
        if not read_length:
            self.writes.append(write)
        return self._chip.transfer(write, read_length)

    def close(self) -> None:
        """Nothing to give back."""
