# What is exported, and from where: lazy_loader reads it when ``rig`` is imported, type checkers read it as it is.

from .bundle.writer import (
    BundleAltitude,
    BundleCamera,
    BundleWriteError,
    FrameRecord,
    Measurement,
    write_bundle,
)
from .capture.bundle import capture_bundle
from .capture.sequence import CaptureError
from .config.load import load_config
from .config.model import RigConfig
from .config.sections import CameraSection, PanTiltSection
from .devices.bus.deadline import Deadline
from .devices.bus.i2c import I2cBus, open_i2c
from .devices.bus.i2c_chip import open_chip
from .devices.bus.serial_port import SerialPort
from .devices.camera.driver import Camera
from .devices.camera.frames import TimedFrame
from .devices.connect import Rig, connect
from .devices.dynamixel.servo import Servo, ServoState
from .devices.dynamixel.servo_bus import ServoBus
from .devices.pan_tilt import HeadState, PanTilt
from .devices.readings import AccelerationReading, FieldReading, HeadingReading, PressureReading
from .devices.sensors.adxl355 import Adxl355
from .devices.sensors.bmp3 import Bmp3
from .devices.sensors.iis2iclx import Iis2iclx
from .devices.sensors.mmc5983ma import Mmc5983ma
from .devices.sensors.ms5611 import Ms5611
from .devices.sensors.talker import nmea_barometer, nmea_compass, vaisala_pa50
from .errors import (
    ConfigError,
    DeviceError,
    GoalError,
    LostPortError,
    RigError,
    SkyfixError,
    TransientError,
    WrongDeviceError,
)
from .version import __version__

__all__ = [
    "AccelerationReading",
    "Adxl355",
    "Bmp3",
    "BundleAltitude",
    "BundleCamera",
    "BundleWriteError",
    "Camera",
    "CameraSection",
    "CaptureError",
    "ConfigError",
    "Deadline",
    "DeviceError",
    "FieldReading",
    "FrameRecord",
    "GoalError",
    "HeadState",
    "HeadingReading",
    "I2cBus",
    "Iis2iclx",
    "LostPortError",
    "Measurement",
    "Mmc5983ma",
    "Ms5611",
    "PanTilt",
    "PanTiltSection",
    "PressureReading",
    "Rig",
    "RigConfig",
    "RigError",
    "SerialPort",
    "Servo",
    "ServoBus",
    "ServoState",
    "SkyfixError",
    "TimedFrame",
    "TransientError",
    "WrongDeviceError",
    "__version__",
    "capture_bundle",
    "connect",
    "load_config",
    "nmea_barometer",
    "nmea_compass",
    "open_chip",
    "open_i2c",
    "vaisala_pa50",
    "write_bundle",
]
