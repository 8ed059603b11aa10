"""Returns free heap memory to the system, which the C library keeps after large allocations."""

import ctypes
from collections.abc import Callable
from functools import cache


@cache
def _trim() -> Callable[[int], int] | None:
    return getattr(ctypes.CDLL(None), "malloc_trim", None)  # glibc's; other C libraries have none


def release_free_heap() -> None:
    """Takes some milliseconds: call it after the work, not during."""
    trim = _trim()
    if trim is not None:
        trim(0)
