"""A serial line without an instrument: the test sends the bytes."""

import os
import pty
import threading
import tty

from rig import timebase


class Line:
    """A pty: ``far`` is the instrument's end, ``path`` ours."""

    def __init__(self) -> None:
        self.far, self._near = pty.openpty()
        tty.setraw(self._near)
        self.path = os.ttyname(self._near)
        self._speakers: list[threading.Thread] = []

    def say(self, data: bytes) -> None:
        """Write it all at once: it waits in the port until it is read."""
        self.say_soon(data, every_s=0.0)

    def say_soon(self, *parts: bytes, every_s: float = 0.03) -> None:
        """Write the parts one by one from another thread, the first after ``every_s``."""

        def say() -> None:
            for part in parts:
                timebase.sleep(every_s)
                os.write(self.far, part)

        self._speakers.append(threading.Thread(target=say))
        self._speakers[-1].start()

    def unplug(self) -> None:
        for speaker in self._speakers:
            speaker.join()
        for end in (self.far, self._near):
            if end >= 0:
                os.close(end)
        self.far = self._near = -1
