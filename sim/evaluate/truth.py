"""The truth of one case, and its sensor readings."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from sim.evaluate.scenario import DemError, EvaluationScenario
from sim.paper.observations import aimed_tilt_deg, half_view_deg
from sim.world.draw_place import draw_place
from sim.world.draw_rig import random_generator
from sim.world.mechanics import Attitude, Rotation, camera_in_world
from sim.world.scenario import Scenario
from sim.world.scenario import Vehicle as RigVehicle
from sim.world.surface import Observer, Surface
from sim.world.terrain import Terrain

Array = NDArray[np.float64]
Generators = Callable[[str], np.random.Generator]

POINTING_DEG = 0.5  # largest offset of a stop from the commanded azimuth, known to the rig
STEEPEST_AIM_DEG = 25.0
NO_COMPASS_SIGMA_DEG = 180.0


@dataclass(frozen=True)
class TrueFrame:
    """One frame: the camera's attitude, and the attitude measured by the sensors (heading: azimuth, pitch: tilt)."""

    label: str
    attitude: Attitude
    measured: Attitude

    @property
    def rotation(self) -> Rotation:
        """Camera axes (columns) in east, north, up (3, 3)."""
        return camera_in_world(self.attitude.heading_deg, self.attitude.pitch_deg, self.attitude.roll_deg)


@dataclass(frozen=True)
class Truth:
    """The vehicle's place and its frames. ``measured_altitude_m`` is None without an altimeter."""

    surface: Surface
    observer: Observer
    frames: tuple[TrueFrame, ...]
    measured_altitude_m: float | None

    @property
    def easting_northing_m(self) -> tuple[float, float]:
        """The place in the DEM's metric CRS."""
        return self.surface.terrain.easting_northing_m(self.observer.row, self.observer.col)

    def raised_to(self, altitude_m: float) -> "Truth":
        """The truth with the camera at another altitude; the altimeter's error is unchanged."""
        rise_m = altitude_m - self.observer.altitude_m
        measured_m = self.measured_altitude_m
        return replace(
            self,
            observer=replace(self.observer, altitude_m=altitude_m),
            measured_altitude_m=None if measured_m is None else measured_m + rise_m,
        )


def case_generators(seed: int, case: int) -> Generators:
    """The random generators of one case by purpose, independent of what else is computed."""
    return lambda purpose: random_generator([seed, case], purpose)


def draw_truth(
    known: Surface, scenario: EvaluationScenario, rng: Generators, allowed: NDArray[np.bool_] | None = None
) -> Truth:
    """Draw a case.

    Args:
        known: the surface as the DEM has it.
        scenario: what to draw from.
        rng: of the case.
        allowed: (rows, cols) where the vehicle may stand; anywhere without.

    Raises:
        SimulationError: no place on the DEM meets the scenario's conditions.
    """
    surface = known
    if scenario.dem_error is not None:
        surface = Surface(with_errors(known.terrain, scenario.dem_error, rng("dem error")))
    conditions = Scenario(
        place=scenario.place, vehicle=RigVehicle(mast_height_m=scenario.vehicle.mast_height_m)
    )
    return truth_at(surface, draw_place(surface, conditions, rng("place"), allowed), scenario, rng)


def truth_at(surface: Surface, observer: Observer, scenario: EvaluationScenario, rng: Generators) -> Truth:
    """Draw the sensor readings at a place."""
    errors = scenario.errors
    altitude_m = observer.altitude_m + errors.altitude_sigma_m * rng("altimeter").standard_normal()
    return Truth(
        surface=surface,
        observer=observer,
        frames=_draw_frames(surface, observer, scenario, rng),
        measured_altitude_m=float(altitude_m) if errors.altimeter else None,
    )


def with_errors(terrain: Terrain, error: DemError, rng: np.random.Generator) -> Terrain:
    """The terrain plus a Gaussian random field whose correlation falls as exp(-(distance / length)^2)."""
    spread = error.correlation_m / 2.0 / np.array(terrain.cell_size_m())
    field = ndimage.gaussian_filter(
        rng.standard_normal(terrain.height_m.shape, np.float32), spread, mode="wrap"
    )
    field *= error.rms_m / float(field.std())
    return replace(terrain, height_m=terrain.height_m + field)


def _draw_frames(
    surface: Surface, observer: Observer, scenario: EvaluationScenario, rng: Generators
) -> tuple[TrueFrame, ...]:
    errors, view = scenario.errors, scenario.view
    pointing, sensors, base = rng("pointing"), rng("attitude"), rng("base")
    lean_deg = scenario.vehicle.max_tilt_deg * np.sqrt(base.uniform())
    lean_azimuth_deg = base.uniform(0.0, 360.0)
    goals = list(view.azimuths_deg)
    if view.drawn_frames is not None:
        least, most = view.drawn_frames
        goals = list(pointing.uniform(0.0, 360.0, int(pointing.integers(least, most + 1))))
    if errors.azimuth_bias_sigma_deg >= NO_COMPASS_SIGMA_DEG:
        azimuth_bias = sensors.uniform(-180.0, 180.0)
    else:
        azimuth_bias = errors.azimuth_bias_sigma_deg * sensors.standard_normal()
    tilt_bias = errors.tilt_bias_sigma_deg * sensors.standard_normal()
    own_sigmas = np.array([errors.azimuth_sigma_deg, errors.tilt_sigma_deg, errors.roll_sigma_deg])
    frames = []
    for goal, label in zip(goals, _labels(goals), strict=True):
        measured_azimuth = (goal + pointing.uniform(-POINTING_DEG, POINTING_DEG)) % 360.0
        own = own_sigmas * sensors.standard_normal(3)
        azimuth = (measured_azimuth - azimuth_bias - own[0]) % 360.0
        aim = aimed_tilt_deg(surface, observer, azimuth, half_view_deg(scenario.camera))
        tilt = float(np.clip(aim, -STEEPEST_AIM_DEG, STEEPEST_AIM_DEG))
        roll = float(lean_deg * np.sin(np.radians(lean_azimuth_deg - azimuth)))
        frames.append(
            TrueFrame(
                label=label,
                attitude=Attitude(float(azimuth), tilt, roll),
                measured=Attitude(float(measured_azimuth), tilt + tilt_bias + own[1], roll + own[2]),
            )
        )
    return tuple(frames)


def _labels(azimuths_deg: list[float]) -> list[str]:
    named = {0.0: "N", 90.0: "E", 180.0: "S", 270.0: "W"}
    return [named.get(azimuth, f"{number}") for number, azimuth in enumerate(azimuths_deg)]
