"""Faults of a chip, on its I2C bus and internal."""

import errno
import os
import threading
import time

import numpy as np

from sim.devices.adxl355 import Adxl355
from sim.devices.bmp3 import Bmp3
from sim.devices.i2c_chip import PoweredChip
from sim.devices.iis2iclx import Iis2iclx
from sim.devices.mmc5983ma import Mmc5983ma
from sim.devices.ms5611 import Ms5611
from sim.faults.script import Fault
from sim.faults.wire import flipped

NOTHING_MEASURED: dict[type, dict[int, bytes]] = {
    Adxl355: {0x04: b"\x00"},  # status: no data ready
    Iis2iclx: {0x1E: b"\x00"},
    Mmc5983ma: {0x08: b"\x10"},  # status: factory trim read, no measurement done
    Bmp3: {0x04: bytes.fromhex("000080000080")},  # the data registers' value before the first conversion
    Ms5611: {0x00: bytes(3)},
}
"""Register -> its content without a measurement."""


class FaultyChip:
    """A chip with faults. Implements ``sim.devices.i2c_chip.I2cChip``."""

    def __init__(self, chip: PoweredChip, rng: np.random.Generator) -> None:
        self.address = chip.address
        self._chip = chip
        self._rng = rng
        self._lock = threading.Lock()
        self._active: list[Fault] = []
        self._command = b""
        self._remembered: dict[tuple[bytes, bytes, int], bytes] = {}

    def begin(self, fault: Fault) -> None:
        """Start ``fault``, or apply it once."""
        if fault.fault == "reset":
            self._chip.power_cycle()
            return
        with self._lock:
            self._active.append(fault)

    def end(self, fault: Fault) -> None:
        """End ``fault``."""
        with self._lock:
            self._active.remove(fault)

    def transfer(self, write: bytes, read_length: int) -> bytes:
        """See ``I2cChip``."""
        with self._lock:
            active = {f.fault: f for f in self._active if self._rng.random() < f.parameters.get("share", 1.0)}
        for name, number in (("nack", errno.EREMOTEIO), ("stuck", errno.EIO), ("stretched", errno.ETIMEDOUT)):
            if name in active:
                time.sleep(active[name].parameters.get("seconds", 0.0))
                raise OSError(number, os.strerror(number))
        data = self._measured(write, self._chip.transfer(write, read_length), "frozen" in active)
        if "no-conversion" in active and write:
            kind = next(kind for kind in NOTHING_MEASURED if isinstance(self._chip, kind))
            nothing = NOTHING_MEASURED[kind].get(write[0], b"")
            data = nothing[:read_length] + data[len(nothing) :]
        if "corrupted" in active and data:
            data = flipped(data, active["corrupted"].parameters, self._rng)
        if "truncated" in active and data:
            data = data[: self._rng.integers(len(data))]
        return data

    def _measured(self, write: bytes, data: bytes, frozen: bool) -> bytes:
        """A frozen chip keeps reporting new data with always the same value."""
        if not data:
            self._command = write
        key = (self._command, write, len(data))
        if len(data) <= 1:
            return data
        if frozen:
            return self._remembered.setdefault(key, data)
        self._remembered[key] = data
        return data
