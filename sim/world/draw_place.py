"""Draws the place of the vehicle: drivable, on land, and enclosed by terrain inside the DEM."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from sim.errors import SimulationError
from sim.world.scenario import Scenario
from sim.world.surface import Observer, Surface
from sim.world.terrain import crs_name
from sim.world.true_values import Array, TruePlace

PLACE_DRAWS = 3000
WATER_REACH_CELLS = 3
PLACE_AZIMUTHS_DEG = np.arange(0.0, 360.0, 5.0)


def draw_place(
    surface: Surface,
    scenario: Scenario,
    rng: np.random.Generator,
    allowed: NDArray[np.bool_] | None = None,
) -> Observer:
    """The camera at a place that meets the scenario's conditions.

    ``allowed`` (rows, cols) restricts a drawn place further.

    Raises:
        SimulationError: there is no such place.
    """
    conditions = scenario.place
    if conditions.lat_deg is not None and conditions.lon_deg is not None:
        return observer_at(surface, scenario, conditions.lat_deg, conditions.lon_deg)
    inside_m = _distance_from_edge_m(surface)
    suits = inside_m > conditions.edge_margin_m
    candidates = np.argwhere(suits if allowed is None else suits & allowed)
    for _ in range(PLACE_DRAWS if len(candidates) else 0):
        row, col = candidates[rng.integers(len(candidates))] + rng.uniform(-0.5, 0.5, 2)
        drivable = surface.slope_deg(row, col) < conditions.max_slope_deg
        if not drivable or _on_water(surface, round(row), round(col)):
            continue
        observer = observer_above_ground(surface, scenario, float(row), float(col))
        if (
            _enclosed_fraction(surface, observer, inside_m, conditions.edge_margin_m)
            >= conditions.enclosed_fraction
        ):
            return observer
    raise SimulationError(
        f"DEM {surface.terrain.name}: found no drivable place where terrain inside it closes the view in"
        f" {conditions.enclosed_fraction:.0%} of the directions; use a larger DEM or a milder [place]"
    )


def observer_at(surface: Surface, scenario: Scenario, lat_deg: float, lon_deg: float) -> Observer:
    row, col = (float(x) for x in surface.terrain.row_col(lon_deg, lat_deg))
    if not np.isfinite(surface.height(row, col)):
        raise SimulationError(
            f"DEM {surface.terrain.name}: has no height at {lat_deg:.5f}, {lon_deg:.5f}; choose another [place]"
        )
    return observer_above_ground(surface, scenario, row, col)


def observer_above_ground(surface: Surface, scenario: Scenario, row: float, col: float) -> Observer:
    return surface.observer(row, col, surface.height(row, col) + scenario.vehicle.mast_height_m)


def true_place(surface: Surface, observer: Observer) -> TruePlace:
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
    """Whether all cells around have the same height: water is flat in a DEM, land hardly ever."""
    i, j = max(row - WATER_REACH_CELLS, 0), max(col - WATER_REACH_CELLS, 0)
    around = surface.height_m[i : row + WATER_REACH_CELLS + 1, j : col + WATER_REACH_CELLS + 1]
    return bool((around == around[0, 0]).all())


@lru_cache(maxsize=4)
def _distance_from_edge_m(surface: Surface) -> Array:
    """Distance of each lattice point from the nearest void or the DEM's edge, metres (rows, cols)."""
    known = np.pad(np.isfinite(surface.height_m), 1, constant_values=False)
    inside: Array = ndimage.distance_transform_edt(known, sampling=surface.terrain.cell_size_m())[1:-1, 1:-1]
    return inside


def _enclosed_fraction(surface: Surface, observer: Observer, inside_m: Array, margin_m: float) -> float:
    """Share of azimuths whose horizon is terrain well inside the DEM."""
    _, distance_m = surface.horizon(observer, PLACE_AZIMUTHS_DEG)
    seen = np.isfinite(distance_m)
    rows, cols = surface.lattice(observer, PLACE_AZIMUTHS_DEG, np.where(seen, distance_m, 0.0))
    i = np.clip(np.round(rows).astype(int), 0, inside_m.shape[0] - 1)
    j = np.clip(np.round(cols).astype(int), 0, inside_m.shape[1] - 1)
    return float(np.mean(seen & (inside_m[i, j] > margin_m)))
