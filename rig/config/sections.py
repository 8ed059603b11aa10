"""The sections of the rig's configuration file: every key with its unit, its range and its default.

``configs/vehicle.toml`` explains each key to the engineer who installs the rig.
"""

import re
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, AwareDatetime, BeforeValidator, Field, field_validator, model_validator

from localizer.dem.crs import wrapped_lon_deg
from rig.config.directions import Direction, parse_directions
from rig.config.i2c_names import checked_bus
from rig.config.run import RunSection
from rig.config.section import Section

MOST_SOFT_IRON = 0.5

Rows = tuple[tuple[float, float, float], ...]


def _camera_source(source: object) -> object:
    if isinstance(source, bool) or not isinstance(source, int | str) or source == "":
        raise ValueError("give a URL, a path (/dev/video0) or the number of a video device (0)")
    return source


def _signed_axes(axes: tuple[str, str, str]) -> tuple[str, str, str]:
    if any(not re.fullmatch(r"[+-][xyz]", axis) for axis in axes) or len({axis[1] for axis in axes}) != 3:
        raise ValueError('each of x, y and z once, with its sign, for example ["+x", "+y", "+z"]')
    return axes


def _near_identity(rows: Rows) -> Rows:
    off = max(abs(value - (i == j)) for i, row in enumerate(rows) for j, value in enumerate(row))
    if off > MOST_SOFT_IRON:
        raise ValueError(f"three rows of three, close to the identity; one value is {off:.2f} off")
    return rows


Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
HeadingOffset = Annotated[float, Field(ge=-180.0, le=180.0)]
Triple = Annotated[tuple[Finite, Finite, Finite], Field(strict=False)]
Row = Annotated[tuple[Finite, Finite, Finite], Field(strict=False)]
Matrix = Annotated[tuple[Row, Row, Row], Field(strict=False), AfterValidator(_near_identity)]
IDENTITY = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
Bus = Annotated[str, BeforeValidator(checked_bus)]
I2cAddress = Annotated[int, Field(ge=0x08, le=0x77)]
Port = Annotated[str, Field(min_length=1)]
Baud = Annotated[int, Field(ge=300)]
OptionalPath = Annotated[Path | None, Field(strict=False)]
Axes = Annotated[tuple[str, str, str], AfterValidator(_signed_axes)]
"""The chip axis that points to the head's x (right), y (forward) and z (up), in this order."""


class RigSection(Section):
    """``[rig]``: what belongs to the installation as a whole."""

    name: Annotated[str, Field(min_length=1)]
    mast_height_m: Annotated[float, Field(gt=0.0, le=100.0)]
    bundle_dir: Path = Field(default=Path("bundles"), strict=False)
    telemetry_dir: OptionalPath = None

    def beside(self, folder: Path) -> "RigSection":
        """The same with relative paths taken from ``folder``."""
        telemetry_dir = folder / self.telemetry_dir if self.telemetry_dir else None
        return self.model_copy(
            update={"bundle_dir": folder / self.bundle_dir, "telemetry_dir": telemetry_dir}
        )


class Place(Section):
    """``[place]``: roughly where the rig works; nothing but the magnetic declination is derived from it."""

    lat_deg: Annotated[float, Field(ge=-90.0, le=90.0)]
    lon_deg: Annotated[float, Field(ge=-360.0, le=360.0), AfterValidator(wrapped_lon_deg)]
    altitude_m: Annotated[float, Field(ge=-500.0, le=9000.0)] = 0.0


class Servo(Section):
    """``[pan_tilt.pan]`` and ``[pan_tilt.tilt]``: angle_deg = (tick - zero_tick) * 360/4096 * direction."""

    id: Annotated[int, Field(ge=0, le=252)]
    model: Literal["XM430-W350", "XL430-W250"]
    zero_tick: Annotated[int, Field(ge=0, le=4095)]
    direction: Literal[1, -1]
    min_deg: Annotated[float, Field(ge=-180.0, le=180.0)]
    max_deg: Annotated[float, Field(ge=-180.0, le=180.0)]

    def angle_deg(self, tick: int) -> float:
        """The joint angle at a position."""
        return (tick - self.zero_tick) * self.direction * 360.0 / 4096

    @model_validator(mode="after")
    def _limits_are_a_range_that_the_servo_reaches(self) -> Self:
        if self.min_deg >= self.max_deg:
            raise ValueError(f"min_deg {self.min_deg:g} is not below max_deg {self.max_deg:g}")
        for key, angle_deg in (("min_deg", self.min_deg), ("max_deg", self.max_deg)):
            tick = round(self.zero_tick + self.direction * angle_deg * 4096 / 360)
            if not 0 <= tick <= 4095:
                raise ValueError(
                    f"{key} {angle_deg:g} with zero_tick {self.zero_tick} is tick {tick}, not in 0 to 4095"
                )
        return self


class KeepOut(Section):
    """``[[pan_tilt.keep_out]]``: pan and tilt between these angles at the same time are never driven to or through."""

    pan_min_deg: Annotated[float, Field(ge=-180.0, le=180.0)] = -180.0
    pan_max_deg: Annotated[float, Field(ge=-180.0, le=180.0)] = 180.0
    tilt_min_deg: Annotated[float, Field(ge=-180.0, le=180.0)] = -180.0
    tilt_max_deg: Annotated[float, Field(ge=-180.0, le=180.0)] = 180.0

    @model_validator(mode="after")
    def _is_a_part_of_the_range(self) -> Self:
        if not (self.pan_min_deg < self.pan_max_deg and self.tilt_min_deg < self.tilt_max_deg):
            raise ValueError("a keep-out zone needs each min_deg below its max_deg")
        return self


class PanTiltSection(Section):
    """``[pan_tilt]``: two Dynamixel X servos on one bus.

    Examples
    --------
    >>> import rig
    >>> servo = {"model": "XM430-W350", "zero_tick": 2048, "direction": 1, "min_deg": -40.0, "max_deg": 60.0}
    >>> axes = {"pan": {"id": 1, **servo}, "tilt": {"id": 2, **servo}}
    >>> rig.PanTiltSection.model_validate({"port": "/dev/ttyUSB0", **axes}).velocity_deg_s
    90.0
    """

    port: Port
    baud: Literal[9600, 57600, 115200, 1_000_000, 2_000_000, 3_000_000, 4_000_000, 4_500_000] = 1_000_000
    velocity_deg_s: Positive = 90.0
    acceleration_deg_s2: Positive = 240.0
    bus_watchdog_ms: Annotated[int, Field(ge=0, le=127 * 20)] = 1000
    settle_timeout_s: Positive = 8.0
    park_pan_deg: Finite = 0.0
    park_tilt_deg: Finite = 0.0
    azimuth_sigma_deg: Positive = 0.1
    take_up_deg: Annotated[float, Field(ge=0.0, le=10.0)] = 0.0
    pan: Servo
    tilt: Servo
    keep_out: Annotated[tuple[KeepOut, ...], Field(strict=False)] = ()

    @model_validator(mode="after")
    def _two_servos_and_a_level_head(self) -> Self:
        if self.pan.id == self.tilt.id:
            raise ValueError(f"pan and tilt have the same id {self.pan.id}; give each servo its own")
        if not self.tilt.min_deg < 0.0 < self.tilt.max_deg:
            raise ValueError(
                "[pan_tilt.tilt] must reach both below and above 0 degrees; look at min_deg and max_deg"
            )
        return self


class InclinometerSection(Section):
    """``[inclinometer]``: an accelerometer chip in the head."""

    chip: Literal["adxl355", "iis2iclx"]
    bus: Bus
    address: I2cAddress
    axes: Annotated[Axes, Field(strict=False)]
    average_s: Annotated[float, Field(ge=0.2, le=60.0)] = 1.0
    tilt_sigma_deg: Positive = 0.01
    roll_sigma_deg: Positive = 0.02
    tilt_bias_sigma_deg: Positive = 0.02
    zero_mg: Triple = (0.0, 0.0, 0.0)
    scale: Annotated[tuple[Positive, Positive, Positive], Field(strict=False)] = (1.0, 1.0, 1.0)
    mounting_deg: Triple = (0.0, 0.0, 0.0)
    drift_mg_c: Triple = (0.0, 0.0, 0.0)
    zero_temperature_c: Finite = 20.0

    @field_validator("axes")
    @classmethod
    def _right_handed(cls, axes: tuple[str, str, str]) -> tuple[str, str, str]:
        order = "".join(axis[1] for axis in axes)
        even = order in "xyzxy"
        if even == (sum(axis[0] == "-" for axis in axes) % 2 == 1):
            raise ValueError(
                f"{list(axes)} mirrors the chip; a chip that is only turned has another sign on one axis"
            )
        return axes

    @model_validator(mode="after")
    def _two_axis_chip_lies_flat(self) -> Self:
        if self.chip == "iis2iclx" and self.axes[2][1] != "z":
            raise ValueError("axes: iis2iclx measures x and y only, so its z must be the head's z")
        return self


class Mmc5983maSection(Section):
    """``[compass]`` with ``kind = "mmc5983ma"``: a magnetometer chip on the pan stage."""

    kind: Literal["mmc5983ma"]
    bus: Bus
    address: I2cAddress
    axes: Annotated[Axes, Field(strict=False)]
    declination_deg: Annotated[float, Field(ge=-180.0, le=180.0)] | None = None
    azimuth_bias_sigma_deg: Positive = 1.0
    heading_offset_deg: HeadingOffset = 0.0
    hard_iron_ut: Triple = (0.0, 0.0, 0.0)
    soft_iron: Matrix = IDENTITY
    vehicle_hard_iron_ut: Triple = (0.0, 0.0, 0.0)
    vehicle_soft_iron: Matrix = IDENTITY


class NmeaCompassSection(Section):
    """``[compass]`` with ``kind = "nmea"``: a serial talker; HDG, HDM, HDT, THS, PTNTHPR, OHPR or OceanServer's $C."""

    kind: Literal["nmea"]
    port: Port
    baud: Baud = 4800
    require_checksum: bool = True
    sentence: Annotated[str, Field(min_length=2)] | None = None
    declination_deg: Annotated[float, Field(ge=-180.0, le=180.0)] | None = None
    azimuth_bias_sigma_deg: Positive = 1.0
    heading_offset_deg: HeadingOffset = 0.0


class _AltimeterSection(Section):
    reference_pressure_hpa: Annotated[float, Field(ge=300.0, le=1100.0)]
    reference_altitude_m: Annotated[float, Field(ge=-500.0, le=9000.0)]
    reference_temperature_c: Annotated[float, Field(ge=-60.0, le=60.0)] | None = None
    sigma_m: Positive = 5.0
    reference_time: Annotated[AwareDatetime, Field(strict=False)] | None = None
    drift_m_h: NonNegative = 0.0


class I2cAltimeterSection(_AltimeterSection):
    """``[altimeter]``: a barometer chip."""

    kind: Literal["bmp390", "bmp388", "ms5611", "ms5607"]
    bus: Bus
    address: I2cAddress


class SerialAltimeterSection(_AltimeterSection):
    """``[altimeter]``: a barometer that talks on a serial port, NMEA (XDR, MDA) or Vaisala PA50."""

    kind: Literal["nmea", "vaisala-pa50"]
    port: Port
    baud: Baud = 4800
    require_checksum: bool = True
    transducer: Annotated[str, Field(min_length=1)] | None = None

    @model_validator(mode="after")
    def _transducers_are_of_nmea(self) -> Self:
        if self.kind != "nmea" and (self.transducer is not None or not self.require_checksum):
            raise ValueError(f"transducer and require_checksum are for kind nmea, not for {self.kind}")
        return self


CompassSection = Mmc5983maSection | NmeaCompassSection

AltimeterSection = I2cAltimeterSection | SerialAltimeterSection


class CameraSection(Section):
    """``[camera]``: where the pictures come from, the lens, and how the camera sits in the head.

    Examples
    --------
    >>> import rig
    >>> lens = {"fx_px": 492.8, "fy_px": 492.8, "cx_px": 319.5, "cy_px": 239.5}
    >>> section = rig.CameraSection.model_validate({"source": "/dev/video0", "width_px": 640, "height_px": 480, **lens})
    >>> section.is_local
    True
    """

    source: Annotated[int | str, BeforeValidator(_camera_source)]
    width_px: Annotated[int, Field(ge=16)]
    height_px: Annotated[int, Field(ge=16)]
    fx_px: Positive
    fy_px: Positive
    cx_px: Finite
    cy_px: Finite
    distortion: Annotated[tuple[Finite, Finite, Finite, Finite, Finite], Field(strict=False)] = (0.0,) * 5
    frames_per_direction: Annotated[int, Field(ge=1, le=100)] = 4
    exposure_settle_s: Annotated[float, Field(ge=0.0, le=30.0)] = 0.3
    exposure_url: Annotated[str, Field(pattern=r"^https?://.*\{ev\}")] | None = None
    fourcc: Annotated[str, Field(pattern=r"^[0-9A-Za-z ]{4}$")] | None = None
    exposure: Positive | None = None
    gain: NonNegative | None = None
    white_balance_k: Annotated[float, Field(ge=1000.0, le=20_000.0)] | None = None
    focus: NonNegative | None = None
    open_timeout_s: Positive = 5.0
    read_timeout_s: Positive = 2.0
    boresight_azimuth_deg: Annotated[float, Field(ge=-45.0, le=45.0)] = 0.0
    boresight_tilt_deg: Annotated[float, Field(ge=-45.0, le=45.0)] = 0.0
    boresight_roll_deg: Annotated[float, Field(ge=-180.0, le=180.0)] = 0.0
    boresight_azimuth_sigma_deg: NonNegative = 0.0
    boresight_tilt_sigma_deg: NonNegative = 0.0
    boresight_roll_sigma_deg: NonNegative = 0.0

    @model_validator(mode="after")
    def _principal_point_in_the_picture(self) -> Self:
        for key, value, size in (("cx_px", self.cx_px, self.width_px), ("cy_px", self.cy_px, self.height_px)):
            if not 0.0 <= value <= size - 1:
                raise ValueError(f"{key} {value:g} lies outside the picture of {size} px")
        return self

    @property
    def is_local(self) -> bool:
        """Whether it is a video device of this computer, which is told things by its driver."""
        return isinstance(self.source, int) or self.source.startswith("/dev/")

    @model_validator(mode="after")
    def _driver_keys_are_for_a_local_camera(self) -> Self:
        for key in ("fourcc", "exposure", "gain", "white_balance_k", "focus"):
            if getattr(self, key) is not None and not self.is_local:
                raise ValueError(
                    f"{key} is told to the driver of a camera of this computer; source is a stream"
                )
        return self


class CaptureSection(Section):
    """``[capture]``: what one capture does."""

    directions: Annotated[tuple[str | float, ...], Field(strict=False)] = ("N", "E", "S", "W")
    base_attitude_pan_angles_deg: Annotated[tuple[Finite, ...], Field(strict=False)] = (
        -135.0,
        -45.0,
        45.0,
        135.0,
    )
    skyline_margin_fraction: Annotated[float, Field(ge=0.0, lt=0.5)] = 0.15
    oldest_reading_s: Positive = 300.0

    @field_validator("directions")
    @classmethod
    def _are_directions(cls, directions: tuple[str | float, ...]) -> tuple[str | float, ...]:
        parse_directions([str(direction) for direction in directions])
        return directions

    @field_validator("base_attitude_pan_angles_deg")
    @classmethod
    def _turn_far_enough(cls, angles_deg: tuple[float, ...]) -> tuple[float, ...]:
        if len(set(angles_deg)) < 3 or max(angles_deg) - min(angles_deg) < 90.0:
            raise ValueError("at least three different angles, 90 degrees or more from the first to the last")
        return angles_deg

    def parsed_directions(self) -> list[Direction]:
        """The directions with their labels, in the order of the file."""
        return parse_directions([str(direction) for direction in self.directions])


class CalibrationSection(Section):
    """``[calibration]``: files of ``rig calibrate``, relative to this one; what they found replaces keys of the sections."""

    camera: OptionalPath = None
    inclinometer: OptionalPath = None
    compass: OptionalPath = None
    altimeter: OptionalPath = None
    boresight: OptionalPath = None


class AllSections(Section):
    """One field for each section of the file, its name the section's."""

    rig: RigSection
    place: Place | None = None
    pan_tilt: PanTiltSection
    inclinometer: InclinometerSection
    compass: Annotated[CompassSection, Field(discriminator="kind")] | None = None
    altimeter: Annotated[AltimeterSection, Field(discriminator="kind")] | None = None
    camera: CameraSection
    capture: CaptureSection = CaptureSection()
    calibration: CalibrationSection = CalibrationSection()
    run: RunSection | None = None
