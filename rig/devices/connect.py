"""Opens the devices of a configuration: one function each, and all together."""

from collections.abc import Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial

from rig.config.model import RigConfig
from rig.config.sections import (
    AltimeterSection,
    CompassSection,
    I2cAltimeterSection,
    InclinometerSection,
    Mmc5983maSection,
    PanTiltSection,
)
from rig.devices.bus.i2c_chip import open_chip
from rig.devices.camera.driver import Camera
from rig.devices.pan_tilt import PanTilt
from rig.devices.readings import AccelerationReading, FieldReading, HeadingReading, PressureReading
from rig.devices.sensors.adxl355 import Adxl355
from rig.devices.sensors.bmp3 import Bmp3
from rig.devices.sensors.iis2iclx import Iis2iclx
from rig.devices.sensors.mmc5983ma import Mmc5983ma
from rig.devices.sensors.ms5611 import Ms5611
from rig.devices.sensors.reconnecting import ReconnectingSensor, Sensor
from rig.devices.sensors.talker import nmea_barometer, nmea_compass, vaisala_pa50
from rig.errors import DeviceError
from rig.fault_notes import note_fault

SENSORS_AT_ONCE = 3

Inclinometer = Sensor[AccelerationReading]
Compass = Sensor[FieldReading] | Sensor[HeadingReading]
Altimeter = Sensor[PressureReading]


@dataclass(frozen=True)
class Rig:
    """All devices of a rig, open.

    Attributes
    ----------
    config : RigConfig
        That they were opened by.
    pan_tilt : PanTilt
        The head.
    inclinometer : Sensor of AccelerationReading
        In the head. Sensors have ``identify()`` and ``read_many(duration_s)``, and are set up anew after a failed reading.
    compass : Sensor of FieldReading or of HeadingReading, or None
        On the pan stage: a magnetometer chip or a talker; None where there is none.
    altimeter : Sensor of PressureReading, or None
        The barometer; None where there is none.
    camera : Camera
        In the head.
    readers : concurrent.futures.Executor
        Threads for sensors that are read at the same time; no sensor in two at once.
    """

    config: RigConfig
    pan_tilt: PanTilt
    inclinometer: Inclinometer
    compass: Compass | None
    altimeter: Altimeter | None
    camera: Camera
    readers: Executor


def open_inclinometer(section: InclinometerSection) -> Inclinometer:
    """The accelerometer chip, measuring."""
    if section.chip == "adxl355":
        return ReconnectingSensor(partial(open_chip, Adxl355, section.bus, section.address))
    return ReconnectingSensor(partial(open_chip, Iis2iclx, section.bus, section.address))


def open_compass(section: CompassSection) -> Compass:
    """The magnetometer chip or the talker."""
    if isinstance(section, Mmc5983maSection):
        return ReconnectingSensor(partial(open_chip, Mmc5983ma, section.bus, section.address))
    return ReconnectingSensor(
        partial(
            nmea_compass,
            section.port,
            section.baud,
            require_checksum=section.require_checksum,
            sentence=section.sentence,
        )
    )


def open_altimeter(section: AltimeterSection) -> Altimeter:
    """The barometer chip or the talker."""
    if isinstance(section, I2cAltimeterSection):
        if section.kind == "ms5611" or section.kind == "ms5607":
            return ReconnectingSensor(
                partial(open_chip, partial(Ms5611, model=section.kind), section.bus, section.address)
            )
        return ReconnectingSensor(
            partial(open_chip, partial(Bmp3, model=section.kind), section.bus, section.address)
        )
    if section.kind == "nmea":
        return ReconnectingSensor(
            partial(
                nmea_barometer,
                section.port,
                section.baud,
                require_checksum=section.require_checksum,
                transducer=section.transducer,
            )
        )
    return ReconnectingSensor(partial(vaisala_pa50, section.port, section.baud))


def open_pan_tilt(section: PanTiltSection) -> PanTilt:
    """The head, without torque: nothing moves."""
    return PanTilt(section)


@contextmanager
def connect(config: RigConfig, *, skip_failed_sensors: bool = False) -> Iterator[Rig]:
    """Open all devices of a configuration and check their identities.

    At the end of the ``with`` block they are closed whatever happens, the head's torque off first.

    Parameters
    ----------
    config : RigConfig
        From `load_config`.
    skip_failed_sensors : bool
        Leave a compass or an altimeter out that cannot be opened, out of the rig's ``config`` too, and note that: without
        them there are measurements still.

    Yields
    ------
    Rig
        The devices.

    Raises
    ------
    WrongDeviceError
        Another chip or servo answers than is configured.
    TransientError
        A device does not answer.
    DeviceError
        A device is absent, in use, or broken.

    Examples
    --------
    >>> import rig
    >>> config = rig.load_config(config_file)  # config_file = "vehicle.toml"
    >>> with rig.connect(config) as devices:
    ...     print(devices.inclinometer.identify())
    ...     pressure_hpa = devices.altimeter.read_many(0.2)[0].pressure_hpa
    ...     state = devices.pan_tilt.state()
    ADXL355 at 0x1D on ..., revision 1
    >>> 300.0 < pressure_hpa < 1100.0, state.moving
    (True, False)
    """
    with ExitStack() as stack:
        camera = stack.enter_context(Camera(config.camera))  # opens in its own thread meanwhile
        inclinometer = open_inclinometer(config.inclinometer)
        stack.callback(inclinometer.close)
        compass = altimeter = None
        if config.compass:
            with _skipping_if_failed(skip_failed_sensors, "heading unknown"):
                compass = open_compass(config.compass)
                stack.callback(compass.close)
        if config.altimeter:
            with _skipping_if_failed(skip_failed_sensors, "altitude unknown"):
                altimeter = open_altimeter(config.altimeter)
                stack.callback(altimeter.close)
        fitted = {
            "compass": config.compass if compass else None,
            "altimeter": config.altimeter if altimeter else None,
        }
        camera.wait_open()
        readers = stack.enter_context(ThreadPoolExecutor(SENSORS_AT_ONCE, "reader"))
        pan_tilt = stack.enter_context(open_pan_tilt(config.pan_tilt))
        yield Rig(
            config.model_copy(update=fitted), pan_tilt, inclinometer, compass, altimeter, camera, readers
        )


@contextmanager
def _skipping_if_failed(skip_failed_sensors: bool, without: str) -> Iterator[None]:
    """Note the failure of a device and continue without it, if ``skip_failed_sensors``."""
    try:
        yield
    except DeviceError as error:
        if not skip_failed_sensors:
            raise
        note_fault(error.device, error.problem, f"left out: {without}")
