"""What passes between the rig and its devices, for whoever records it: raw bytes of serial ports, transfers of I2C buses."""

from collections.abc import Callable
from typing import Any

Listener = Callable[[dict[str, Any]], None]

_listeners: list[Listener] = []


def subscribe(listener: Listener) -> None:
    """Have ``listener`` called with each exchange, in the thread that makes it."""
    _listeners.append(listener)


def unsubscribe(listener: Listener) -> None:
    """End that."""
    _listeners.remove(listener)


def serial_bytes(port: str, way: str, data: bytes) -> None:
    """``way`` is "sent" or "received", as the rig sees it."""
    for listener in _listeners:
        listener({"port": port, way: data.hex()})


def i2c_transfer(bus: str, address: int, write: bytes, read_length: int, outcome: bytes | int) -> None:
    """``outcome`` is what was read, or the errno."""
    for listener in _listeners:
        result = {"errno": outcome} if isinstance(outcome, int) else {"read": outcome.hex()}
        listener({"bus": bus, "address": address, "write": write.hex(), "length": read_length, **result})
