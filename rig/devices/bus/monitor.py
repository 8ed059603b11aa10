"""Bus monitor: publishes the raw bytes of serial ports and the transfers of I2C buses."""

from collections.abc import Callable
from typing import Any

Listener = Callable[[dict[str, Any]], None]

_listeners: list[Listener] = []


def subscribe(listener: Listener) -> None:
    """Call ``listener`` with each exchange, in the thread that makes it."""
    _listeners.append(listener)


def unsubscribe(listener: Listener) -> None:
    """Undo ``subscribe``."""
    _listeners.remove(listener)


def serial_bytes(port: str, way: str, data: bytes) -> None:
    """Publish bytes of a port; ``way`` is "sent" or "received", seen from the rig."""
    for listener in _listeners:
        listener({"port": port, way: data.hex()})


def i2c_transfer(bus: str, address: int, write: bytes, read_length: int, outcome: bytes | int) -> None:
    """Publish a transfer; ``outcome`` is the bytes read, or the errno."""
    for listener in _listeners:
        result = {"errno": outcome} if isinstance(outcome, int) else {"read": outcome.hex()}
        listener({"bus": bus, "address": address, "write": write.hex(), "length": read_length, **result})
