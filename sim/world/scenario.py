"""The scenario: the size of every error source of a simulated rig; defaults are realistic.

Sigmas are those of the random draws; the values drawn for a seed are in ``World.biases``.
"""

from pathlib import Path
from typing import Annotated, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from sim.devices.x_series import MODELS
from sim.errors import SimulationError
from sim.shipped_files import SCENARIOS, scenario_file

InclinometerChip = Literal["adxl355", "iis2iclx"]
SolderedInclinometer = Literal["adxl355", "adxl357", "iis2iclx", "ism330dhcx"]
SolderedAltimeter = Literal["ms5611", "ms5607"]
CompassKind = Literal["mmc5983ma", "hdg", "hdm", "hdt", "ths", "ptnthpr", "ohpr", "os5000"]
AltimeterKind = Literal["bmp390", "bmp388", "ms5611", "ms5607", "xdr", "mda", "vaisala-pa50"]
CompassQuirk = Literal[
    "variation-zero", "variation-as-deviation", "variation-twice", "magnetic-as-true", "true-marked-magnetic", "no-value",
    "manual", "no-checksum", "carriage-return", "zero-byte", "tagged", "whole-degrees", "two-compasses", "hdg-and-hdm",
]  # fmt: skip
BarometerQuirk = Literal[
    "two-decimals", "engine-first", "two-pressures", "empty-group", "hpa-labelled-bar", "two-barometers", "inches-finer",
    "kelvin",
]  # fmt: skip
"""Quirks of talkers: reported non-standard sentences, sent instead of the standard one."""
ServoModel = Literal["XM430-W350", "XL430-W250"]
Sky = Literal["clear", "scattered", "broken", "overcast", "drawn"]

NonNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Latitude = Annotated[float, Field(ge=-89.0, le=89.0)]
Longitude = Annotated[float, Field(ge=-360.0, le=360.0)]

Model = TypeVar("Model", bound=BaseModel)


class Section(BaseModel):
    """Immutable, without unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Place(Section):
    """The vehicle's place: drawn under these conditions, or given in WGS84 by both coordinates."""

    lat_deg: Latitude | None = None
    lon_deg: Longitude | None = None
    stop: Annotated[int, Field(ge=0)] = (
        0  # stop of a trip: another number gives another place and attitude; same rig, same weather
    )
    max_slope_deg: Positive = 25.0  # what the vehicle can drive on
    edge_margin_m: NonNegative = 1000.0  # the place, and what forms its horizon, stay this far inside the DEM
    enclosed_fraction: Annotated[float, Field(ge=0.0, le=1.0)] = (
        0.9  # of the azimuths must end on such terrain
    )

    @model_validator(mode="after")
    def _both_or_none(self) -> "Place":
        if (self.lat_deg is None) != (self.lon_deg is None):
            raise ValueError("give both lat_deg and lon_deg, or neither")
        return self


class Vehicle(Section):
    """The vehicle: the base of the head."""

    mast_height_m: Positive = 2.0
    max_tilt_deg: Annotated[float, Field(ge=0.0, le=30.0)] = 6.0  # of the base, in a random direction
    heading_deg: Annotated[float, Field(ge=0.0, lt=360.0)] | None = None  # true; drawn when absent


class Boresight(Section):
    """Mounting error of the camera in the head, unknown to the rig."""

    azimuth_sigma_deg: NonNegative = 0.05
    tilt_sigma_deg: NonNegative = 0.01
    roll_sigma_deg: NonNegative = 0.02


class Servo(Section):
    """The pan and tilt motors; quantisation to 4096 ticks a turn comes with the device."""

    pan_model: ServoModel = "XM430-W350"
    tilt_model: ServoModel = "XM430-W350"
    backlash_deg: NonNegative = 0.05  # total backlash between gear and head
    settle_sigma_deg: NonNegative = 0.03  # error of the resting position from static friction
    encoder_noise_ticks: NonNegative = 0.2  # of one reading
    zero_sigma_deg: NonNegative = 0.0  # of each joint: error of the installer's zero tick
    swing_deg: NonNegative = 0.1  # swing of the head after a stop from 60 deg/s
    max_velocity_deg_s: Positive = 240.0  # limit of the motor, whatever its profile
    supply_voltage_v: Positive = 12.0
    pan_turned_deg: Finite = 0.0  # turned by hand since power-on, from the parking position
    tilt_turned_deg: Finite = 0.0
    pan_left: dict[str, int] = Field(
        default_factory=dict
    )  # registers as another program left them: homing_offset = 500
    tilt_left: dict[str, int] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _registers_are_known(self) -> "Servo":
        for key, model, left in (
            ("pan_left", self.pan_model, self.pan_left),
            ("tilt_left", self.tilt_model, self.tilt_left),
        ):
            known = {field.name: field for field in MODELS[model].fields if field.low is not None}
            for name, value in left.items():
                field = known.get(name)
                if field is None:
                    raise ValueError(f"{key}: an {model} has no register {name!r} to write")
                assert field.low is not None
                assert field.high is not None
                if not field.low <= value <= field.high:
                    raise ValueError(f"{key}: {name} is {field.low} to {field.high}, not {value}")
        return self


class Inclinometer(Section):
    """Accelerometer in the head."""

    chip: InclinometerChip = "adxl355"
    soldered: SolderedInclinometer | None = None  # the chip really fitted, if it differs from its label
    noise_density_ug_rthz: NonNegative = 22.5
    zero_offset_sigma_mg: NonNegative = 0.2  # per axis, what is left after zeroing
    temperature_drift_sigma_mg_c: NonNegative = 0.02  # per axis and degree away from 20 C, where zeroed
    mounting_sigma_deg: NonNegative = 0.0  # per axis: mounting error of the chip in the head
    scale_sigma: NonNegative = 0.0  # per axis, as a share


class Compass(Section):
    """Magnetometer on the pan stage, or a talker there."""

    kind: CompassKind = "mmc5983ma"
    quirk: CompassQuirk | None = None  # of a talker
    noise_ut: NonNegative = 0.04  # per axis and sample
    hard_iron_sigma_ut: NonNegative = 5.0  # per axis, fixed to the pan stage
    hard_iron_calibration_sigma_ut: NonNegative = 0.2  # per axis, error of the crew's calibration of it
    soft_iron_sigma: NonNegative = 0.0  # per element of the pan stage's symmetric matrix
    vehicle_hard_iron_sigma_ut: NonNegative = 0.0  # per axis, fixed to the vehicle
    vehicle_soft_iron_sigma: NonNegative = 0.0  # per element of the vehicle's symmetric matrix
    declination_anomaly_sigma_deg: NonNegative = 0.4  # the local field against the World Magnetic Model
    disturbance_enu_ut: tuple[Finite, Finite, Finite] = (0.0, 0.0, 0.0)  # of iron or a current near the rig
    motor_current_field_ut: NonNegative = 8.0  # while a motor moves
    holding_current_field_ut: NonNegative = 0.0  # while the motors hold the head with torque
    bridge_offset_sigma_ut: NonNegative = 15.0  # of the chip, per axis; removed by SET and RESET
    talker_noise_deg: NonNegative = 0.2  # per sentence, for kinds that send headings

    @model_validator(mode="after")
    def _only_talkers_have_quirks(self) -> "Compass":
        if self.quirk and self.kind == "mmc5983ma":
            raise ValueError(f"quirk {self.quirk} is of a talker; give another kind than {self.kind}")
        return self


class Altimeter(Section):
    """Barometer, and the reference pressure that the crew wrote down before they left."""

    kind: AltimeterKind = "bmp390"
    quirk: BarometerQuirk | None = None  # of a talker
    on_compass_port: bool = False  # one serial stream carries both talkers
    soldered: SolderedAltimeter | None = None  # the chip really fitted instead of an ms5611 or ms5607
    noise_hpa: NonNegative = 0.01  # per reading
    bias_sigma_hpa: NonNegative = 0.25
    reference_sigma_hpa: NonNegative = 0.1  # error of the pressure written down
    reference_temperature_sigma_c: NonNegative = 1.0
    reference_age_h: NonNegative = 1.0
    weather_drift_sigma_hpa_h: NonNegative = 0.4  # of the weather since then

    @model_validator(mode="after")
    def _only_talkers_have_quirks(self) -> "Altimeter":
        if (self.quirk or self.on_compass_port) and self.kind not in ("xdr", "mda", "vaisala-pa50"):
            raise ValueError(f"quirk and on_compass_port are of a talker; give another kind than {self.kind}")
        return self


class Weather(Section):
    """Air and light."""

    sea_level_pressure_hpa: Positive | None = None  # drawn around 1015 when absent
    sea_level_temperature_c: Annotated[float, Field(ge=-60.0, le=60.0)] | None = (
        None  # drawn around 18 when absent
    )
    lapse_rate_k_km: NonNegative = 6.5
    visibility_km: Positive = 60.0
    sky: Sky = "drawn"  # drawn: one of the four others
    sun_azimuth_deg: Annotated[float, Field(ge=0.0, lt=360.0)] | None = None
    sun_elevation_deg: Annotated[float, Field(ge=-5.0, le=90.0)] | None = (
        None  # drawn from 8 to 65 when absent
    )
    snow_line_m: Finite | None = None  # snow lies above it; none when absent
    decimal_year: Annotated[float, Field(ge=2025.0, lt=2030.0)] = 2026.9  # for the magnetic field (WMM2025)


class CameraOptics(Section):
    """The true camera, and the errors of the intrinsics given to the rig."""

    width_px: Annotated[int, Field(ge=16, le=4096)] = 640
    height_px: Annotated[int, Field(ge=16, le=4096)] = 480
    fx_px: Positive = 492.8
    fy_px: Positive = 492.8
    cx_px: Finite = 319.5
    cy_px: Finite = 239.5
    distortion: tuple[Finite, Finite, Finite, Finite, Finite] = (
        -0.06,
        0.012,
        0.0004,
        -0.0003,
        0.0,
    )  # k1 k2 p1 p2 k3
    told_focal_sigma: NonNegative = 0.0  # of each focal length, as a share
    told_centre_sigma_px: NonNegative = 0.0  # of the principal point
    told_without_distortion: bool = False
    blur_px: NonNegative = 0.6  # sigma of the point spread
    noise: NonNegative = 2.0  # sigma of a mid-grey pixel, of 255
    exposure: Positive = 1.0  # 1 is right
    vignetting: Annotated[float, Field(ge=0.0, le=1.0)] = 0.25  # light lost in the corners
    frame_rate_hz: Positive = 10.0
    jpeg_quality: Annotated[int, Field(ge=1, le=100)] = 95


class Scenario(Section):
    """Everything that a simulated world is drawn from, besides the terrain and the seed.

    ``configs/scenarios/default.toml`` explains each key.

    Attributes
    ----------
    place, vehicle, boresight, servo, inclinometer, compass, altimeter, weather, camera : section
        The file's tables, realistic unless given.

    Examples
    --------
    >>> import sim
    >>> overcast = sim.Scenario.model_validate({"weather": {"sky": "overcast"}, "compass": {"kind": "hdg"}})
    >>> overcast.compass.kind, overcast.inclinometer.chip
    ('hdg', 'adxl355')
    """

    place: Place = Place()
    vehicle: Vehicle = Vehicle()
    boresight: Boresight = Boresight()
    servo: Servo = Servo()
    inclinometer: Inclinometer = Inclinometer()
    compass: Compass = Compass()
    altimeter: Altimeter = Altimeter()
    weather: Weather = Weather()
    camera: CameraOptics = CameraOptics()


def load_scenario(path: Path | str | None) -> Scenario:
    """Read a scenario.

    Parameters
    ----------
    path : path or None
        A TOML file, or the name of a scenario that comes with skyfix (``"ideal"``, ``"uncalibrated"``); the realistic defaults
        for None.

    Returns
    -------
    Scenario
        What the file does not say is as in the defaults.

    Raises
    ------
    SimulationError
        The file cannot be read, is no TOML, or has a key or value that a scenario does not have.

    Examples
    --------
    >>> import sim
    >>> sim.load_scenario("ideal").compass.noise_ut
    0.0
    >>> sim.load_scenario(sim.SCENARIOS / "default.toml") == sim.Scenario()
    True
    """
    return Scenario() if path is None else read_toml(Path(path), Scenario, SCENARIOS / "default.toml")


def read_toml(path: Path, model: type[Model], example: Path) -> Model:
    """Read a TOML file, or the scenario of that name that comes with skyfix; ``example`` is a file that does it right.

    Raises:
        SimulationError: the file cannot be read, is no TOML, or has a key or value that the model does not have.
    """
    from sim.documents import toml_file  # of the commands only; ``Scenario`` does not need it

    content = toml_file("scenario", scenario_file(path))
    try:
        return model.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        what = "unknown key" if first["type"] == "extra_forbidden" else first["msg"]
        raise SimulationError(f"scenario {path}: {where}: {what}; see {example}") from error
