"""Faults of a serial line: cable, adapter, noise."""

import threading
import time
from collections.abc import Callable, Mapping

import numpy as np

from sim.faults.script import Fault

# What a receiver could take for the beginning of a message: Dynamixel headers with impossible, huge and small lengths,
# stuffed and unstuffed triples, an NMEA and a Vaisala start that nothing follows.
DECOYS = (
    b"\xff\xff\xfd\x00\x01\x40\x00\x55\x00",
    b"\xff\xff\xfd\x00\xfe\xff\xff\x55",
    b"\xff\xff\xfd\x00\x01\x00\x00",
    b"\xff\xff\xfd\xfd\xff\xff\xfd",
    b"\xff\xff\xff\xfd",
    b"$HCHDG,12",
    b"$*",
    b"\x01P\x021 9",
)


class Wire:
    """Stands between a device and its port; call it with a message, and it returns what arrives of it."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._lock = threading.Lock()
        self._active: list[Fault] = []
        self._last = b""

    def begin(self, fault: Fault) -> None:
        """Let ``fault`` happen to each message from now on."""
        with self._lock:
            self._active.append(fault)

    def end(self, fault: Fault) -> None:
        """Let it no longer happen."""
        with self._lock:
            self._active.remove(fault)

    def __call__(self, message: bytes) -> bytes:
        """What arrives of ``message``; waits where it is delayed."""
        with self._lock:
            active = list(self._active)
        frozen = any(fault.fault == "frozen" for fault in active)
        if frozen and self._last:
            message = self._last
        self._last = message
        for fault in active:
            if message and self._rng.random() < fault.parameters.get("share", 1.0):
                message = DAMAGE[fault.fault](message, fault.parameters, self._rng)
        return message


Damage = Callable[[bytes, Mapping[str, float], np.random.Generator], bytes]


def _delayed(message: bytes, parameters: Mapping[str, float], rng: np.random.Generator) -> bytes:
    time.sleep(parameters["seconds"])
    return message


def flipped(message: bytes, parameters: Mapping[str, float], rng: np.random.Generator) -> bytes:
    """The message with ``bits`` of its bits turned over."""
    bits = np.unpackbits(np.frombuffer(message, np.uint8))
    count = min(int(parameters["bits"]), len(bits))
    bits[rng.choice(len(bits), count, replace=False)] ^= 1
    return np.packbits(bits).tobytes()


def _garbage(message: bytes, parameters: Mapping[str, float], rng: np.random.Generator) -> bytes:
    return DECOYS[rng.integers(len(DECOYS))] + message


DAMAGE: dict[str, Damage] = {
    "lost": lambda message, parameters, rng: b"",
    "delayed": _delayed,
    "corrupted": flipped,
    "truncated": lambda message, parameters, rng: message[: rng.integers(len(message))],
    "duplicated": lambda message, parameters, rng: message + message,
    "garbage": _garbage,
    "frozen": lambda message, parameters, rng: message,
}
