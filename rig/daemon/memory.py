"""Gives memory back to the system that the C library keeps after something large, in case it happens again at once."""

import ctypes
from collections.abc import Callable
from functools import cache


@cache
def _trim() -> Callable[[int], int] | None:
    return getattr(ctypes.CDLL(None), "malloc_trim", None)  # glibc's; other C libraries have none


def release_free_heap() -> None:
    """Some milliseconds of work: for afterwards, not for in between."""
    trim = _trim()
    if trim is not None:
        trim(0)
