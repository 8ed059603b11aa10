"""One case, from drawing the truth to its table row."""

import tempfile
import time
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from localizer.experiments import Terrain, search_bundle, search_observation, transform_xy
from sim.evaluate.case_result import CaseResult
from sim.evaluate.contour_level import observation_of, searched_contour
from sim.evaluate.crlb import Bound, cramer_rao_bound, rms_m
from sim.evaluate.disturb import disturb, true_contours
from sim.evaluate.image_level import write_pictures
from sim.evaluate.row import CaseRow, compact_json
from sim.evaluate.scenario import EvaluationScenario
from sim.evaluate.searched_dem import HALVES, Side, beyond, searched_terrain, terrain_of_twins
from sim.evaluate.truth import Generators, Truth, case_generators, draw_truth, truth_at
from sim.evaluate.twins import draw_twins
from sim.world.surface import Surface
from sim.world.terrain import read_terrain

Level = Literal["contour", "image"]
Array = NDArray[np.float64]

NEAR_CELLS = 3.0
OUTLIER_PX = 3.0
NO_BOUND = Bound(None, None, None, None)


@dataclass(frozen=True)
class Experiment:
    """An experiment: everything needed to reproduce any of its cases."""

    dems: tuple[Path, ...]
    scenario: EvaluationScenario
    seed: int
    level: Level = "contour"
    estimator_only: bool = False

    def dem_of(self, case: int) -> Path:
        """The DEM of a case: the DEMs alternate."""
        return self.dems[case % len(self.dems)]


@lru_cache(maxsize=8)
def true_surface(dem: Path) -> Surface:
    """The true surface, cached per process."""
    return Surface(read_terrain([dem]))


def run_case(experiment: Experiment, case: int) -> CaseRow:
    """Make a case and locate it.

    Raises:
        SimulationError: the DEM cannot be read or has no place for the scenario.
    """
    scenario, dem = experiment.scenario, experiment.dem_of(case)
    rng = case_generators(experiment.seed, case)
    known = true_surface(dem)
    side: Side = "whole"
    allowed = None
    if scenario.searched == "other half":
        side = HALVES[int(rng("half").integers(len(HALVES)))]
        allowed = beyond(known, side, scenario.outside_margin_m)
    error_m = 0.0 if experiment.estimator_only else None
    if scenario.twins is not None:
        twins = draw_twins(known, scenario, scenario.twins, rng)
        truth = truth_at(twins.surface, twins.observer, scenario, rng)
        terrain = terrain_of_twins(dem, twins, error_m)
    else:
        truth = draw_truth(known, scenario, rng, allowed)
        terrain = searched_terrain(dem, side, error_m)
    if experiment.estimator_only:
        truth = _on_searched_ground(truth, terrain, scenario)
    columns = np.arange(scenario.camera.width_px, dtype=float)
    if experiment.estimator_only:
        place = truth.observer.row, truth.observer.col, truth.observer.altitude_m
        exact = [searched_contour(terrain, place, frame, scenario, columns) for frame in truth.frames]
    else:
        exact = true_contours(truth, scenario.camera, columns)
    if experiment.level == "image":
        answer, bound, took_s = _locate_pictures(terrain, truth, scenario, rng), NO_BOUND, None
    else:
        answer, bound, took_s = _locate_contours(terrain, truth, scenario, columns, exact, rng)
    return _row(experiment, case, truth, terrain, side != "whole", exact, answer, bound, took_s)


def _locate_contours(
    terrain: Terrain,
    truth: Truth,
    scenario: EvaluationScenario,
    columns: Array,
    exact: list[Array],
    rng: Generators,
) -> tuple[CaseResult, Bound, float]:
    disturbed = disturb(truth, scenario, columns, exact, rng)
    observation = observation_of(truth, scenario, columns, disturbed)
    begin = time.perf_counter()
    located = search_observation(terrain, observation)
    took_s = time.perf_counter() - begin
    answer = CaseResult.to_observation(terrain, observation, located)
    return answer, cramer_rao_bound(truth, scenario, columns, disturbed), took_s


def _locate_pictures(
    terrain: Terrain, truth: Truth, scenario: EvaluationScenario, rng: Generators
) -> CaseResult:
    with tempfile.TemporaryDirectory() as folder:
        bundle = write_pictures(truth, scenario, int(rng("pictures").integers(2**32)), Path(folder) / "case")
        return CaseResult.to_bundle(search_bundle(bundle, terrain.dem))


def _on_searched_ground(truth: Truth, terrain: Terrain, scenario: EvaluationScenario) -> Truth:
    """The same place at the altitude that the searched surface has there."""
    ground_m = float(terrain.dem.ground_m(truth.observer.row, truth.observer.col))
    return truth.raised_to(ground_m + scenario.vehicle.mast_height_m)


def _row(
    experiment: Experiment,
    case: int,
    truth: Truth,
    terrain: Terrain,
    outside: bool,
    exact: list[Array],
    answer: CaseResult,
    bound: Bound,
    took_s: float | None,
) -> CaseRow:
    """``took_s``: duration of the whole search, if it differs from the sum of the fix's own times."""
    fix, errors = answer.fix, answer.errors
    easting, northing = truth.easting_northing_m
    searched, drawn = (
        terrain.dem.metric_crs,
        truth.surface.terrain.metric_crs,
    )  # for half a DEM it may be the neighbouring zone
    there_x, there_y = (float(value) for value in transform_xy(drawn, searched, easting, northing))
    off_m, mahalanobis2 = answer.off_by(there_x, there_y) or (None, None)
    truth_probability = answer.probability_of(there_x, there_y, NEAR_CELLS * terrain.cell_m)
    contour_error = _contour_errors(exact, answer)
    searching = {part: seconds for part, seconds in fix.timing_s.items() if part != "prepare"}
    return CaseRow(
        case=case,
        seed=experiment.seed,
        dem=experiment.dem_of(case).name,
        outside=outside,
        true_row=truth.observer.row,
        true_col=truth.observer.col,
        true_easting_m=there_x,
        true_northing_m=there_y,
        true_altitude_m=truth.observer.altitude_m,
        frames=sum(len(u) > 1 for u, _ in answer.contours_px),
        status=fix.status,
        error_m=off_m,
        error_cells=None if off_m is None else off_m / terrain.cell_m,
        mahalanobis2=mahalanobis2,
        probability=fix.probability if fix.position else None,
        best_candidate_probability=max((c.probability for c in fix.candidates), default=None),
        candidates=len(fix.candidates),
        truth_among=truth_probability is not None,
        truth_probability=truth_probability or 0.0,
        sigma_major_m=float(np.sqrt(np.linalg.eigvalsh(fix.covariance_m2)[-1]))
        if fix.covariance_m2
        else None,
        crlb_rms_m=rms_m(bound.covariance_m2),
        crlb_free_altitude_rms_m=rms_m(bound.free_altitude_m2),
        crlb_far_horizon_rms_m=rms_m(bound.far_horizon_m2),
        crlb_wary_rms_m=rms_m(bound.wary_m2),
        easting_m=fix.position.easting_m if fix.position else None,
        northing_m=fix.position.northing_m if fix.position else None,
        dem_error_m=errors.dem_error_m if errors else None,
        correlation_columns=errors.correlation_columns if errors else None,
        inlier_share=errors.inlier_share if errors else None,
        evidence=errors.evidence if errors else None,
        prior_chi2=errors.prior_chi2 if errors else None,
        azimuth_bias_deg=fix.nuisance.azimuth_bias_deg if fix.nuisance else None,
        columns_used=len(contour_error),
        contour_median_px=float(np.median(contour_error)) if len(contour_error) else None,
        contour_stray_share=float(np.mean(contour_error > OUTLIER_PX)) if len(contour_error) else None,
        cells=fix.stage1.cells,
        after_altitude=fix.stage1.after_altitude,
        after=compact_json(fix.stage1.after),
        points_explored=fix.stage1.points_explored,
        time_s=sum(searching.values()) if took_s is None else took_s,
        timing_s=compact_json(fix.timing_s),
    )


def _contour_errors(exact: list[Array], answer: CaseResult) -> Array:
    """Distance of the contours' points (n,) from the terrain's skyline, px; infinite if that is outside the picture."""
    errors = [
        np.abs(np.nan_to_num(true_rows[np.round(u).astype(int)], nan=np.inf) - v)
        for true_rows, (u, v) in zip(exact, answer.contours_px, strict=True)
    ]
    return np.concatenate(errors)
