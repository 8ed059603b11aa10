"""Drives of a few stops: what was known before, odometry that is right, wrong or absent, stops that show nothing."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

import sim
from frozen_answers.ground import CRATER, Grid, Ground, crater, hills, side_by_side
from frozen_answers.inputs import Look, Question
from frozen_answers.looks import Rig, contours, place
from localizer import Movement, Observation

Spot = tuple[float, float]
CELL_M = 30.0
WEST, EAST = (50.0, 44.0), (50.0, 44.0 + 200.0 / CELL_M)
HILLOCK_EAST, HILLOCK_WEST = (EAST[0] - 1.0, EAST[1] + 4.0), (WEST[0] + 1.0, WEST[1] - 4.0)


def among_craters(
    folder: Path,
    *,
    seed: int,
    spots: Sequence[Spot],
    number: int = 0,
    odometry: str = "right",
    fog: Sequence[int] = (),
) -> Question:
    """Three craters of which a hillock tells one from another at some spots: only the way says which."""
    grid = side_by_side(
        [crater(seed, [HILLOCK_EAST]), crater(seed), crater(seed, [HILLOCK_EAST, HILLOCK_WEST])]
    )
    at = [(row, col + number * CRATER) for row, col in spots]
    return _drive(grid, at, folder, seed, odometry, fog)


def among_hills(
    folder: Path, *, seed: int, steps: Sequence[Spot], odometry: str = "right", fog: Sequence[int] = ()
) -> Question:
    """From a place that is drawn on the hills by steps of rows and columns."""
    grid = hills(180, 290, 200)
    start = place(grid, folder, seed=seed).place
    at = [(start.row, start.col)]
    for step in steps:
        at.append((at[-1][0] + step[0], at[-1][1] + step[1]))
    return _drive(grid, at, folder, seed, odometry, fog)


def _drive(
    grid: Grid, at: Sequence[Spot], folder: Path, seed: int, odometry: str, fog: Sequence[int]
) -> Question:
    worlds = [place(grid, folder, at=spot, seed=seed) for spot in at]
    looks: list[Look] = []
    for number, world in enumerate(worlds):
        look = contours(world, Rig(azimuth_bias_sigma_deg=0.5), seed + 100 * number)
        assert isinstance(look.measurement, Observation)
        measurement = _blind(look.measurement) if number in fog else look.measurement
        movement = _movement(worlds[number - 1], world, odometry, seed + number) if number else None
        looks.append(Look(measurement, look.truth, movement))
    return Question(Ground((grid,)), tuple(looks), drive=True)


def _movement(start: sim.World, end: sim.World, odometry: str, seed: int) -> Movement | None:
    north = np.radians(end.place.lat_deg - start.place.lat_deg) * 6_371_008.8
    east = np.radians(end.place.lon_deg - start.place.lon_deg) * 6_371_008.8
    step_m = np.array([east * np.cos(np.radians(start.place.lat_deg)), north])
    rng = np.random.default_rng([seed, 7])
    match odometry:
        case "unknown":
            return None
        case "vague":
            return Movement(step_m + 60.0 * rng.standard_normal(2), np.eye(2) * 60.0**2)
        case "wrong":
            return Movement(step_m + np.array([400.0, -300.0]), np.eye(2) * 5.0**2)
        case "heading":
            distance_m = float(np.hypot(*step_m) + 4.0 * rng.standard_normal())
            heading_deg = float(np.degrees(np.arctan2(*step_m)) + 5.0 * rng.standard_normal())
            return Movement.from_heading(
                max(distance_m, 0.0), heading_deg, distance_sigma_m=4.0, heading_sigma_deg=5.0
            )
        case _:
            return Movement(step_m + 4.0 * rng.standard_normal(2), np.eye(2) * 4.0**2)


def _blind(observation: Observation) -> Observation:
    none = np.zeros(0)
    frames = tuple(replace(frame, u_px=none, v_px=none, sigma_px=none) for frame in observation.frames)
    return replace(observation, frames=frames)


CASES = {
    **{
        f"resolves-{odometry}/{number}": partial(
            among_craters, seed=1, spots=(WEST, EAST), number=number, odometry=odometry
        )
        for odometry, number in (("right", 0), ("right", 2), ("vague", 0), ("unknown", 0), ("wrong", 2))
    },
    "there-and-back": partial(among_craters, seed=2, spots=(WEST, EAST, WEST), number=0),
    "same-spot": partial(among_craters, seed=2, spots=(WEST, WEST), number=1),
    "fog-between": partial(among_craters, seed=3, spots=(WEST, (50.0, 47.0), EAST), number=0, fog=(1,)),
    "hills": partial(among_hills, seed=1, steps=((0.0, 6.0), (4.0, 2.0))),
    "hills-heading": partial(among_hills, seed=2, steps=((5.0, 3.0), (5.0, 3.0)), odometry="heading"),
    "hills-wrong": partial(among_hills, seed=4, steps=((-6.0, 1.0),), odometry="wrong"),
    "hills-fog": partial(among_hills, seed=5, steps=((3.0, 5.0), (3.0, -5.0)), fog=(1,)),
    "hills-near": partial(among_hills, seed=6, steps=((0.2, 0.3),)),
}
