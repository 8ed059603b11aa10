"""Talkers, serial instruments that send unprompted: NMEA 0183 compasses and barometers, Vaisala PA50."""

import threading
from collections.abc import Callable
from dataclasses import dataclass

from sim.devices.pty_port import PtyPort

HPA_PER_INHG = 33.8638867
WIND = "WIMWV,214.8,R,0.1,K,A"
"""Another sentence of a weather instrument, which barometer listeners must ignore."""


@dataclass(frozen=True)
class Heading:
    """Input of a compass talker: attitude of the pan stage, degrees."""

    magnetic_heading_deg: float
    pitch_deg: float
    roll_deg: float
    declination_deg: float
    temperature_c: float

    @property
    def heading_deg(self) -> float:
        """True heading, with the declination set in the talker."""
        return (self.magnetic_heading_deg + self.declination_deg) % 360.0


@dataclass(frozen=True)
class Air:
    """Input of a weather talker."""

    pressure_hpa: float
    temperature_c: float


def sentence(body: str) -> bytes:
    """An NMEA 0183 sentence around ``body``, with its checksum."""
    checksum = 0
    for byte in body.encode("ascii"):
        checksum ^= byte
    return f"${body}*{checksum:02X}\r\n".encode("ascii")


def _circle(degrees: float) -> str:
    return f"{round(degrees * 10) % 3600 / 10:.1f}"


def hdg(heading: Heading) -> bytes:
    """Magnetic heading with deviation (none) and variation."""
    side = "E" if heading.declination_deg >= 0 else "W"
    body = f"HCHDG,{_circle(heading.magnetic_heading_deg)},0.0,E,{abs(heading.declination_deg):.1f},{side}"
    return sentence(body)


def hdm(heading: Heading) -> bytes:
    """Magnetic heading."""
    return sentence(f"HCHDM,{_circle(heading.magnetic_heading_deg)},M")


def hdt(heading: Heading) -> bytes:
    """True heading."""
    return sentence(f"HCHDT,{_circle(heading.heading_deg)},T")


def ths(heading: Heading) -> bytes:
    """True heading and how it came about (autonomous)."""
    return sentence(f"HCTHS,{_circle(heading.heading_deg)},A")


def ptnthpr(heading: Heading) -> bytes:
    """Honeywell HMR3000: magnetic heading, pitch and roll, each with a status (normal)."""
    return sentence(
        f"PTNTHPR,{_circle(heading.magnetic_heading_deg)},N,{heading.pitch_deg:.1f},N,{heading.roll_deg:.1f},N"
    )


def ohpr(heading: Heading) -> bytes:
    """OceanServer OS5000: magnetic heading, pitch, roll, temperature."""
    return sentence(
        f"OHPR,{_circle(heading.magnetic_heading_deg)},{heading.pitch_deg:.1f},{heading.roll_deg:.1f},"
        f"{heading.temperature_c:.1f}"
    )


def os5000(heading: Heading) -> bytes:
    """OceanServer OS5000, factory format: letters before numbers, no commas."""
    return sentence(
        f"C{_circle(heading.magnetic_heading_deg)}P{heading.pitch_deg:.1f}R{heading.roll_deg:.1f}"
        f"T{heading.temperature_c:.1f}"
    )


def xdr(air: Air) -> bytes:
    """Transducer measurements: temperature and pressure in one sentence, bar."""
    body = f"WIXDR,C,{air.temperature_c:+06.1f},C,TEMP,P,{air.pressure_hpa / 1000:.5f},B,Barometer"
    return sentence(WIND) + sentence(body)


def mda(air: Air) -> bytes:
    """Meteorological composite: pressure in inches of mercury and bar, air temperature."""
    inches, bar = air.pressure_hpa / HPA_PER_INHG, air.pressure_hpa / 1000
    return sentence(WIND) + sentence(
        f"WIMDA,{inches:.4f},I,{bar:.4f},B,{air.temperature_c:.1f},C,,,,,,,,,,,,,,"
    )


def vaisala_pa50(air: Air) -> bytes:
    """Vaisala PA50: pressure, no trend yet, the three transducers; the checksum is a sum from SOH to ETX."""
    p = air.pressure_hpa
    message = f"\x01P\x021 {p:.2f} ***.* * {p:.1f} {p:.1f} {p:.1f} 000\x03".encode("ascii")
    return message + f"{sum(message) & 0xFF:02X}\r\n".encode("ascii")


COMPASSES: dict[str, Callable[[Heading], bytes]] = {
    "hdg": hdg,
    "hdm": hdm,
    "hdt": hdt,
    "ths": ths,
    "ptnthpr": ptnthpr,
    "ohpr": ohpr,
    "os5000": os5000,
}
BAROMETERS: dict[str, Callable[[Air], bytes]] = {"xdr": xdr, "mda": mda, "vaisala-pa50": vaisala_pa50}


class Talker:
    """Sends ``message()`` on its own port, ``rate_hz`` times a second, until closed.

    A listener with another baud rate than ``baud`` receives garbage. ``on_wire`` models the cable: it may change,
    truncate or drop messages.
    """

    def __init__(
        self, message: Callable[[], bytes], *, rate_hz: float, baud: int, port: PtyPort | None = None
    ) -> None:
        """``port`` is another talker's, if one stream carries both."""
        self.baud = baud
        self.on_wire: Callable[[bytes], bytes] = bytes
        self._message = message
        self._period_s = 1.0 / rate_hz
        self.has_own_port = port is None
        self.port = port or PtyPort()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._talk, name=f"talker {self.port.path}")
        self._thread.start()

    @property
    def path(self) -> str:
        """The path of the port for a rig configuration."""
        return self.port.path

    def close(self) -> None:
        """Stop sending and remove the port. May be called twice."""
        self._stop.set()
        self._thread.join()
        if self.has_own_port:
            self.port.close()

    def _talk(self) -> None:
        while not self._stop.wait(self._period_s):
            data = self.on_wire(self._message())
            self.port.send(data if self.port.baud == self.baud else bytes(byte ^ 0xA5 for byte in data))
