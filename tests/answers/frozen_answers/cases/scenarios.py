"""Contours of every scenario of ``sim evaluate``: on pieces of the terrain that ships, and once each on all of it."""

from functools import partial
from pathlib import Path

import numpy as np

import sim
from frozen_answers.ground import Grid, Ground, hills, shipped
from frozen_answers.inputs import Look, Question
from sim.evaluate.contour_level import observation_of
from sim.evaluate.disturb import disturb, true_contours
from sim.evaluate.scenario import EvaluationScenario, load_evaluation_scenario
from sim.evaluate.searched_dem import HALVES, beyond
from sim.evaluate.truth import Truth, case_generators, draw_truth, truth_at
from sim.evaluate.twins import draw_twins
from sim.world.surface import Surface
from sim.world.terrain import read_terrain

SEEDS = (1, 2, 3, 4)
FEWER = {"outside": (3,)}
"""A search that finds nothing takes ten times as long."""
SIDE = 240
TWIN_CELLS = 220
EVERY_COLUMN, EVERY_THIRD = 1, 3
NAMES = sorted(path.stem for path in (sim.SCENARIOS / "evaluate").glob("*.toml"))


def whole(name: str, folder: Path) -> Question:
    """On all of the terrain, with every column."""
    return _question(name, shipped(), 1, EVERY_COLUMN, folder)


def piece(name: str, seed: int, folder: Path) -> Question:
    """On a piece of it, with every third column."""
    row, col = (int(corner) for corner in np.random.default_rng([seed, 4]).integers(0, 800 - SIDE, 2))
    return _question(name, hills(SIDE, row, col), seed, EVERY_THIRD, folder)


def _question(name: str, grid: Grid, seed: int, every: int, folder: Path) -> Question:
    scenario = load_evaluation_scenario(sim.SCENARIOS / "evaluate" / f"{name}.toml")
    rng = case_generators(seed, 0)
    if scenario.twins is not None:
        return _twins(scenario, seed, every, folder)
    known = Surface(read_terrain([grid.write(folder / "truth.tif")]))
    searched, allowed = grid, None
    if scenario.searched == "other half":
        side = HALVES[int(rng("half").integers(len(HALVES)))]
        allowed = beyond(known, side, scenario.outside_margin_m)
        rows, cols = (count // 2 for count in grid.height_m.shape)
        parts = {
            "north": (slice(0, rows), slice(None)),
            "south": (slice(rows, None), slice(None)),
            "west": (slice(None), slice(0, cols)),
            "east": (slice(None), slice(cols, None)),
        }
        searched = grid.piece(*parts[side])
    truth = draw_truth(known, _milder(scenario, grid), rng, allowed)
    return Question(Ground((searched,)), (_look(truth, scenario, seed, every),))


def _milder(scenario: EvaluationScenario, grid: Grid) -> EvaluationScenario:
    """A piece has few places that see it alone."""
    if len(grid.height_m) > SIDE:
        return scenario
    place = scenario.place.model_copy(update={"edge_margin_m": 300.0, "enclosed_fraction": 0.8})
    return scenario.model_copy(update={"place": place, "outside_margin_m": 300.0})


def _twins(scenario: EvaluationScenario, seed: int, every: int, folder: Path) -> Question:
    assert scenario.twins is not None
    known = Surface(read_terrain([shipped().write(folder / "truth.tif")]))
    twins = (
        scenario.twins if every == EVERY_COLUMN else scenario.twins.model_copy(update={"cells": TWIN_CELLS})
    )
    rng = case_generators(seed, 0)
    drawn = draw_twins(known, scenario, twins, rng)
    truth = truth_at(drawn.surface, drawn.observer, scenario, rng)
    grid = shipped().piece(slice(drawn.first_row, None), slice(drawn.first_col, None))
    searched = Grid(drawn.surface.height_m.astype(np.float64), grid.transform, grid.crs)
    return Question(Ground((searched,)), (_look(truth, scenario, seed, every),))


def _look(truth: Truth, scenario: EvaluationScenario, seed: int, every: int) -> Look:
    columns_px = np.arange(0.0, scenario.camera.width_px, every)
    exact = true_contours(truth, scenario.camera, columns_px)
    disturbed = disturb(truth, scenario, columns_px, exact, case_generators(seed, 0))
    observer = truth.observer
    lon_deg, lat_deg = truth.surface.terrain.lonlat_deg(observer.row, observer.col)
    return Look(observation_of(truth, scenario, columns_px, disturbed), (float(lon_deg), float(lat_deg)))


CASES = {f"{name}/{seed}": partial(piece, name, seed) for name in NAMES for seed in FEWER.get(name, SEEDS)}
CASES |= {f"{name}/whole": partial(whole, name) for name in NAMES}
