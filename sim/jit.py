"""Compiled kernels of the simulator, kept on disk by the same rules as the localizer's.

Worlds and pictures of ``sim`` share no code with what they test; where compiled code is kept is not part of them.
"""

from collections.abc import Callable
from typing import Any

import numba

from localizer.kernel_cache import keep_on_disk


def kernel(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile with these options of ``numba.njit`` at the first call and keep the result on disk for the next process."""

    def compiled(function: Callable[..., Any]) -> Any:
        dispatcher = numba.njit(**options)(function)
        keep_on_disk(dispatcher)
        return dispatcher

    return compiled
