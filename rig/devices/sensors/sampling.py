"""Repeated readings of one sensor, for averaging."""

from collections.abc import Callable, Hashable, Sequence
from typing import TypeVar

from rig.devices.bus.deadline import Deadline
from rig.errors import DeviceError

_SUSPICIOUS_REPEATS = 16

Reading = TypeVar("Reading")

MIN_READINGS = 10
"""Least number of readings for a mean and its noise."""


def read_for(read: Callable[[], Reading], duration_s: float, least: int = 1) -> list[Reading]:
    """Results of ``read`` for ``duration_s``, at least ``least`` even if a busy computer takes longer.

    Raises what ``read`` raises.
    """
    end = Deadline.after(duration_s)
    readings = [read()]
    while not end.expired or len(readings) < least:
        readings.append(read())
    return readings


def require_noise(
    name: str, samples: Sequence[Hashable], suspicious_repeats: int = _SUSPICIOUS_REPEATS
) -> None:
    """Raise ``DeviceError`` if many consecutive samples are equal.

    A working sensor has noise above one count; equal values mean that it has stopped converting, however plausible the
    value. The number of suspicious repeats depends on resolution and noise.
    """
    if len(samples) >= suspicious_repeats and len(set(samples)) == 1:
        problem = f"is frozen: {len(samples)} identical readings in a row"
        raise DeviceError(name, problem, "power-cycle it; replace it if that does not help")
