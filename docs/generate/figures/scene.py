"""A simulated case on the terrain that ships, and what the search makes of it: what all figures draw.

Whatever the figures need of the search's insides is named here, so that they have one place to follow it.
"""

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from localizer.dem.geodesy import geod, lonlat_to_rowcol, rowcol_to_lonlat
from localizer.dem.horizon import Terrain
from localizer.observation import Observation
from localizer.search.answer import Located
from localizer.search.contours import MeasuredSkyline, frame_contour, measured_skyline
from localizer.search.fit.correlated_errors import normal_equations, whitened_nll
from localizer.search.fit.objective import ordered_columns, prior_nll
from localizer.search.fit.outliers import informative_columns, weights
from localizer.search.fit.problem import ALTITUDE, EAST, NORTH
from localizer.search.fit.problems import problems_of
from localizer.search.fit.residuals import evaluate, ground_at, residual_sigma
from localizer.search.locate import locate
from localizer.search.stage1 import Band, bands, heading_offsets_deg
from sim.evaluate.case import true_surface
from sim.evaluate.contour_level import observation_of
from sim.evaluate.disturb import disturb, true_contours
from sim.evaluate.scenario import load_evaluation_scenario
from sim.evaluate.searched_dem import searched_terrain
from sim.evaluate.truth import case_generators, draw_truth

ROOT = Path(__file__).resolve().parents[3]
DEM = ROOT / "sim" / "terrain" / "santa_cruz_srtm_1s.tif"
SCENARIO = ROOT / "configs" / "scenarios" / "evaluate" / "realistic.toml"
SEED = 7
NUISANCE_STEPS = 3
COMPACT, SEVERAL_PEAKS = 3, 8
"""Cases where the likelihood has one peak, and where the fits end at several."""

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Scene:
    """One case: the truth (row, column, altitude of the camera), what was observed, and the answer."""

    terrain: Terrain
    row: float
    col: float
    altitude_m: float
    observation: Observation
    located: Located

    @property
    def cell_m(self) -> tuple[float, float]:
        """Size of a cell to the east and to the north."""
        return self.terrain.dem.spacing_ew_m, self.terrain.dem.spacing_ns_m

    def offset_m(self, row: float, col: float) -> tuple[float, float]:
        """Metres east and north of the true place."""
        east_m, north_m = self.cell_m
        return (col - self.col) * east_m, (self.row - row) * north_m


@cache
def scene(case: int) -> Scene:
    """The case of the realistic scenario, located."""
    scenario = load_evaluation_scenario(SCENARIO)
    generators = case_generators(SEED, case)
    truth = draw_truth(true_surface(DEM), scenario, generators)
    columns_px = np.arange(scenario.camera.width_px, dtype=float)
    exact = true_contours(truth, scenario.camera, columns_px)
    disturbed = disturb(truth, scenario, columns_px, exact, generators)
    observation = observation_of(truth, scenario, columns_px, disturbed)
    terrain = searched_terrain(DEM)
    observer = truth.observer
    return Scene(
        terrain, observer.row, observer.col, observer.altitude_m, observation, locate(terrain, observation)
    )


def skyline_of(here: Scene) -> MeasuredSkyline:
    """The skyline of all frames over the azimuth, as the compass has it."""
    contours = tuple(frame_contour(frame) for frame in here.observation.frames)
    return measured_skyline(here.observation, contours)


def central_bands(here: Scene) -> tuple[list[Band], int]:
    """Stage 1's band of each direction, in its order, and the heading hypothesis that is nearest to the truth."""
    offsets_deg = heading_offsets_deg(here.observation.azimuth_bias_sigma_deg)
    best = here.located.best
    true_deg = best.azimuth_bias_deg if best else 0.0
    return bands(skyline_of(here), offsets_deg), int(np.abs(offsets_deg - true_deg).argmin())


def profile_m(terrain: Terrain, row: float, col: float, azimuth_deg: float, distance_m: Floats) -> Floats:
    """Height of the terrain (n,) at distances from a place."""
    lon_deg, lat_deg = (float(value) for value in rowcol_to_lonlat(terrain.dem, row, col))
    same = np.ones(len(distance_m))
    lon, lat, _ = geod(terrain.dem).fwd(lon_deg * same, lat_deg * same, azimuth_deg * same, distance_m)
    rows, cols = lonlat_to_rowcol(terrain.dem, lon, lat)
    return np.asarray(terrain.dem.ground_m(rows, cols), np.float64)


def cost_around(here: Scene, reach_m: float, step_m: float) -> tuple[Floats, Floats]:
    """Negative log-posterior (n, n) on a lattice around the fix, and its ticks (n,), metres east and north of the fix.

    At each point the altitude and all errors of the sensors are fitted. The error model, and the weight of each column, are
    those of the fix: this is the surface whose curvature at the fix is the inverse of the covariance.
    """
    best = here.located.best
    assert best is not None
    contours = tuple(frame_contour(frame) for frame in here.observation.frames)
    problem = problems_of(here.terrain, here.observation, contours).fine
    model = best.error_model
    frame = here.terrain.geodesics.at(np.array([best.row]), np.array([best.col]))[0]
    place = best.row, best.col
    at_fix = evaluate(problem, best.parameters(), place, frame)
    sigma = residual_sigma(problem, at_fix, best.dem_error_m)
    weight = weights(informative_columns(at_fix, sigma), at_fix.residual / sigma)

    def fitted(east_m: float, north_m: float) -> float:
        x = best.parameters()
        x[EAST], x[NORTH] = east_m, north_m
        x[ALTITUDE] += ground_at(problem, x, place, frame)[0] - at_fix.ground_m
        for _ in range(NUISANCE_STEPS):
            there = evaluate(problem, x, place, frame, at_fix.guess_m)
            columns = ordered_columns(problem, x, there, model, weight)
            normal = normal_equations(columns, model, robust=False)
            x[ALTITUDE:] -= np.linalg.solve(normal.hessian[ALTITUDE:, ALTITUDE:], normal.gradient[ALTITUDE:])
        there = evaluate(problem, x, place, frame, at_fix.guess_m)
        columns = ordered_columns(problem, x, there, model, weight)
        return whitened_nll(columns, model, robust=False) + prior_nll(problem, x, there, model)

    ticks = np.arange(-reach_m, reach_m + 0.5 * step_m, step_m)
    return np.array([[fitted(east, north) for east in ticks] for north in ticks]), ticks
