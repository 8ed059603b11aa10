"""A serial port with a fake device at its far end: a pseudo-terminal with one thread that answers."""

import array
import contextlib
import fcntl
import os
import selectors
import termios
import threading
import tty
from collections.abc import Callable
from pathlib import Path

READ_SIZE = 4096
STALE_BYTES = 2048
"""Without a reader a talker's output is dropped, as on a line whose port is closed."""

_BAUD_OF_SPEED = {
    getattr(termios, f"B{rate}"): rate
    for rate in (
        *(1200, 2400, 4800, 9600, 19200, 38400, 57600, 115200, 230400, 460800, 500000),
        *(921600, 1000000, 2000000, 3000000, 4000000),
    )
}

Device = Callable[[bytes], bytes]


class PtyPort:
    """A pseudo-terminal. ``path`` is what the program under test opens in place of /dev/ttyUSB0.

    Closing or unplugging the port while the program has it open looks like an unplugged USB adapter (EIO). Plugged in
    again it is another terminal; ``keep_name`` gives it a persistent name, like those of /dev/serial/by-id.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._ends: tuple[int, int] | None = None  # the device's, the program's
        self._device: Device | None = None
        self._thread: threading.Thread | None = None
        self._link: Path | None = None
        self._closed = False
        self._terminal = ""
        self._wake_reader, self._wake_writer = os.pipe()
        self._open()

    @property
    def path(self) -> str:
        """The persistent name if there is one, else that of the terminal."""
        return str(self._link) if self._link else self._terminal

    @property
    def baud(self) -> int:
        """The baud rate set by the program; 0 if no serial device has it."""
        with self._lock:
            return _BAUD_OF_SPEED.get(termios.tcgetattr(self._ends[1])[5], 0) if self._ends else 0

    def keep_name(self, link: Path) -> None:
        """Let ``link`` point at the current terminal while the port is plugged in."""
        link.parent.mkdir(parents=True, exist_ok=True)
        link.symlink_to(self._terminal)
        self._link = link

    def answer(self, device: Device) -> None:
        """Pass received bytes to ``device`` and send its result back, in a thread, until ``close``."""
        self._device = device
        self._start()

    def send(self, data: bytes) -> None:
        """Send without blocking. What does not fit into the line's buffer is lost, as on a wire."""
        with self._lock:
            if self._ends is None or not data:
                return
            device_end, program_end = self._ends
            if _unread_bytes(program_end) > STALE_BYTES:
                termios.tcflush(program_end, termios.TCIFLUSH)
            with contextlib.suppress(BlockingIOError):
                os.write(device_end, data)

    def unplug(self) -> None:
        """Unplug the adapter: the terminal and its persistent name disappear. May be called twice."""
        with self._lock:
            ends, self._ends = self._ends, None
        if ends is None:
            return
        if self._link:
            self._link.unlink(missing_ok=True)
        os.write(self._wake_writer, b"x")
        if self._thread:
            self._thread.join()
            self._thread = None
        os.read(self._wake_reader, 1)
        for end in ends:
            os.close(end)

    def plug_in(self) -> None:
        """Plug the adapter in again, as another terminal under the same persistent name."""
        self._open()
        if self._link:
            self._link.symlink_to(self._terminal)
        if self._device:
            self._start()

    def close(self) -> None:
        """Stop the thread and remove the port. May be called twice."""
        if self._closed:
            return
        self._closed = True
        self.unplug()
        os.close(self._wake_reader)
        os.close(self._wake_writer)

    def _open(self) -> None:
        ends = os.openpty()
        if os.ttyname(ends[1]) == self._terminal:  # the system gives the lowest free number again
            same, ends = ends, os.openpty()
            for end in same:
                os.close(end)
        for end in ends:
            tty.setraw(end)
        os.set_blocking(ends[0], False)
        self._terminal = os.ttyname(ends[1])
        with self._lock:
            self._ends = ends

    def _start(self) -> None:
        assert self._ends
        assert self._device
        self._thread = threading.Thread(
            target=self._serve, args=(self._ends[0], self._device), name=f"pty {self._terminal}"
        )
        self._thread.start()

    def _serve(self, device_end: int, device: Device) -> None:
        with selectors.DefaultSelector() as selector:
            selector.register(device_end, selectors.EVENT_READ)
            selector.register(self._wake_reader, selectors.EVENT_READ)
            while True:
                ready = {key.fd for key, _ in selector.select()}
                if self._wake_reader in ready:
                    return
                self.send(device(_received(device_end)))


def _received(descriptor: int) -> bytes:
    with contextlib.suppress(BlockingIOError):  # the program flushed what it had sent
        return os.read(descriptor, READ_SIZE)
    return b""


def _unread_bytes(descriptor: int) -> int:
    count = array.array("i", [0])
    fcntl.ioctl(descriptor, termios.FIONREAD, count)
    return count[0]
