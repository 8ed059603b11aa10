"""Makes a DEM with duplicated surroundings: a crop, its mirror image, and the crop again with added relief.

The mirror image between them avoids steps in height. The vehicle stands on either copy, and its whole horizon lies
within that copy.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from affine import Affine
from numpy.typing import NDArray

from sim.errors import SimulationError
from sim.evaluate.scenario import DemError, EvaluationScenario, Twins
from sim.evaluate.truth import Generators, with_errors
from sim.world.draw_place import draw_place
from sim.world.scenario import Scenario
from sim.world.scenario import Vehicle as RigVehicle
from sim.world.surface import Observer, Surface
from sim.world.terrain import Terrain

Array = NDArray[np.float64]

CROPS, PLACES = 12, 25
"""Number of crops of the DEM, and places in each, that are tried."""
AZIMUTHS_DEG = np.arange(0.0, 360.0, 0.5)
MIN_SIDE = 100
MARGIN_CELLS = 5.0


@dataclass(frozen=True)
class TwinPlace:
    """The surface with both copies, the position of its first cell in the DEM's lattice, and the camera on one copy."""

    surface: Surface
    first_row: int
    first_col: int
    observer: Observer


def draw_twins(known: Surface, scenario: EvaluationScenario, twins: Twins, rng: Generators) -> TwinPlace:
    """Draw a crop, the relief of its copy and a place with the same surroundings on both.

    Raises:
        SimulationError: the DEM is too small, or no place in it sees its own copy alone.
    """
    side = min(*known.height_m.shape, twins.cells)
    if side < MIN_SIDE:
        raise SimulationError(
            f"DEM {known.terrain.name}: {side} cells are too few for twins, which need {MIN_SIDE}"
        )
    draw = rng("twins")
    relief_m = twins.relief_m[int(draw.integers(len(twins.relief_m)))]
    second = bool(draw.integers(2))
    for _ in range(CROPS):
        row, col = (int(draw.integers(extent - side + 1)) for extent in known.height_m.shape)
        crop = _part(known.terrain, row, col, side)
        alike = Surface(_side_by_side(crop, crop.height_m))
        for place in _places(Surface(crop), scenario, draw):
            here = place + np.array([0.0, 2.0 * side * second])
            there = place + np.array([0.0, 2.0 * side * (not second)])
            if not all(_sees_its_copy(alike, at, side, scenario) for at in (here, there)):
                continue
            copy_m = crop.height_m
            if relief_m > 0.0:
                error = DemError(rms_m=relief_m, correlation_m=twins.correlation_m)
                copy_m = with_errors(crop, error, rng("relief")).height_m
            surface = Surface(_side_by_side(crop, copy_m))
            return TwinPlace(surface, row, col, _observer_above_ground(surface, here, scenario))
    raise SimulationError(
        f"DEM {known.terrain.name}: found no place that sees only the {side} x {side} cells around it; use a larger DEM, more"
        " [twins] cells or a milder [place]"
    )


def _places(crop: Surface, scenario: EvaluationScenario, draw: np.random.Generator) -> Iterator[Array]:
    """Row and column of places whose horizon lies inside the crop in all directions."""
    conditions = Scenario(
        place=scenario.place.model_copy(update={"enclosed_fraction": 1.0}),
        vehicle=RigVehicle(mast_height_m=scenario.vehicle.mast_height_m),
    )
    for _ in range(PLACES):
        try:
            observer = draw_place(crop, conditions, draw)
        except SimulationError:
            return
        yield np.array([observer.row, observer.col])


def _observer_above_ground(surface: Surface, place: Array, scenario: EvaluationScenario) -> Observer:
    row, col = float(place[0]), float(place[1])
    return surface.observer(row, col, surface.height(row, col) + scenario.vehicle.mast_height_m)


def _sees_its_copy(surface: Surface, place: Array, side: int, scenario: EvaluationScenario) -> bool:
    """Whether the whole horizon lies inside the copy with the place."""
    observer = _observer_above_ground(surface, place, scenario)
    _, distance_m = surface.horizon(observer, AZIMUTHS_DEG)
    row, col = surface.lattice(observer, AZIMUTHS_DEG, distance_m)
    first = place[1] // side * side
    inside = (np.minimum(row, col - first) >= MARGIN_CELLS) & (
        np.maximum(row, col - first) <= side - 1 - MARGIN_CELLS
    )
    return bool(inside.all())


def _part(terrain: Terrain, row: int, col: int, side: int) -> Terrain:
    return replace(
        terrain,
        height_m=np.ascontiguousarray(terrain.height_m[row : row + side, col : col + side]),
        transform=terrain.transform @ Affine.translation(col, row),
    )


def _side_by_side(crop: Terrain, copy_m: NDArray[np.float32]) -> Terrain:
    height_m = np.hstack([crop.height_m, crop.height_m[:, ::-1], copy_m]).astype(np.float32)
    return replace(crop, height_m=np.ascontiguousarray(height_m))
