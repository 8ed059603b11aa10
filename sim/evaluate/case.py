"""One case from the drawing of the truth to the row of the table."""

import time
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Literal

import numpy as np
from affine import Affine
from numpy.typing import NDArray

from localizer.dem import dem_from_array, load_dem
from localizer.geodesy import enu_to_metric_jacobian, rowcol_to_metric
from localizer.horizon.from_terrain import Terrain, prepare_terrain
from localizer.locate import Located, fix_of, load_kernels, locate
from sim.evaluate.contour_level import observation_of, searched_contour
from sim.evaluate.crlb import cramer_rao_bound, rms_m
from sim.evaluate.disturb import disturb, true_contours
from sim.evaluate.row import CaseRow, compact_json
from sim.evaluate.scenario import EvaluationScenario
from sim.evaluate.truth import Truth, case_generators, draw_truth
from sim.surface import Surface
from sim.terrain import read_terrain

Level = Literal["contour", "image"]
Side = Literal["whole", "north", "south", "west", "east"]
HALVES: tuple[Side, ...] = ("north", "south", "west", "east")

NEAR_CELLS = 3.0
NEAR_SIGMAS = 5.0


@dataclass(frozen=True)
class Experiment:
    """What is evaluated: enough to make any case of it again."""

    dems: tuple[Path, ...]
    scenario: EvaluationScenario
    seed: int
    level: Level = "contour"
    estimator_only: bool = False

    def dem_of(self, case: int) -> Path:
        """The DEM of a case: they take turns."""
        return self.dems[case % len(self.dems)]


@lru_cache(maxsize=8)
def true_surface(dem: Path) -> Surface:
    """The surface of the truth, once in a process."""
    return Surface(read_terrain([dem]))


@lru_cache(maxsize=8)
def searched_terrain(dem: Path, side: Side = "whole") -> Terrain:
    """The DEM, or one half of it, made ready for the search, once in a process."""
    whole = load_dem([dem])
    if side != "whole":
        part = _half(whole.z_m.shape, side)
        shift = Affine.translation(part[1].start or 0, part[0].start or 0)
        whole = dem_from_array(whole.z_m[part], whole.transform @ shift, whole.crs)
    terrain = prepare_terrain(whole)
    load_kernels(terrain)
    return terrain


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
        allowed = _beyond(known, side, scenario.outside_margin_m)
    truth = draw_truth(known, scenario, rng, allowed)
    terrain = searched_terrain(dem, side)
    columns = np.arange(scenario.camera.width_px, dtype=float)
    if experiment.estimator_only:
        truth = _on_searched_ground(truth, terrain, scenario)
        place = truth.observer.row, truth.observer.col, truth.observer.altitude_m
        contours = [searched_contour(terrain, place, frame, scenario, columns) for frame in truth.frames]
    else:
        contours = true_contours(truth, scenario.camera, columns)
    disturbed = disturb(truth, scenario, columns, contours, rng)
    observation = observation_of(truth, scenario, columns, disturbed)
    begin = time.perf_counter()
    located = locate(terrain, observation)
    took_s = time.perf_counter() - begin
    bound = cramer_rao_bound(truth, scenario, columns, disturbed)
    fix = fix_of(terrain, observation, located, f"{experiment.seed}-{case}", located.timing_s)
    easting, northing = truth.easting_northing_m
    best = located.best
    error = mahalanobis2 = sigma_major = None
    if fix.position is not None and fix.covariance_m2 is not None:
        off = np.array([fix.position.easting_m - easting, fix.position.northing_m - northing])
        covariance = np.array(fix.covariance_m2)
        error = float(np.hypot(*off))
        mahalanobis2 = float(off @ np.linalg.solve(covariance, off))
        sigma_major = float(np.sqrt(np.linalg.eigvalsh(covariance)[-1]))
    among = _probability_of_truth(terrain, located, (easting, northing))
    return CaseRow(
        case=case,
        seed=experiment.seed,
        dem=dem.name,
        outside=side != "whole",
        true_row=truth.observer.row,
        true_col=truth.observer.col,
        true_easting_m=easting,
        true_northing_m=northing,
        true_altitude_m=truth.observer.altitude_m,
        frames=sum(len(frame.u_px) > 1 for frame in observation.frames),
        status=fix.status,
        error_m=error,
        error_cells=None if error is None else error / terrain.cell_m,
        mahalanobis2=mahalanobis2,
        probability=fix.probability if best else None,
        best_candidate_probability=max((c.probability for c in fix.candidates), default=None),
        candidates=len(fix.candidates),
        truth_among=among is not None,
        truth_probability=among or 0.0,
        sigma_major_m=sigma_major,
        crlb_rms_m=rms_m(bound.covariance_m2),
        crlb_free_altitude_rms_m=rms_m(bound.free_altitude_m2),
        easting_m=fix.position.easting_m if fix.position else None,
        northing_m=fix.position.northing_m if fix.position else None,
        dem_error_m=best.dem_error_m if best else None,
        correlation_columns=best.correlation_columns if best else None,
        inlier_share=best.inlier_share if best else None,
        evidence=best.evidence if best else None,
        prior_chi2=best.prior_chi2 if best else None,
        azimuth_bias_deg=best.azimuth_bias_deg if best else None,
        cells=fix.stage1.cells,
        after_altitude=fix.stage1.after_altitude,
        after=compact_json(fix.stage1.after),
        points_explored=fix.stage1.points_explored,
        time_s=took_s,
        timing_s=compact_json(fix.timing_s),
    )


def _half(shape: tuple[int, ...], side: Side) -> tuple[slice, slice]:
    rows, cols = shape
    whole = slice(None)
    return {
        "whole": (whole, whole),
        "north": (slice(0, rows // 2), whole),
        "south": (slice(rows // 2, rows), whole),
        "west": (whole, slice(0, cols // 2)),
        "east": (whole, slice(cols // 2, cols)),
    }[side]


def _beyond(surface: Surface, searched: Side, margin_m: float) -> NDArray[np.bool_]:
    """Lattice points (rows, cols) of the half that is not searched, ``margin_m`` or more from the one that is."""
    south_m, east_m = surface.terrain.cell_size_m()
    rows, cols = surface.height_m.shape
    vertical = searched in ("north", "south")
    count, cell_m = (rows, south_m) if vertical else (cols, east_m)
    index = np.arange(count)
    middle, margin = count // 2, margin_m / cell_m
    suits = index >= middle + margin if searched in ("north", "west") else index < middle - margin
    return np.broadcast_to(suits[:, None] if vertical else suits[None, :], (rows, cols))


def _on_searched_ground(truth: Truth, terrain: Terrain, scenario: EvaluationScenario) -> Truth:
    """The same place at the altitude that the searched surface has there."""
    row, col = truth.observer.row, truth.observer.col
    altitude_m = float(terrain.dem.ground_m(row, col)) + scenario.vehicle.mast_height_m
    return truth.raised_to(altitude_m)


def _probability_of_truth(
    terrain: Terrain, located: Located, true_place_m: tuple[float, float]
) -> float | None:
    """Probability of the candidate that is the truth's; None where there is none."""
    found = []
    for candidate, probability in zip(
        located.decision.candidates, located.decision.probabilities, strict=True
    ):
        place = rowcol_to_metric(terrain.dem, candidate.row, candidate.col)
        off = np.array([float(place[0]), float(place[1])]) - true_place_m
        turn = enu_to_metric_jacobian(terrain.dem, candidate.row, candidate.col)
        covariance = turn @ candidate.covariance_enu_m2 @ turn.T
        distance_m = float(np.hypot(*off))
        sigmas = float(np.sqrt(off @ np.linalg.solve(covariance, off)))
        if distance_m <= NEAR_CELLS * terrain.cell_m or sigmas <= NEAR_SIGMAS:
            found.append((distance_m, float(probability)))
    return min(found)[1] if found else None
