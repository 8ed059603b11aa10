"""The truth: one object with everything that a simulated rig's devices measure.

A world is drawn from terrain, scenario and seed. Every purpose has its own random generator, spawned from the seed, so
that an additional draw for one purpose does not affect others.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sim.shipped_files import EMBEDDED_DEM
from sim.world.draw_place import draw_place, observer_at, true_place
from sim.world.draw_rig import (
    draw_air,
    draw_base,
    draw_biases,
    draw_reference,
    magnetic_field,
    random_generator,
)
from sim.world.mechanics import Head, Mechanics, Rotation, pan_stage_in_base, turned_about_axes
from sim.world.scenario import Scenario
from sim.world.surface import Observer, Surface
from sim.world.terrain import read_terrain
from sim.world.true_values import (
    Air,
    Array,
    Biases,
    MagneticField,
    PressureReference,
    Standpoint,
    TruePlace,
    Vehicle,
)

MOTOR_FIELD_DIRECTION = np.array([0.6, 0.64, 0.48])  # in the pan stage


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
        place = true_place(surface, observer)
        base = draw_base(scenario, random_generator(seed, _at_stop("base", scenario)))
        air = draw_air(scenario, random_generator(seed, "weather"))
        biases = draw_biases(scenario, air.temperature_c(place.altitude_m), seed)
        return cls(
            scenario=scenario,
            seed=seed,
            surface=surface,
            vehicle=Vehicle(_standpoint(scenario, biases, place, observer)),
            mechanics=Mechanics(base, biases.boresight),
            biases=biases,
            air=air,
            reference=draw_reference(surface, air, biases, random_generator(seed, "reference")),
            head=Head(),
        )

    @property
    def place(self) -> TruePlace:
        """The vehicle's place."""
        return self.vehicle.standpoint.place

    @property
    def observer(self) -> Observer:
        """The camera's optical centre."""
        return self.vehicle.standpoint.observer

    @property
    def field(self) -> MagneticField:
        """The Earth's magnetic field there."""
        return self.vehicle.standpoint.field

    def standpoint_at(self, lat_deg: float, lon_deg: float) -> Standpoint:
        """Another place in this world for the vehicle.

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
        observer = observer_at(self.surface, self.scenario, lat_deg, lon_deg)
        return _standpoint(self.scenario, self.biases, true_place(self.surface, observer), observer)

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
        """Noise-free reading of the rig's chip in its nominal axes, with mounting, scale and zero errors.

        Parameters
        ----------
        pan_deg, tilt_deg : float
            True joint angles.

        Returns
        -------
        array of float
            (3,), g.
        """
        mounting = turned_about_axes(self.biases.inclinometer_mounting_deg)
        seen = mounting.T @ self.gravity_in_head(pan_deg, tilt_deg)
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


def _at_stop(purpose: str, scenario: Scenario) -> str:
    """A purpose with a separate draw at each stop of a trip; the first stop has the plain name."""
    return f"{purpose} {scenario.place.stop}" if scenario.place.stop else purpose


def _standpoint(scenario: Scenario, biases: Biases, place: TruePlace, observer: Observer) -> Standpoint:
    field = magnetic_field(
        place,
        scenario.weather.decimal_year,
        biases.declination_anomaly_deg,
        scenario.compass.disturbance_enu_ut,
    )
    return Standpoint(place, observer, field)
