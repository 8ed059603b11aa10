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

MAX_SOFT_IRON = 0.5

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
    if off > MAX_SOFT_IRON:
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
    """``[rig]``: the installation as a whole."""

    name: Annotated[str, Field(min_length=1)]
    """Name of the rig, for logs and bundles."""
    mast_height_m: Annotated[float, Field(gt=0.0, le=100.0)]
    """Height of the camera's optical centre above the ground that the wheels stand on."""
    bundle_dir: Path = Field(default=Path("bundles"), strict=False)
    """Folder that captures go into; ``--out`` overrides it."""
    telemetry_dir: OptionalPath = None
    """Folder that every ``rig capture`` leaves an MCAP file in, for Foxglove; ``--telemetry`` overrides it."""

    def resolved_against(self, folder: Path) -> "RigSection":
        """The section with relative paths resolved against ``folder``."""
        telemetry_dir = folder / self.telemetry_dir if self.telemetry_dir else None
        return self.model_copy(
            update={"bundle_dir": folder / self.bundle_dir, "telemetry_dir": telemetry_dir}
        )


class Place(Section):
    """``[place]``: roughly where the rig works; the magnetic declination is derived from it."""

    lat_deg: Annotated[float, Field(ge=-90.0, le=90.0)]
    """Latitude, WGS84."""
    lon_deg: Annotated[float, Field(ge=-360.0, le=360.0), AfterValidator(wrapped_lon_deg)]
    """Longitude, WGS84."""
    altitude_m: Annotated[float, Field(ge=-500.0, le=9000.0)] = 0.0
    """Altitude. Where it is given, a barometric altitude 3500 m away from it is refused."""


class Servo(Section):
    """``[pan_tilt.pan]`` and ``[pan_tilt.tilt]``: the joint's angle is (tick - zero_tick) * 360/4096 * direction, degrees."""

    id: Annotated[int, Field(ge=0, le=252)]
    """Id of the servo on the bus."""
    model: Literal["XM430-W350", "XL430-W250"]
    """Model of the servo; another one under this id is refused."""
    zero_tick: Annotated[int, Field(ge=0, le=4095)]
    """Position at which the camera looks forward along the vehicle (pan), or at right angles to the pan axis (tilt)."""
    direction: Literal[1, -1]
    """1: ticks grow clockwise seen from above (pan), or as the camera looks up (tilt); -1: the other way."""
    min_deg: Annotated[float, Field(ge=-180.0, le=180.0)]
    """Least angle that the joint is driven to."""
    max_deg: Annotated[float, Field(ge=-180.0, le=180.0)]
    """Largest angle that the joint is driven to."""

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
    """``[[pan_tilt.keep_out]]``: the head is never moved to or through angles inside both ranges."""

    pan_min_deg: Annotated[float, Field(ge=-180.0, le=180.0)] = -180.0
    """Least pan angle of the zone."""
    pan_max_deg: Annotated[float, Field(ge=-180.0, le=180.0)] = 180.0
    """Largest pan angle of the zone."""
    tilt_min_deg: Annotated[float, Field(ge=-180.0, le=180.0)] = -180.0
    """Least tilt angle of the zone."""
    tilt_max_deg: Annotated[float, Field(ge=-180.0, le=180.0)] = 180.0
    """Largest tilt angle of the zone."""

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
    """Serial port of the bus. A name below ``/dev/serial/by-id`` stays the same when devices are plugged in anew."""
    baud: Literal[9600, 57600, 115200, 1_000_000, 2_000_000, 3_000_000, 4_000_000, 4_500_000] = 1_000_000
    """Baud rate as it is set in the servos; they come with 57600 from the factory."""
    velocity_deg_s: Positive = 90.0
    """Speed of the moves."""
    acceleration_deg_s2: Positive = 240.0
    """Acceleration of the moves; lower it if the mast swings."""
    bus_watchdog_ms: Annotated[int, Field(ge=0, le=127 * 20)] = 1000
    """The servos stop by themselves when nothing talks to them for this long; 0: never."""
    settle_timeout_s: Positive = 8.0
    """A move that is not at rest after this time is an error."""
    park_pan_deg: Finite = 0.0
    """Pan angle at which ``rig move --park`` leaves the head."""
    park_tilt_deg: Finite = 0.0
    """Tilt angle at which ``rig move --park`` leaves the head."""
    azimuth_sigma_deg: Positive = 0.1
    """One standard deviation of the pan angle in each frame: encoder (0.09) and backlash."""
    take_up_deg: Annotated[float, Field(ge=0.0, le=10.0)] = 0.0
    """Every pan angle is approached from below, starting this far off, which takes up the gears' backlash."""
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
    """The accelerometer chip."""
    bus: Bus
    """I2C bus: a device (``/dev/i2c-1``), a link to one, the adapter's name (``i2cdetect -l``), or an I2C bridge
    (``tcp://HOST:PORT/BUS``)."""
    address: I2cAddress
    """I2C address: 0x1D or 0x53 (adxl355), 0x6A or 0x6B (iis2iclx)."""
    axes: Annotated[Axes, Field(strict=False)]
    """Which chip axis points to the head's right, forward and up; of iis2iclx the last is its z."""
    average_s: Annotated[float, Field(ge=0.2, le=60.0)] = 1.0
    """Length of one reading."""
    tilt_sigma_deg: Positive = 0.01
    """One standard deviation of a tilt that averaging does not remove (wind, engine)."""
    roll_sigma_deg: Positive = 0.02
    """The same of a roll."""
    tilt_bias_sigma_deg: Positive = 0.02
    """One standard deviation of the tilt's error that all frames share; 2.0 for a chip whose zero was never measured."""
    zero_mg: Triple = (0.0, 0.0, 0.0)
    """Zero error in head axes (right, forward, up) at ``zero_temperature_c``, thousandths of g."""
    scale: Annotated[tuple[Positive, Positive, Positive], Field(strict=False)] = (1.0, 1.0, 1.0)
    """What the chip measures of 1 g, on each axis."""
    mounting_deg: Triple = (0.0, 0.0, 0.0)
    """Rotation vector that turns what the chip measures into the head's axes."""
    drift_mg_c: Triple = (0.0, 0.0, 0.0)
    """Change of the zero error with each degree Celsius."""
    zero_temperature_c: Finite = 20.0
    """Temperature of the chip at which ``zero_mg`` holds."""

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
    """The magnetometer chip."""
    bus: Bus
    """I2C bus, as in ``[inclinometer]``."""
    address: I2cAddress
    """I2C address."""
    axes: Annotated[Axes, Field(strict=False)]
    """Which chip axis points to the right, forward and up at pan 0."""
    declination_deg: Annotated[float, Field(ge=-180.0, le=180.0)] | None = None
    """Magnetic to true north, east positive; where absent, the World Magnetic Model's at ``[place]``."""
    azimuth_bias_sigma_deg: Positive = 1.0
    """One standard deviation of the heading's error that all frames share: 1 at best on a vehicle, 3 beside much iron."""
    heading_offset_deg: HeadingOffset = 0.0
    """Added to headings; ``rig calibrate boresight`` finds it."""
    hard_iron_ut: Triple = (0.0, 0.0, 0.0)
    """Constant field of the pan stage (right, forward, up), which is subtracted. Turning the head measures the first two;
    the third counts on a slope."""
    soft_iron: Matrix = IDENTITY
    """What the pan stage's iron makes of the field around it: measured = soft_iron @ field + hard_iron_ut."""
    vehicle_hard_iron_ut: Triple = (0.0, 0.0, 0.0)
    """Constant field of the vehicle (right, forward, up)."""
    vehicle_soft_iron: Matrix = IDENTITY
    """What the vehicle's iron makes of the Earth's field."""


class NmeaCompassSection(Section):
    """``[compass]`` with ``kind = "nmea"``: a serial talker; HDG, HDM, HDT, THS, PTNTHPR, OHPR or OceanServer's $C."""

    kind: Literal["nmea"]
    """A compass that talks NMEA 0183."""
    port: Port
    """Serial port. An altimeter that talks, too, may have the same."""
    baud: Baud = 4800
    """Baud rate."""
    require_checksum: bool = True
    """Whether a sentence without a checksum is refused."""
    sentence: Annotated[str, Field(min_length=2)] | None = None
    """The one sentence that is read, as HCHDG, or HDG of any talker; all that give a heading where absent."""
    declination_deg: Annotated[float, Field(ge=-180.0, le=180.0)] | None = None
    """Magnetic to true north, east positive. Not needed where the compass gives true headings (HDT, THS) or a variation,
    nor with ``[place]``."""
    azimuth_bias_sigma_deg: Positive = 1.0
    """One standard deviation of the heading's error that all frames share."""
    heading_offset_deg: HeadingOffset = 0.0
    """Added to headings; ``rig calibrate boresight`` finds it."""


class _AltimeterSection(Section):
    reference_pressure_hpa: Annotated[float, Field(ge=300.0, le=1100.0)]
    """Pressure that was read at ``reference_altitude_m``; or the QNH, with an altitude of 0."""
    reference_altitude_m: Annotated[float, Field(ge=-500.0, le=9000.0)]
    """Altitude above the DEM's vertical datum at which the pressure was read."""
    reference_temperature_c: Annotated[float, Field(ge=-60.0, le=60.0)] | None = None
    """Air temperature there at the time; the standard atmosphere's where absent."""
    sigma_m: Positive = 5.0
    """One standard deviation of the altitude; weather moves it by 6 m an hour on a normal day."""
    reference_time: Annotated[AwareDatetime, Field(strict=False)] | None = None
    """When the reference was taken; with it, ``sigma_m`` grows from then on by ``drift_m_h``."""
    drift_m_h: NonNegative = 0.0
    """By how much the altitude's standard deviation grows each hour after ``reference_time``."""


class I2cAltimeterSection(_AltimeterSection):
    """``[altimeter]``: a barometer chip."""

    kind: Literal["bmp390", "bmp388", "ms5611", "ms5607"]
    """The barometer chip. ms5611 and ms5607 answer alike: look at what is soldered."""
    bus: Bus
    """I2C bus, as in ``[inclinometer]``."""
    address: I2cAddress
    """I2C address: 0x76 or 0x77."""


class SerialAltimeterSection(_AltimeterSection):
    """``[altimeter]``: a barometer talker on a serial port, NMEA (XDR, MDA) or Vaisala PA50."""

    kind: Literal["nmea", "vaisala-pa50"]
    """nmea: a talker of XDR, MDA or MMB; vaisala-pa50: a Vaisala PA50."""
    port: Port
    """Serial port. A compass that talks, too, may have the same."""
    baud: Baud = 4800
    """Baud rate."""
    require_checksum: bool = True
    """Whether a sentence without a checksum is refused; of kind nmea."""
    transducer: Annotated[str, Field(min_length=1)] | None = None
    """The one transducer of XDR that is read, or a sentence (WIMDA); of kind nmea. Where absent, the one that is named like
    a barometer, else the first that measures air."""

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
    """V4L2 device or its number, the URL of a stream (http, rtsp), or the URL of a picture (http), which is fetched for
    each frame."""
    width_px: Annotated[int, Field(ge=16)]
    """Width of the pictures; a camera that delivers another size is refused, since the intrinsics would not hold."""
    height_px: Annotated[int, Field(ge=16)]
    """Height of the pictures."""
    fx_px: Positive
    """Focal length in widths of a pixel, as OpenCV's calibrateCamera gives it."""
    fy_px: Positive
    """Focal length in heights of a pixel."""
    cx_px: Finite
    """Column of the principal point; 0 is the centre of the left column."""
    cy_px: Finite
    """Row of the principal point; 0 is the centre of the top row."""
    distortion: Annotated[tuple[Finite, Finite, Finite, Finite, Finite], Field(strict=False)] = (0.0,) * 5
    """OpenCV's k1, k2, p1, p2, k3."""
    frames_per_direction: Annotated[int, Field(ge=1, le=100)] = 4
    """Pictures that are averaged in each direction, against noise."""
    exposure_settle_s: Annotated[float, Field(ge=0.0, le=30.0)] = 0.3
    """Wait after a move for the automatic exposure."""
    exposure_url: Annotated[str, Field(pattern=r"^https?://.*\{ev\}")] | None = None
    """Of a network camera: the URL that sets the exposure, in stops from the automatic one, with ``{ev}`` for the
    number."""
    fourcc: Annotated[str, Field(pattern=r"^[0-9A-Za-z ]{4}$")] | None = None
    """Format of the pictures as ``v4l2-ctl --list-formats-ext`` names it; the driver's where absent. Local cameras only, as
    the next four."""
    exposure: Positive | None = None
    """Fixed exposure in the driver's unit (V4L2: 100 µs); automatic where absent."""
    gain: NonNegative | None = None
    """Fixed gain in the driver's unit; the driver's where absent."""
    white_balance_k: Annotated[float, Field(ge=1000.0, le=20_000.0)] | None = None
    """Fixed white balance; as it is where absent."""
    focus: NonNegative | None = None
    """Fixed focus in the driver's unit, autofocus off; as it is where absent. The intrinsics change with the focus."""
    open_timeout_s: Positive = 5.0
    """A camera that takes longer to open is an error."""
    read_timeout_s: Positive = 2.0
    """A stream that is silent for this long is an error."""
    boresight_azimuth_deg: Annotated[float, Field(ge=-45.0, le=45.0)] = 0.0
    """How the camera sits in the head: to the right."""
    boresight_tilt_deg: Annotated[float, Field(ge=-45.0, le=45.0)] = 0.0
    """How the camera sits in the head: up."""
    boresight_roll_deg: Annotated[float, Field(ge=-180.0, le=180.0)] = 0.0
    """How the camera sits in the head: clockwise, seen from behind."""
    boresight_azimuth_sigma_deg: NonNegative = 0.0
    """One standard deviation of ``boresight_azimuth_deg``."""
    boresight_tilt_sigma_deg: NonNegative = 0.0
    """One standard deviation of ``boresight_tilt_deg``."""
    boresight_roll_sigma_deg: NonNegative = 0.0
    """One standard deviation of ``boresight_roll_deg``."""

    @model_validator(mode="after")
    def _principal_point_in_the_picture(self) -> Self:
        for key, value, size in (("cx_px", self.cx_px, self.width_px), ("cy_px", self.cy_px, self.height_px)):
            if not 0.0 <= value <= size - 1:
                raise ValueError(f"{key} {value:g} lies outside the picture of {size} px")
        return self

    @property
    def is_local(self) -> bool:
        """Whether it is a video device of this computer, controlled through its driver."""
        return isinstance(self.source, int) or self.source.startswith("/dev/")

    @model_validator(mode="after")
    def _driver_keys_are_for_a_local_camera(self) -> Self:
        for key in ("fourcc", "exposure", "gain", "white_balance_k", "focus"):
            if getattr(self, key) is not None and not self.is_local:
                raise ValueError(f"{key} is set in the driver of a local camera; source is a stream")
        return self


class CaptureSection(Section):
    """``[capture]``: settings of one capture."""

    directions: Annotated[tuple[str | float, ...], Field(strict=False)] = ("N", "E", "S", "W")
    """Directions of the frames: letters, or degrees from true north."""
    base_attitude_pan_angles_deg: Annotated[tuple[Finite, ...], Field(strict=False)] = (
        -135.0,
        -45.0,
        45.0,
        135.0,
    )
    """Pan angles at which levels and heading are read first."""
    skyline_margin_fraction: Annotated[float, Field(ge=0.0, lt=0.5)] = 0.15
    """Share of the picture's height that the skyline keeps from the upper and the lower edge."""
    oldest_reading_s: Positive = 300.0
    """A bundle with an older reading is refused."""

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
    """``[calibration]``: files of ``rig calibrate``, relative to this one; their values replace keys of the sections."""

    camera: OptionalPath = None
    """Calibration of the camera."""
    inclinometer: OptionalPath = None
    """Calibration of the inclinometer."""
    compass: OptionalPath = None
    """Calibration of the compass."""
    altimeter: OptionalPath = None
    """Calibration of the altimeter."""
    boresight: OptionalPath = None
    """Calibration of the boresight."""


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
