"""A serial port whose far end is a fake device: a pseudo-terminal with one thread that answers."""

import array
import contextlib
import fcntl
import os
import selectors
import termios
import threading
import tty
from collections.abc import Callable

READ_SIZE = 4096
STALE_BYTES = 2048
"""A talker that nobody listens to loses what it said, as on a line whose port is closed."""

_BAUD_OF_SPEED = {
    getattr(termios, f"B{rate}"): rate
    for rate in (
        *(1200, 2400, 4800, 9600, 19200, 38400, 57600, 115200, 230400, 460800, 500000),
        *(921600, 1000000, 2000000, 3000000, 4000000),
    )
}


class PtyPort:
    """A pseudo-terminal. ``path`` is what the program under test opens in place of /dev/ttyUSB0.

    Closing the port while the program has it open looks like a USB adapter that was pulled out (EIO).
    """

    def __init__(self) -> None:
        self._device_end, self._program_end = os.openpty()
        tty.setraw(self._device_end)
        tty.setraw(self._program_end)
        os.set_blocking(self._device_end, False)
        self.path = os.ttyname(self._program_end)
        self._wake_reader, self._wake_writer = os.pipe()
        self._thread: threading.Thread | None = None
        self._sending = threading.Lock()
        self._closed = False

    @property
    def baud(self) -> int:
        """The rate that the program set on its end; 0 where it is none that a serial device has."""
        return _BAUD_OF_SPEED.get(termios.tcgetattr(self._program_end)[5], 0)

    def answer(self, device: Callable[[bytes], bytes]) -> None:
        """Hand what arrives to ``device`` and send back what it returns, in a thread, until ``close``."""
        self._thread = threading.Thread(target=self._serve, args=(device,), name=f"pty {self.path}")
        self._thread.start()

    def send(self, data: bytes) -> None:
        """Send without waiting. What does not fit into the line's buffer is lost, as on a wire."""
        with self._sending:
            if self._closed:
                return
            if _unread_bytes(self._program_end) > STALE_BYTES:
                termios.tcflush(self._program_end, termios.TCIFLUSH)
            with contextlib.suppress(BlockingIOError):
                os.write(self._device_end, data)

    def close(self) -> None:
        """Stop the thread and take the port away. May be called twice."""
        with self._sending:
            if self._closed:
                return
            self._closed = True
        os.write(self._wake_writer, b"x")
        if self._thread:
            self._thread.join()
        for descriptor in (self._device_end, self._program_end, self._wake_reader, self._wake_writer):
            os.close(descriptor)

    def _serve(self, device: Callable[[bytes], bytes]) -> None:
        with selectors.DefaultSelector() as selector:
            selector.register(self._device_end, selectors.EVENT_READ)
            selector.register(self._wake_reader, selectors.EVENT_READ)
            while not self._closed:
                ready = {key.fd for key, _ in selector.select()}
                if self._device_end in ready and (reply := device(self._received())):
                    self.send(reply)

    def _received(self) -> bytes:
        with contextlib.suppress(BlockingIOError):  # the program flushed what it had sent
            return os.read(self._device_end, READ_SIZE)
        return b""


def _unread_bytes(descriptor: int) -> int:
    count = array.array("i", [0])
    fcntl.ioctl(descriptor, termios.FIONREAD, count)
    return count[0]
