"""What QGIS makes of NMEA over TCP: the rules of its QgsNmeaConnection, and pynmeagps for the fields.

It takes sentences of the talkers GP and GN only, remembers the latest of each, and calls a position valid unless RMC's
status is V, GGA's quality is 0 or a field that it needs is empty (src/core/gps/qgsnmeaconnection.cpp, qgsgpsconnection.cpp).
"""

import socket
import time
from dataclasses import dataclass

from pynmeagps import NMEAReader

SOON_S = 30.0


@dataclass(frozen=True)
class Shown:
    """One state that its position panel had."""

    valid: bool
    lat_deg: float | None
    lon_deg: float | None


class Qgis:
    """A connection. ``shown`` is what the panel showed, one entry after each GGA."""

    def __init__(self, address):
        self._socket = socket.create_connection(address, SOON_S)
        self._lines = self._socket.makefile("rb")
        self._status = "V"
        self.shown = []

    def step(self):
        """Take one sentence."""
        line = self._lines.readline()
        if line[:3] not in (b"$GP", b"$GN"):
            return
        message = NMEAReader.parse(line, validate=1)
        if message.msgID == "RMC":
            self._status = message.status
        elif message.msgID == "GGA":
            valid = self._status == "A" and message.quality != 0 and message.lat != ""
            self.shown.append(Shown(valid, message.lat if valid else None, message.lon if valid else None))

    def until(self, wanted):
        """Take sentences until the panel shows what is ``wanted``; returns that."""
        deadline_s = time.monotonic() + SOON_S
        while time.monotonic() < deadline_s:
            self.step()
            if self.shown and wanted(self.shown[-1]):
                return self.shown[-1]
        raise AssertionError(f"it never showed that, but {self.shown[-3:]}")

    def more(self, epochs):
        """What it shows in so many more epochs."""
        wanted = len(self.shown) + epochs
        deadline_s = time.monotonic() + SOON_S
        while len(self.shown) < wanted and time.monotonic() < deadline_s:
            self.step()
        return self.shown[wanted - epochs :]

    def close(self):
        """Leave."""
        self._lines.close()
        self._socket.close()
