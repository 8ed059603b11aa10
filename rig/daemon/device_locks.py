"""Access to the devices for one user at a time: a capture takes all of them, everything else one."""

import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

from rig import timebase

ALL = ("head", "inclinometer", "compass", "altimeter", "camera")
POLL_S = 0.25


class DeviceLocks:
    """Exclusive access to devices. A capture takes all of them; other users release theirs when a capture waits."""

    def __init__(self) -> None:
        self._locks = {name: threading.Lock() for name in ALL}
        self._wanted = threading.Event()

    @contextmanager
    def one(self, name: str) -> Iterator[None]:
        """Hold one device; release it after the current reading once ``wanted``."""
        while self._wanted.is_set():
            timebase.sleep(POLL_S)
        with self._locks[name]:
            yield

    @property
    def wanted(self) -> bool:
        """Whether a capture waits for the devices or holds them."""
        return self._wanted.is_set()

    @contextmanager
    def all(self) -> Iterator[None]:
        """Hold all devices, once the others have released theirs."""
        self._wanted.set()
        try:
            with ExitStack() as stack:
                for name in ALL:
                    stack.enter_context(self._locks[name])
                yield
        finally:
            self._wanted.clear()
