"""The truth: one object that holds everything a simulated rig's devices measure.

A world is drawn from terrain, scenario and seed. Every purpose has a random generator of its own, spawned
from the seed, so that one more draw for one purpose changes nothing for the others.
"""

import zlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pygeomag import GeoMag
from scipy import ndimage

from sim.errors import SimulationError
from sim.shipped_files import EMBEDDED_DEM
from sim.world.mechanics import Attitude, Head, Mechanics, Rotation, pan_stage_in_base, turned_about_axes
from sim.world.scenario import Scenario
from sim.world.surface import Observer, Surface
from sim.world.terrain import crs_name, read_terrain

Array = NDArray[np.float64]

STANDARD_GRAVITY_M_S2 = 9.80665
DRY_AIR_GAS_CONSTANT = 287.0528  # J / (kg K)
KELVIN = 273.15
ZEROING_TEMPERATURE_C = 20.0  # at which the inclinometer was zeroed

MOTOR_FIELD_DIRECTION = np.array([0.6, 0.64, 0.48])  # in the pan stage

PLACE_DRAWS = 3000
WATER_REACH_CELLS = 3
PLACE_AZIMUTHS_DEG = np.arange(0.0, 360.0, 5.0)
SKIES: tuple[Literal["clear", "scattered", "broken", "overcast"], ...] = (
    "clear",
    "scattered",
    "broken",
    "overcast",
)


@dataclass(frozen=True)
class TruePlace:
    """Where the vehicle stands.

    Attributes
    ----------
    lat_deg, lon_deg : float
        WGS84.
    easting_m, northing_m : float
        In ``crs``: the DEM's own where that is projected, else a UTM zone.
    crs : str
        Its name, ``"EPSG:32610"``.
    row, col : float
        In the DEM file's grid, cell centres at whole numbers.
    ground_m, altitude_m : float
        Of the triangulated surface, and of the camera's optical centre, above the DEM's vertical datum.
    """

    lat_deg: float
    lon_deg: float
    easting_m: float
    northing_m: float
    crs: str
    row: float
    col: float
    ground_m: float
    altitude_m: float


@dataclass(frozen=True)
class Biases:
    """What was drawn from the scenario's sigmas: constant errors of this rig on this day."""

    boresight: Attitude
    pan_zero_deg: float  # true joint angle less what the installer's zero tick makes of it
    tilt_zero_deg: float
    inclinometer_offset_mg: tuple[
        float, float, float
    ]  # head x, y, z; zero error and temperature drift together
    inclinometer_mounting_deg: tuple[float, float, float]  # turns about head x, y, z, in this order
    inclinometer_scale: tuple[float, float, float]
    hard_iron_ut: tuple[float, float, float]  # pan stage x, y, z
    hard_iron_calibrated_ut: tuple[float, float, float]  # what the crew believes it to be
    soft_iron: tuple[tuple[float, float, float], ...]  # of the pan stage
    vehicle_hard_iron_ut: tuple[float, float, float]  # base x, y, z
    vehicle_soft_iron: tuple[tuple[float, float, float], ...]
    declination_anomaly_deg: float
    altimeter_bias_hpa: float
    weather_drift_hpa_h: float
    reference_pressure_error_hpa: float
    reference_temperature_error_c: float
    told_focal: tuple[float, float]  # factors on fx and fy
    told_centre_px: tuple[float, float]


@dataclass(frozen=True)
class Air:
    """The air when the reference was taken, hydrostatic with a constant lapse rate, and the light."""

    sea_level_pressure_hpa: float
    sea_level_temperature_c: float
    lapse_rate_k_m: float
    visibility_km: float
    sky: Literal["clear", "scattered", "broken", "overcast"]
    sun_azimuth_deg: float
    sun_elevation_deg: float

    def temperature_c(self, altitude_m: float) -> float:
        """Air temperature at an altitude."""
        return self.sea_level_temperature_c - self.lapse_rate_k_m * altitude_m

    def pressure_hpa(self, altitude_m: float) -> float:
        """Pressure at an altitude: the integral of dp/p = -g dz / (R T)."""
        sea_level_k = self.sea_level_temperature_c + KELVIN
        if self.lapse_rate_k_m == 0.0:
            exponent = -STANDARD_GRAVITY_M_S2 * altitude_m / (DRY_AIR_GAS_CONSTANT * sea_level_k)
            return float(self.sea_level_pressure_hpa * np.exp(exponent))
        ratio = (self.temperature_c(altitude_m) + KELVIN) / sea_level_k
        return float(
            self.sea_level_pressure_hpa
            * ratio ** (STANDARD_GRAVITY_M_S2 / (DRY_AIR_GAS_CONSTANT * self.lapse_rate_k_m))
        )


@dataclass(frozen=True)
class PressureReference:
    """What the crew wrote down before they left, with their errors, for the rig's configuration."""

    pressure_hpa: float
    altitude_m: float
    temperature_c: float


@dataclass(frozen=True)
class MagneticField:
    """The Earth's field at the place."""

    declination_model_deg: float  # World Magnetic Model
    enu_ut: tuple[float, float, float]  # east, north, up, local anomaly and disturbance included

    @property
    def declination_deg(self) -> float:
        """True declination here, anomaly included."""
        east, north, _ = self.enu_ut
        return float(np.degrees(np.arctan2(east, north)))


@dataclass(frozen=True)
class Standpoint:
    """Where the vehicle is, the eye there, and the field."""

    place: TruePlace
    observer: Observer
    field: MagneticField


@dataclass
class Vehicle:
    """What changes when the vehicle drives: where it stands, how it moves, how much it shakes meanwhile (one sigma)."""

    standpoint: Standpoint
    speed_m_s: float = 0.0
    course_deg: float = 0.0
    shaken_mg: float = 0.0


@dataclass(frozen=True)
class World:
    """The truth about one simulated rig: all that its devices measure, with every error that they have.

    Immutable but for where the joints are and where and how the vehicle stands. Made by ``World.create``.

    Attributes
    ----------
    scenario : Scenario
        The sizes of the errors, and the devices that are fitted.
    seed : int
        That everything was drawn with.
    surface : Surface
        The DEM as a triangulated surface.
    vehicle : Vehicle
        Where it stands and how it moves.
    mechanics : Mechanics
        How base, head and camera are turned against each other.
    biases : Biases
        The errors that were drawn.
    air : Air
        Pressure, temperature, visibility, sun and sky.
    reference : PressureReference
        What the crew wrote down before they left.
    head : Head
        Where the joints are.
    place : TruePlace
        Where the vehicle stands.

    Examples
    --------
    >>> import sim
    >>> world = sim.World.create(seed=7)
    >>> print(f"{world.place.lat_deg:.3f}, {world.place.lon_deg:.3f}, {world.place.altitude_m:.0f} m")
    37.328, -122.220, 571 m
    >>> world.truth_json()["base_attitude"].keys()
    dict_keys(['heading_deg', 'pitch_deg', 'roll_deg'])
    """

    scenario: Scenario
    seed: int
    surface: Surface
    vehicle: Vehicle
    mechanics: Mechanics
    biases: Biases
    air: Air
    reference: PressureReference
    head: Head

    @classmethod
    def create(
        cls,
        dem_paths: Sequence[Path | str] = (EMBEDDED_DEM,),
        scenario: Scenario | None = None,
        seed: int = 1,
    ) -> "World":
        """Draw a world.

        Parameters
        ----------
        dem_paths : sequence of path
            Elevation rasters that adjoin; the terrain that comes with skyfix unless given.
        scenario : Scenario, optional
            What is drawn from; the realistic defaults unless given.
        seed : int
            Another seed, another place and other errors.

        Returns
        -------
        World
            The same for the same arguments.

        Raises
        ------
        SimulationError
            The DEM cannot be read, or no place on it meets the scenario's conditions.
        """
        scenario = scenario or Scenario()
        surface = Surface(read_terrain([Path(path) for path in dem_paths]))
        observer = draw_place(surface, scenario, random_generator(seed, _at_stop("place", scenario)))
        return cls.around(surface, observer, scenario, seed)

    @classmethod
    def around(cls, surface: Surface, observer: Observer, scenario: Scenario, seed: int) -> "World":
        """Draw everything but the place.

        Parameters
        ----------
        surface : Surface
            The DEM.
        observer : Observer
            The camera's optical centre on it.
        scenario : Scenario
            What is drawn from.
        seed : int
            Another seed, other errors.

        Returns
        -------
        World
            The same for the same arguments.
        """
        place = _place(surface, observer)
        base = _draw_base(scenario, random_generator(seed, _at_stop("base", scenario)))
        air = _draw_air(scenario, random_generator(seed, "weather"))
        biases = _draw_biases(scenario, air.temperature_c(place.altitude_m), seed)
        return cls(
            scenario=scenario,
            seed=seed,
            surface=surface,
            vehicle=Vehicle(_standpoint(scenario, biases, place, observer)),
            mechanics=Mechanics(base, biases.boresight),
            biases=biases,
            air=air,
            reference=_draw_reference(surface, air, biases, random_generator(seed, "reference")),
            head=Head(),
        )

    @property
    def place(self) -> TruePlace:
        """Where the vehicle stands."""
        return self.vehicle.standpoint.place

    @property
    def observer(self) -> Observer:
        """The camera's optical centre."""
        return self.vehicle.standpoint.observer

    @property
    def field(self) -> MagneticField:
        """The Earth's field there."""
        return self.vehicle.standpoint.field

    def standpoint_at(self, lat_deg: float, lon_deg: float) -> Standpoint:
        """Another place in this world, for the vehicle to drive to.

        Parameters
        ----------
        lat_deg, lon_deg : float
            WGS84.

        Returns
        -------
        Standpoint
            For ``SimulatedRig.stand_at``.

        Raises
        ------
        SimulationError
            The DEM has no height there.
        """
        observer = _eye_at(self.surface, self.scenario, lat_deg, lon_deg)
        return _standpoint(self.scenario, self.biases, _place(self.surface, observer), observer)

    def rng(self, purpose: str) -> np.random.Generator:
        """A random generator of its own for a device's noise.

        Parameters
        ----------
        purpose : str
            Of one device, or of a picture.

        Returns
        -------
        numpy.random.Generator
            The same for the same seed and purpose.
        """
        return random_generator(self.seed, purpose)

    def camera_rotation(self, pan_deg: float, tilt_deg: float) -> Rotation:
        """Where the camera looks.

        Parameters
        ----------
        pan_deg, tilt_deg : float
            True joint angles.

        Returns
        -------
        array of float
            (3, 3): camera axes (columns) in east, north, up.
        """
        return self.mechanics.camera_in_world(pan_deg, tilt_deg)

    def gravity_in_head(self, pan_deg: float, tilt_deg: float) -> Array:
        """What a perfect accelerometer at rest reads in the head.

        Parameters
        ----------
        pan_deg, tilt_deg : float
            True joint angles.

        Returns
        -------
        array of float
            (3,), g: +1 along an axis that points up.
        """
        up_in_head: Array = self.mechanics.head_in_world(pan_deg, tilt_deg)[2]
        return up_in_head.copy()

    def accelerometer_in_head(self, pan_deg: float, tilt_deg: float) -> Array:
        """What the rig's own chip reads without noise in the axes that it should have: askew, off scale, off zero.

        Parameters
        ----------
        pan_deg, tilt_deg : float
            True joint angles.

        Returns
        -------
        array of float
            (3,), g.
        """
        askew = turned_about_axes(self.biases.inclinometer_mounting_deg)
        seen = askew.T @ self.gravity_in_head(pan_deg, tilt_deg)
        reading: Array = seen * self.biases.inclinometer_scale
        return reading + np.array(self.biases.inclinometer_offset_mg) / 1000.0

    def field_in_pan_stage(self, pan_deg: float, moving: bool = False, holding: bool = False) -> Array:
        """The field at the magnetometer, in the pan stage.

        The Earth's with its local anomaly, bent by the iron of vehicle and pan stage, and the motors' while they draw current.

        Parameters
        ----------
        pan_deg : float
            True joint angle.
        moving, holding : bool
            Whether the motors draw current.

        Returns
        -------
        array of float
            (3,), µT.
        """
        biases, compass = self.biases, self.scenario.compass
        earth = self.mechanics.pan_stage_in_world(0.0).T @ np.array(self.field.enu_ut)
        at_base = np.array(biases.vehicle_soft_iron) @ earth + np.array(biases.vehicle_hard_iron_ut)
        at_stage = pan_stage_in_base(pan_deg).T @ at_base
        total: Array = np.array(biases.soft_iron) @ at_stage + np.array(biases.hard_iron_ut)
        if moving:
            total += MOTOR_FIELD_DIRECTION * compass.motor_current_field_ut
        elif holding:
            total += MOTOR_FIELD_DIRECTION * compass.holding_current_field_ut
        return total

    def magnetic_heading_deg(self, pan_deg: float, moving: bool = False) -> float:
        """Heading of the pan stage's y axis as a levelled talker finds it, calibrated hard iron removed.

        Parameters
        ----------
        pan_deg : float
            True joint angle.
        moving : bool
            Whether a motor moves.

        Returns
        -------
        float
            Of the pan stage, degrees clockwise from magnetic north.
        """
        stage = self.mechanics.pan_stage_in_world(pan_deg)
        measured = self.field_in_pan_stage(pan_deg, moving) - np.array(self.biases.hard_iron_calibrated_ut)
        east, north, _ = stage @ measured
        ahead_east, ahead_north, _ = stage[:, 1]
        heading = np.degrees(np.arctan2(ahead_east, ahead_north) - np.arctan2(east, north))
        return float(heading % 360.0)

    def pressure_hpa(self, elapsed_s: float) -> float:
        """True pressure at the camera; the weather has drifted.

        Parameters
        ----------
        elapsed_s : float
            Since the rig was started.

        Returns
        -------
        float
            hPa.
        """
        hours = self.scenario.altimeter.reference_age_h + elapsed_s / 3600.0
        return self.air.pressure_hpa(self.place.altitude_m) + self.biases.weather_drift_hpa_h * hours

    @property
    def air_temperature_c(self) -> float:
        """Air temperature at the rig."""
        return self.air.temperature_c(self.place.altitude_m)

    def truth_json(self) -> dict[str, Any]:
        """The truth as JSON values, for ``SKYFIX_TRUTH``: only tests and evaluations may read it."""
        return {
            **asdict(self.place),
            "mast_height_m": self.scenario.vehicle.mast_height_m,
            "base_attitude": asdict(self.mechanics.base),
            "biases": asdict(self.biases),
            "air": asdict(self.air),
            "magnetic_field": {**asdict(self.field), "declination_deg": self.field.declination_deg},
            "reference": asdict(self.reference),
            "seed": self.seed,
        }


def random_generator(seed: int | Sequence[int], purpose: str) -> np.random.Generator:
    """The generator of one purpose: streams of different purposes are independent."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(zlib.crc32(purpose.encode()),)))


def _at_stop(purpose: str, scenario: Scenario) -> str:
    """A purpose that is drawn anew at each stop of a trip; the first is the one of no trip at all."""
    return f"{purpose} {scenario.place.stop}" if scenario.place.stop else purpose


def draw_place(
    surface: Surface,
    scenario: Scenario,
    rng: np.random.Generator,
    allowed: NDArray[np.bool_] | None = None,
) -> Observer:
    """The camera at a place that meets the scenario's conditions.

    ``allowed`` (rows, cols) narrows a drawn place down further.

    Raises:
        SimulationError: there is no such place.
    """
    conditions = scenario.place
    if conditions.lat_deg is not None and conditions.lon_deg is not None:
        return _eye_at(surface, scenario, conditions.lat_deg, conditions.lon_deg)
    inside_m = _distance_from_edge_m(surface)
    suits = inside_m > conditions.edge_margin_m
    candidates = np.argwhere(suits if allowed is None else suits & allowed)
    for _ in range(PLACE_DRAWS if len(candidates) else 0):
        row, col = candidates[rng.integers(len(candidates))] + rng.uniform(-0.5, 0.5, 2)
        drivable = surface.slope_deg(row, col) < conditions.max_slope_deg
        if not drivable or _on_water(surface, round(row), round(col)):
            continue
        observer = _eye(surface, scenario, float(row), float(col))
        if (
            _enclosed_fraction(surface, observer, inside_m, conditions.edge_margin_m)
            >= conditions.enclosed_fraction
        ):
            return observer
    raise SimulationError(
        f"DEM {surface.terrain.name}: found no drivable place where terrain inside it closes the view in"
        f" {conditions.enclosed_fraction:.0%} of the directions; use a larger DEM or a milder [place]"
    )


def _eye_at(surface: Surface, scenario: Scenario, lat_deg: float, lon_deg: float) -> Observer:
    row, col = (float(x) for x in surface.terrain.row_col(lon_deg, lat_deg))
    if not np.isfinite(surface.height(row, col)):
        raise SimulationError(
            f"DEM {surface.terrain.name}: has no height at {lat_deg:.5f}, {lon_deg:.5f}; choose another [place]"
        )
    return _eye(surface, scenario, row, col)


def _standpoint(scenario: Scenario, biases: Biases, place: TruePlace, observer: Observer) -> Standpoint:
    field = _magnetic_field(
        place,
        scenario.weather.decimal_year,
        biases.declination_anomaly_deg,
        scenario.compass.disturbance_enu_ut,
    )
    return Standpoint(place, observer, field)


def _eye(surface: Surface, scenario: Scenario, row: float, col: float) -> Observer:
    return surface.observer(row, col, surface.height(row, col) + scenario.vehicle.mast_height_m)


def _place(surface: Surface, observer: Observer) -> TruePlace:
    row, col = observer.row, observer.col
    lon, lat = (float(x) for x in surface.terrain.lonlat_deg(row, col))
    easting, northing = surface.terrain.easting_northing_m(row, col)
    return TruePlace(
        lat_deg=lat,
        lon_deg=lon,
        easting_m=easting,
        northing_m=northing,
        crs=crs_name(surface.terrain.metric_crs),
        row=row,
        col=col,
        ground_m=surface.height(row, col),
        altitude_m=observer.altitude_m,
    )


def _on_water(surface: Surface, row: int, col: int) -> bool:
    """Whether all cells around have the same height: sea and lakes are flat in a DEM, land hardly ever."""
    i, j = max(row - WATER_REACH_CELLS, 0), max(col - WATER_REACH_CELLS, 0)
    around = surface.height_m[i : row + WATER_REACH_CELLS + 1, j : col + WATER_REACH_CELLS + 1]
    return bool((around == around[0, 0]).all())


@lru_cache(maxsize=4)
def _distance_from_edge_m(surface: Surface) -> Array:
    """How far each lattice point is from the nearest void or the DEM's edge, metres (rows, cols)."""
    known = np.pad(np.isfinite(surface.height_m), 1, constant_values=False)
    inside: Array = ndimage.distance_transform_edt(known, sampling=surface.terrain.cell_size_m())[1:-1, 1:-1]
    return inside


def _enclosed_fraction(surface: Surface, observer: Observer, inside_m: Array, margin_m: float) -> float:
    """Share of the azimuths whose horizon is terrain well inside the DEM, above whatever its rim shows."""
    _, distance_m = surface.horizon(observer, PLACE_AZIMUTHS_DEG)
    seen = np.isfinite(distance_m)
    rows, cols = surface.lattice(observer, PLACE_AZIMUTHS_DEG, np.where(seen, distance_m, 0.0))
    i = np.clip(np.round(rows).astype(int), 0, inside_m.shape[0] - 1)
    j = np.clip(np.round(cols).astype(int), 0, inside_m.shape[1] - 1)
    return float(np.mean(seen & (inside_m[i, j] > margin_m)))


def _draw_base(scenario: Scenario, rng: np.random.Generator) -> Attitude:
    """Vehicle parked anyhow: lean of any direction, up to the largest one with equal chance per area."""
    heading = rng.uniform(0.0, 360.0)
    lean = scenario.vehicle.max_tilt_deg * np.sqrt(rng.uniform())
    towards = rng.uniform(0.0, 2.0 * np.pi)
    if scenario.vehicle.heading_deg is not None:
        heading = scenario.vehicle.heading_deg
    return Attitude(float(heading), float(lean * np.cos(towards)), float(lean * np.sin(towards)))


def _draw_air(scenario: Scenario, rng: np.random.Generator) -> Air:
    weather = scenario.weather
    pressure, temperature = rng.normal(1015.0, 7.0), rng.normal(18.0, 6.0)
    sun_azimuth, sun_elevation = rng.uniform(0.0, 360.0), rng.uniform(8.0, 65.0)
    sky = SKIES[int(rng.integers(len(SKIES)))]
    return Air(
        sea_level_pressure_hpa=float(_given(weather.sea_level_pressure_hpa, pressure)),
        sea_level_temperature_c=float(_given(weather.sea_level_temperature_c, temperature)),
        lapse_rate_k_m=weather.lapse_rate_k_km / 1000.0,
        visibility_km=weather.visibility_km,
        sky=sky if weather.sky == "drawn" else weather.sky,
        sun_azimuth_deg=float(_given(weather.sun_azimuth_deg, sun_azimuth)),
        sun_elevation_deg=float(_given(weather.sun_elevation_deg, sun_elevation)),
    )


def _given(value: float | None, drawn: float) -> float:
    return drawn if value is None else value


def _draw_biases(scenario: Scenario, temperature_c: float, seed: int) -> Biases:
    mount, tilt_meter, compass, altimeter = (
        random_generator(seed, purpose) for purpose in ("boresight", "inclinometer", "compass", "altimeter")
    )
    boresight = mount.normal(size=3) * [
        scenario.boresight.azimuth_sigma_deg,
        scenario.boresight.tilt_sigma_deg,
        scenario.boresight.roll_sigma_deg,
    ]
    zero_mg = tilt_meter.normal(size=3) * scenario.inclinometer.zero_offset_sigma_mg
    drift_mg_c = tilt_meter.normal(size=3) * scenario.inclinometer.temperature_drift_sigma_mg_c
    hard_iron = compass.normal(size=3) * scenario.compass.hard_iron_sigma_ut
    askew, bent, told = (
        random_generator(seed, purpose) for purpose in ("chip mounting", "soft iron", "told camera")
    )
    joints = random_generator(seed, "joint zeros").normal(size=2) * scenario.servo.zero_sigma_deg
    mounting_deg = askew.normal(size=3) * scenario.inclinometer.mounting_sigma_deg
    scale = 1.0 + askew.normal(size=3) * scenario.inclinometer.scale_sigma
    stage_soft = _bent(bent, scenario.compass.soft_iron_sigma)
    vehicle_soft = _bent(bent, scenario.compass.vehicle_soft_iron_sigma)
    vehicle_hard = bent.normal(size=3) * scenario.compass.vehicle_hard_iron_sigma_ut
    focal = 1.0 + told.normal(size=2) * scenario.camera.told_focal_sigma
    centre_px = told.normal(size=2) * scenario.camera.told_centre_sigma_px
    believed = hard_iron + compass.normal(size=3) * scenario.compass.hard_iron_calibration_sigma_ut
    return Biases(
        boresight=Attitude(*(float(x) for x in boresight)),
        pan_zero_deg=float(joints[0]),
        tilt_zero_deg=float(joints[1]),
        inclinometer_mounting_deg=_triple(mounting_deg),
        inclinometer_scale=_triple(scale),
        soft_iron=stage_soft,
        vehicle_hard_iron_ut=_triple(vehicle_hard),
        vehicle_soft_iron=vehicle_soft,
        told_focal=(float(focal[0]), float(focal[1])),
        told_centre_px=(float(centre_px[0]), float(centre_px[1])),
        inclinometer_offset_mg=_triple(zero_mg + drift_mg_c * (temperature_c - ZEROING_TEMPERATURE_C)),
        hard_iron_ut=_triple(hard_iron),
        hard_iron_calibrated_ut=_triple(believed),
        declination_anomaly_deg=float(compass.normal() * scenario.compass.declination_anomaly_sigma_deg),
        altimeter_bias_hpa=float(altimeter.normal() * scenario.altimeter.bias_sigma_hpa),
        weather_drift_hpa_h=float(altimeter.normal() * scenario.altimeter.weather_drift_sigma_hpa_h),
        reference_pressure_error_hpa=float(altimeter.normal() * scenario.altimeter.reference_sigma_hpa),
        reference_temperature_error_c=float(
            altimeter.normal() * scenario.altimeter.reference_temperature_sigma_c
        ),
    )


def _bent(rng: np.random.Generator, sigma: float) -> tuple[tuple[float, float, float], ...]:
    """A symmetric matrix close to the identity: what soft iron makes of a field."""
    random = np.triu(rng.normal(size=(3, 3))) * sigma
    return tuple(_triple(row) for row in np.eye(3) + random + np.triu(random, 1).T)


def _triple(vector: Array) -> tuple[float, float, float]:
    x, y, z = (float(component) for component in vector)
    return x, y, z


def _draw_reference(
    surface: Surface, air: Air, biases: Biases, rng: np.random.Generator
) -> PressureReference:
    """The crew read the pressure at some known point of the area, low down, where roads are."""
    known = surface.height_m[np.isfinite(surface.height_m)]
    altitude_m = float(np.round(np.quantile(known, rng.uniform(0.05, 0.5))))
    return PressureReference(
        pressure_hpa=air.pressure_hpa(altitude_m) + biases.reference_pressure_error_hpa,
        altitude_m=altitude_m,
        temperature_c=air.temperature_c(altitude_m) + biases.reference_temperature_error_c,
    )


def _magnetic_field(
    place: TruePlace, decimal_year: float, anomaly_deg: float, disturbance_enu_ut: tuple[float, float, float]
) -> MagneticField:
    model = GeoMag().calculate(
        glat=place.lat_deg, glon=place.lon_deg, alt=place.altitude_m / 1000.0, time=decimal_year
    )
    declination = np.radians(model.d + anomaly_deg)
    enu_ut = np.array([model.h * np.sin(declination), model.h * np.cos(declination), -model.z]) / 1000.0
    return MagneticField(float(model.d), _triple(enu_ut + disturbance_enu_ut))
