"""Compiled kernels: numba's njit with the settings that all of them share, typed."""

import logging
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

from localizer.errors import SkyfixError
from localizer.kernel_cache import keep_on_disk

_log = logging.getLogger(__name__)

T = TypeVar("T")
Function = TypeVar("Function", bound=Callable[..., Any])


def kernel(*, parallel: bool = False, inline: bool = False) -> Callable[[Function], Function]:
    """Compile to machine code at the first call and keep the result on disk for the next process.

    ``error_model="numpy"`` lets a division by zero give an infinity, as in the array code around the kernels.
    """

    def compiled(function: Function) -> Function:
        dispatcher = numba.njit(
            parallel=parallel, error_model="numpy", inline="always" if inline else "never"
        )(function)
        keep_on_disk(dispatcher)
        return cast(Function, dispatcher)

    return compiled


def recompiled_if_damaged(load: Callable[[], T]) -> T:
    """The result of ``load``, which calls kernels; repeated with newly compiled ones if those on disk are damaged.

    A power failure soon after compilation can leave empty cache files, on which numba fails at every later start. Only a folder
    of their own (``NUMBA_CACHE_DIR``) is emptied.
    """
    try:
        return load()
    except SkyfixError:
        raise
    except Exception as error:
        folder = os.environ.get("NUMBA_CACHE_DIR")
        kept = [*Path(folder).rglob("*.nb[ci]")] if folder else []
        if not kept:
            raise
        _log.warning("compiled kernels are damaged (%s: %s): compiled anew", type(error).__name__, error)
        for file in kept:
            file.unlink(missing_ok=True)
        return load()
