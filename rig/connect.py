"""From a configuration to open devices, one function each, and all of them together."""

import logging
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Protocol, TypeVar

from rig.bus.i2c_chip import open_chip
from rig.bus.retry import retry
from rig.camera import Camera
from rig.config import (
    AltimeterSection,
    CompassSection,
    I2cAltimeterSection,
    InclinometerSection,
    Mmc5983maSection,
    PanTiltSection,
    RigConfig,
)
from rig.errors import RigError
from rig.pan_tilt import PanTilt
from rig.readings import AccelerationReading, FieldReading, HeadingReading, PressureReading
from rig.sensors.adxl355 import Adxl355
from rig.sensors.bmp3 import Bmp3
from rig.sensors.iis2iclx import Iis2iclx
from rig.sensors.mmc5983ma import Mmc5983ma
from rig.sensors.ms5611 import Ms5611
from rig.sensors.talker import nmea_barometer, nmea_compass, vaisala_pa50

_log = logging.getLogger(__name__)

SENSORS_AT_ONCE = 3

Reading_co = TypeVar("Reading_co", covariant=True)


class Sensor(Protocol[Reading_co]):
    """What all sensors have in common."""

    def identify(self) -> str:
        """What it is and where."""
        ...

    def read_many(self, duration_s: float) -> Sequence[Reading_co]:
        """All readings of some seconds, at least one."""
        ...

    def close(self) -> None:
        """Give its bus or port back."""
        ...


Inclinometer = Sensor[AccelerationReading]
Compass = Sensor[FieldReading] | Sensor[HeadingReading]
Altimeter = Sensor[PressureReading]


@dataclass(frozen=True)
class Rig:
    """All devices, open; None where the configuration has none."""

    config: RigConfig
    pan_tilt: PanTilt
    inclinometer: Inclinometer
    compass: Compass | None
    altimeter: Altimeter | None
    camera: Camera
    readers: Executor
    """Threads for sensors that are read at the same time; no sensor in two at once."""


def open_inclinometer(section: InclinometerSection) -> Inclinometer:
    """The accelerometer chip, measuring."""
    if section.chip == "adxl355":
        return retry(partial(open_chip, Adxl355, section.bus, section.address))
    return retry(partial(open_chip, Iis2iclx, section.bus, section.address))


def open_compass(section: CompassSection) -> Compass:
    """The magnetometer chip or the talker."""
    if isinstance(section, Mmc5983maSection):
        return retry(partial(open_chip, Mmc5983ma, section.bus, section.address))
    return nmea_compass(section.port, section.baud)


def open_altimeter(section: AltimeterSection) -> Altimeter:
    """The barometer chip or the talker."""
    if isinstance(section, I2cAltimeterSection):
        if section.kind == "ms5611":
            return retry(partial(open_chip, Ms5611, section.bus, section.address))
        return retry(partial(open_chip, partial(Bmp3, model=section.kind), section.bus, section.address))
    if section.kind == "nmea":
        return nmea_barometer(section.port, section.baud)
    return vaisala_pa50(section.port, section.baud)


def open_pan_tilt(section: PanTiltSection) -> PanTilt:
    """The head, without torque: nothing moves."""
    return PanTilt(section)


@contextmanager
def connect(config: RigConfig) -> Iterator[Rig]:
    """All devices, opened and their identities checked; closed whatever happens, the head's torque off first.

    Raises what the drivers raise for the first device that is absent, another one, or broken.
    """
    with ExitStack() as stack:
        camera = stack.enter_context(Camera(config.camera))  # opens in its own thread meanwhile
        inclinometer = open_inclinometer(config.inclinometer)
        stack.callback(_close, inclinometer)
        compass = open_compass(config.compass) if config.compass else None
        stack.callback(_close, compass)
        altimeter = open_altimeter(config.altimeter) if config.altimeter else None
        stack.callback(_close, altimeter)
        camera.wait_open()
        readers = stack.enter_context(ThreadPoolExecutor(SENSORS_AT_ONCE, "reader"))
        pan_tilt = stack.enter_context(open_pan_tilt(config.pan_tilt))
        yield Rig(config, pan_tilt, inclinometer, compass, altimeter, camera, readers)


def _close(sensor: Sensor[object] | None) -> None:
    """A sensor that cannot be closed is not worth an error: what it had to say has been said."""
    if sensor is None:
        return
    try:
        sensor.close()
    except RigError as error:
        _log.warning("%s", error)
