"""The interface of an I2C chip, and a base class for chips with a register file."""

from abc import ABC, abstractmethod
from typing import Protocol


class I2cChip(Protocol):
    """A chip at an address: bytes written to it, then bytes read from it after a repeated start."""

    address: int

    def transfer(self, write: bytes, read_length: int) -> bytes:
        """Receive ``write``, answer ``read_length`` bytes; OSError if the chip does not acknowledge."""
        ...


class PoweredChip(I2cChip, Protocol):
    """A chip with a power-cycle."""

    def power_cycle(self) -> None:
        """Power-cycle: configuration and measurements are lost."""
        ...


class RegisterChip(ABC):
    """A register file: the first byte written is the register address, further bytes are data for it and the following
    ones.

    Reading continues from the last register address. Subclasses define the registers' content.
    """

    def __init__(self, address: int) -> None:
        self.address = address
        self._pointer = 0

    def transfer(self, write: bytes, read_length: int) -> bytes:
        """See ``I2cChip``."""
        self._wake()
        if write:
            self._pointer = write[0]
            self._take(write[1:])
        data = bytearray()
        for _ in range(read_length):
            data.append(self._read(self._pointer))
            self._step()
        return bytes(data)

    def _take(self, values: bytes) -> None:
        for value in values:
            self._write(self._pointer, value)
            self._step()

    def _step(self) -> None:
        if self._increments(self._pointer):
            self._pointer = (self._pointer + 1) & 0xFF

    def _increments(self, register: int) -> bool:
        """Whether the pointer moves on behind ``register``."""
        return register >= 0

    @abstractmethod
    def _wake(self) -> None:
        """Update the chip's state to the present, at the start of each transfer."""

    @abstractmethod
    def _read(self, register: int) -> int:
        """The byte in ``register``; reading may have side effects."""

    @abstractmethod
    def _write(self, register: int, value: int) -> None:
        """Write a byte to ``register``; read-only and reserved ones ignore it."""
