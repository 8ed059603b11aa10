"""Compiled kernels: numba's njit with the settings that all of them share, typed."""

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

Function = TypeVar("Function", bound=Callable[..., Any])


def kernel(*, parallel: bool = False, inline: bool = False) -> Callable[[Function], Function]:
    """Compile to machine code at the first call and keep the result on disk for the next process.

    ``error_model="numpy"`` lets a division by zero give an infinity, as in the array code around the kernels.
    """
    return cast(
        Callable[[Function], Function],
        numba.njit(
            cache=True, parallel=parallel, error_model="numpy", inline="always" if inline else "never"
        ),
    )
