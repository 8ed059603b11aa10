"""The simulated vehicle's odometer: sends speed and course over UDP (NMEA VTG), also when stationary."""

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from sim.background import in_background
from sim.devices.talkers import sentence
from sim.world.truth import World

RATE_HZ = 5.0
SPEED_SIGMA_SHARE, COURSE_SIGMA_DEG = 0.02, 1.5


@contextmanager
def running_odometer(world: World, address: str) -> Iterator[None]:
    """Send to ``HOST:PORT`` while the context lasts. Its constant errors are drawn once: tyre wear, gyro misalignment."""
    rng = world.rng("odometer")
    scale = 1.0 + float(rng.normal(0.0, SPEED_SIGMA_SHARE))
    askew_deg = float(rng.normal(0.0, COURSE_SIGMA_DEG))
    host, port = address.rsplit(":", 1)

    def talk(stop: threading.Event) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
            while not stop.wait(1.0 / RATE_HZ):
                vehicle = world.vehicle
                with suppress(ConnectionRefusedError):  # nobody listens at the moment
                    out.sendto(
                        vtg(vehicle.course_deg + askew_deg, vehicle.speed_m_s * scale), (host, int(port))
                    )

    with in_background(talk, "odometer"):
        yield


def vtg(course_deg: float, speed_m_s: float) -> bytes:
    """True course and speed over ground."""
    knots, kmh = speed_m_s * 3600.0 / 1852.0, speed_m_s * 3.6
    return sentence(f"IIVTG,{course_deg % 360.0:.2f},T,,M,{knots:.3f},N,{kmh:.3f},K,A")
