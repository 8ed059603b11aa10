"""Devices in a ``with`` block."""

import contextlib
from types import TracebackType
from typing import Self

from rig.errors import RigError


class ClosedOnExit:
    """What is closed at the end of a ``with`` block, whatever happens in it; an error in the block hides one of closing."""

    def close(self) -> None:
        """Give the device back."""
        raise NotImplementedError

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None:
            self.close()
            return
        with contextlib.suppress(RigError):
            self.close()
