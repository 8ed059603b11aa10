"""Several readings of one sensor, for whoever averages them."""

from collections.abc import Callable, Hashable, Sequence
from typing import TypeVar

from rig.devices.bus.deadline import Deadline
from rig.errors import DeviceError

_SUSPICIOUS_REPEATS = 16

Reading = TypeVar("Reading")

MIN_READINGS = 10
"""Of a chip that is averaged: fewer say neither its mean nor its noise."""


def read_for(read: Callable[[], Reading], duration_s: float, least: int = 1) -> list[Reading]:
    """What ``read`` returns, as often as it fits into ``duration_s``, but ``least`` times though a busy computer takes longer.

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
    """Raise ``DeviceError`` where many samples in a row are all the same.

    A working sensor has noise of more than one count; one that repeats itself has stopped converting, however
    plausible its value. How many are suspicious depends on how fine the counts are against the noise.
    """
    if len(samples) >= suspicious_repeats and len(set(samples)) == 1:
        problem = f"is frozen: {len(samples)} identical readings in a row"
        raise DeviceError(name, problem, "power-cycle it; replace it if that does not help")
