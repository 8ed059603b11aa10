"""An I2C bridge on loopback TCP: several buses, several chips on each.

Request: bus u8, address u8, write length u16, read length u16 (big-endian), the bytes to write.
Answer: errno u16 (0 is success), length u16 (big-endian), the bytes read.
Many requests may follow each other on one connection.
"""

import contextlib
import selectors
import socket
import struct
import threading
from collections.abc import Callable, Mapping, Sequence

from sim.devices.i2c_chip import I2cChip

REQUEST = struct.Struct(">BBHH")
ANSWER = struct.Struct(">HH")
NO_ACKNOWLEDGE, INPUT_OUTPUT = 121, 5
RECEIVE_SIZE = 4096


class I2cBridge:
    """Serves ``buses`` (number to chips) on a free port of 127.0.0.1 until closed.

    ``fault`` is called before each transfer with bus and address, and may return an errno to fail with.
    """

    def __init__(
        self,
        buses: Mapping[int, Sequence[I2cChip]],
        *,
        fault: Callable[[int, int], int] = lambda bus, address: 0,
    ) -> None:
        self.fault = fault
        self._chips = {(bus, chip.address): chip for bus, chips in buses.items() for chip in chips}
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._port: int = self._listener.getsockname()[1]
        self._wake_reader, self._wake_writer = socket.socketpair()
        self._pending: dict[socket.socket, bytearray] = {}
        self._thread = threading.Thread(target=self._serve, name="i2c bridge")
        self._thread.start()

    def url(self, bus: int) -> str:
        """The URL of ``bus`` for a rig configuration."""
        return f"tcp://127.0.0.1:{self._port}/{bus}"

    def close(self) -> None:
        """Stop serving and close all connections. May be called twice."""
        if self._thread.is_alive():
            self._wake_writer.send(b"x")
            self._thread.join()
        for end in (self._listener, self._wake_reader, self._wake_writer, *self._pending):
            end.close()

    def _serve(self) -> None:
        with selectors.DefaultSelector() as selector:
            selector.register(self._listener, selectors.EVENT_READ)
            selector.register(self._wake_reader, selectors.EVENT_READ)
            while True:
                ready = [key.fileobj for key, _ in selector.select()]
                if self._wake_reader in ready:
                    return
                for end in ready:
                    assert isinstance(end, socket.socket)
                    if end is self._listener:
                        connection, _ = self._listener.accept()
                        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                        self._pending[connection] = bytearray()
                        selector.register(connection, selectors.EVENT_READ)
                    elif not self._attend(end):
                        selector.unregister(end)
                        del self._pending[end]
                        end.close()

    def _attend(self, connection: socket.socket) -> bool:
        """Answer the requests received on a connection; False once the other side has closed it."""
        with contextlib.suppress(ConnectionError):
            data = connection.recv(RECEIVE_SIZE)
            self._pending[connection] += data
            for answer in self._answers(self._pending[connection]):
                connection.sendall(answer)
            return bool(data)
        return False

    def _answers(self, buffer: bytearray) -> list[bytes]:
        answers = []
        while len(buffer) >= REQUEST.size:
            bus, address, write_length, read_length = REQUEST.unpack_from(buffer)
            end = REQUEST.size + write_length
            if len(buffer) < end:
                break
            write = bytes(buffer[REQUEST.size : end])
            del buffer[:end]
            errno, data = self._transfer(bus, address, write, read_length)
            answers.append(ANSWER.pack(errno, len(data)) + data)
        return answers

    def _transfer(self, bus: int, address: int, write: bytes, read_length: int) -> tuple[int, bytes]:
        if errno := self.fault(bus, address):
            return errno, b""
        chip = self._chips.get((bus, address))
        if chip is None:
            return NO_ACKNOWLEDGE, b""
        try:
            return 0, chip.transfer(write, read_length)
        except OSError as error:
            return error.errno or INPUT_OUTPUT, b""
