"""I2C chips as register files behind the bus interface, with faults on demand."""

import errno
import os
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from fakes.clock import TRANSFER_S


@dataclass
class RegisterChip:
    """256 registers with auto-increment. ``on_write`` acts after a write, ``on_read`` before a read."""

    registers: bytearray = field(default_factory=lambda: bytearray(256))
    on_write: Callable[[int, int], None] | None = None
    on_read: Callable[[int], None] | None = None
    writes: list[tuple[int, int]] = field(default_factory=list)

    def put(self, register: int, data: bytes) -> None:
        self.registers[register : register + len(data)] = data

    def transfer(self, write: bytes, read_length: int) -> bytes:
        register = write[0]
        for offset, value in enumerate(write[1:]):
            self.writes.append((register + offset, value))
            self.registers[register + offset] = value
            if self.on_write:
                self.on_write(register + offset, value)
        if read_length and self.on_read:
            self.on_read(register)
        return bytes(self.registers[register : register + read_length])


@dataclass
class FakeI2cBus:
    """Chips by address; ``faults`` maps the number of a transfer (from 0) to an errno, or to "short"."""

    chips: dict[int, RegisterChip]
    faults: dict[int, int | str] = field(default_factory=dict)
    transfers: int = 0
    closed: bool = False

    def __str__(self) -> str:
        return "fake bus"

    def transfer(self, address: int, write: bytes, read_length: int) -> bytes:
        fault = self.faults.get(self.transfers)
        self.transfers += 1
        time.sleep(TRANSFER_S)
        if isinstance(fault, int):
            raise OSError(fault, os.strerror(fault))
        if address not in self.chips:
            raise OSError(errno.EREMOTEIO, os.strerror(errno.EREMOTEIO))
        data = self.chips[address].transfer(write, read_length)
        return data[:-1] if fault == "short" else data

    def fail_next(self, fault: int | str) -> None:
        self.faults[self.transfers] = fault

    def close(self) -> None:
        self.closed = True
