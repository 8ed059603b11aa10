"""The search finds where a skyline was seen from, says how sure it is, and does not answer where it cannot.

Contours come from the very surface that is searched; pictures and other surfaces are the end-to-end tests' affair.
"""

import dataclasses
from pathlib import Path

import cv2
import numpy as np
import pytest
from seen_from import PLACE, observe

from localizer.bundle import load_bundle
from localizer.dem.geodesy import rowcol_to_lonlat
from localizer.dem.horizon import Terrain, half_cell_relief_m, prepare_terrain
from localizer.dem.lattice import dem_from_array, load_dem
from localizer.fix import Fix
from localizer.observation import PriorCircle
from localizer.search.answer import fix_of
from localizer.search.contours import FrameContour, frame_contour, measured_skyline
from localizer.search.fit.local_grid import grid_optima, grid_second_moment
from localizer.search.fit.noise import Noise, initial_noise
from localizer.search.fit.problem import Problem
from localizer.search.fit.problems import problems_of, without_edge_columns
from localizer.search.fit.refine import Refined, refine
from localizer.search.fit.residuals import evaluate
from localizer.search.locate import _refined_on_exact_dem, check_located, locate
from localizer.search.locate import observe as observation_of
from localizer.search.stage1 import bands, heading_offsets_deg, search_stage1
from localizer.skyline.find import ColumnState, Skyline

SANTA_CRUZ = Path(__file__).parents[3] / "sim" / "terrain" / "santa_cruz_srtm_1s.tif"


@pytest.fixture(scope="module")
def terrain() -> Terrain:
    return prepare_terrain(load_dem([SANTA_CRUZ]))


@pytest.fixture(scope="module")
def plain(terrain):
    """An ordinary observation, and the search's answer to it."""
    observation = observe(terrain)
    return observation, locate(terrain, observation)


def error_cells(located, place=PLACE) -> float:
    return float(np.hypot(located.best.row - place[0], located.best.col - place[1]))


def test_the_place_is_found_within_a_small_part_of_a_cell(plain):
    _, located = plain
    assert located.decision.status == "fix"
    assert error_cells(located) < 0.05
    assert located.best.azimuth_bias_deg == pytest.approx(0.7, abs=0.15)


@pytest.mark.long
def test_the_error_agrees_with_the_covariance(terrain):
    """Squared errors in units of the covariance average to 0.76 over 12 seeds, not to the two dimensions of the place.

    The covariance allows for what lies between the cells, and these contours are of the searched surface. Where errors of
    all kinds are drawn (``test_stated_sigmas``), the sigmas are right.
    """
    squares = []
    for seed in range(6):
        located = locate(terrain, observe(terrain, noise_px=2.0, seed=seed))
        best = located.best
        dem = terrain.dem
        off = np.array([(best.col - PLACE[1]) * dem.spacing_ew_m, (PLACE[0] - best.row) * dem.spacing_ns_m])
        squares.append(off @ np.linalg.solve(best.covariance_enu_m2, off))
    assert 0.4 < np.mean(squares) < 1.5


def declared(terrain: Terrain, error_m: float) -> Terrain:
    return dataclasses.replace(terrain, dem=dataclasses.replace(terrain.dem, error_m=error_m))


def test_an_exact_dem_gives_a_smaller_covariance_where_it_fits(terrain):
    observation = observe(terrain, noise_px=3.0)
    with_default = locate(terrain, observation)
    # what the search of an exact DEM does after that of one with the default error
    exact = _refined_on_exact_dem(declared(terrain, 0.0), observation, with_default)
    assert exact.decision.status == with_default.decision.status == "fix"
    sigma_m = np.sqrt([np.trace(found.best.covariance_enu_m2) for found in (exact, with_default)])
    assert sigma_m[0] < 0.9 * sigma_m[1]
    assert error_cells(exact) * terrain.cell_m < 4.0 * sigma_m[0]
    assert (exact.best.row, exact.best.col) != (with_default.best.row, with_default.best.col)


@pytest.mark.long
@pytest.mark.parametrize(("rms_m", "reach_cells"), [(2.0, 0.0), (1.0, 3.0)])
def test_a_dem_wrongly_declared_exact_gives_the_result_of_the_default_error_model(
    terrain, rms_m, reach_cells
):
    observation = observe(terrain)
    off = np.random.default_rng(3).normal(0.0, 1.0, terrain.dem.z_m.shape)
    if reach_cells:
        off = cv2.GaussianBlur(off, (0, 0), reach_cells)
    z_m = (terrain.dem.z_m + rms_m * off / off.std()).astype(np.float32)
    wrong = prepare_terrain(dataclasses.replace(terrain.dem, z_m=z_m))
    with_default, exact = locate(wrong, observation), locate(declared(wrong, 0.0), observation)
    assert exact.decision.status == with_default.decision.status != "none"
    assert (exact.best.row, exact.best.col) == (with_default.best.row, with_default.best.col)
    assert exact.best.dem_error_m > 0.5


@pytest.mark.parametrize("beyond_cells", [pytest.param(2, marks=pytest.mark.long), 5])
def test_a_camera_just_beyond_the_end_of_the_dem_gives_none(terrain, beyond_cells):
    place, dem = (200.1, 500.5), terrain.dem
    south = dem_from_array(dem.z_m[round(place[0]) + beyond_cells :], dem.transform, dem.crs)
    located = locate(prepare_terrain(south), observe(terrain, place))
    assert located.decision.status == "none"
    assert located.best is None


def test_the_declared_dem_error_is_the_initial_one(terrain):
    assert declared(terrain, 7.5).nominal_error_m == 7.5
    assert declared(terrain, 7.5).largest_error_m == 30.0
    assert declared(terrain, 0.001).largest_error_m == 3.0, "too little said loses no place"
    assert terrain.nominal_error_m >= 3.0
    assert declared(terrain, 7.5).near_m == terrain.near_m > 0.0
    assert declared(terrain, 0.0).near_m == 0.0
    assert declared(terrain, 0.0).with_error_model().nominal_error_m == terrain.nominal_error_m


def test_stage_one_keeps_the_true_cell_and_counts_what_it_did(terrain):
    observation = observe(terrain)
    skyline = measured_skyline(observation, tuple(frame_contour(f) for f in observation.frames))
    directions = bands(skyline, heading_offsets_deg(1.0))
    stage1 = search_stage1(terrain, directions, 2.0, observation.altitude_m, 5.0, 3.0)
    left = [len(cells) for cells in stage1.survivors.values()]
    assert left == sorted(left, reverse=True)
    assert left[-1] < 0.01 * stage1.cells
    assert np.abs(stage1.last - np.round(PLACE)).sum(axis=1).min() <= 1
    assert stage1.points_explored > left[0]
    assert [band.label for band in directions] == list(stage1.survivors)[1:]


def test_the_lowest_skyline_is_searched_first(terrain):
    observation = observe(terrain)
    skyline = measured_skyline(observation, tuple(frame_contour(f) for f in observation.frames))
    highest = [
        np.median(band.high[np.isfinite(band.high)]) for band in bands(skyline, heading_offsets_deg(1.0))
    ]
    assert highest == sorted(highest)


def test_heading_hypotheses_cover_three_sigma_and_fit_the_mask():
    assert heading_offsets_deg(0.0) == pytest.approx([0.0])
    offsets = heading_offsets_deg(1.0)
    assert offsets[0] <= -3.0
    assert offsets[-1] >= 3.0
    assert len(heading_offsets_deg(180.0)) <= 64


def test_half_a_cell_away_the_ground_differs_by_half_a_step():
    relief = half_cell_relief_m(np.array([[0.0, 10.0, 10.0], [0.0, 10.0, 14.0]], np.float32))
    assert relief == pytest.approx(np.array([[5.0, 5.0, 2.0], [5.0, 5.0, 2.0]]))


@pytest.mark.parametrize("azimuths", [(20.0, 140.0, 260.0), (0.0, 40.0, 80.0, 120.0, 200.0, 290.0)])
def test_frames_may_have_any_azimuths_and_any_number(terrain, azimuths):
    located = locate(terrain, observe(terrain, azimuths=azimuths))
    assert located.decision.status == "fix"
    assert error_cells(located) < 0.1


def test_frames_that_agree_are_all_kept(terrain, plain):
    observation, located = plain
    answer = check_located(terrain, observation, located)
    assert answer.left_out is None
    assert min(answer.agreement.values()) > 0.9


def test_without_an_altimeter_the_place_is_still_found(terrain):
    located = locate(terrain, dataclasses.replace(observe(terrain), altitude_m=None, altitude_sigma_m=np.inf))
    assert located.decision.status == "fix"
    assert error_cells(located) < 0.1


def test_a_place_outside_the_dem_is_not_found(terrain):
    dem = terrain.dem
    elsewhere = dataclasses.replace(
        dem, z_m=np.where(np.arange(dem.cols)[None, :] < 300, dem.z_m, np.float32(np.nan)).astype(np.float32)
    )
    located = locate(prepare_terrain(elsewhere), observe(terrain, (400.0, 600.0)))
    assert located.decision.status == "none"
    assert located.best is None


def test_an_altitude_outside_the_dem_finds_nothing(terrain):
    located = locate(terrain, dataclasses.replace(observe(terrain), altitude_m=5000.0))
    assert located.decision.status == "none"


def test_places_close_to_each_other_are_compared_by_the_same_columns_whose_horizon_the_dem_has(terrain):
    place, dem = (300.3, 300.2), terrain.dem
    cut = prepare_terrain(dem_from_array(dem.z_m[: round(place[0]) + 60], dem.transform, dem.crs))
    observation = observe(terrain, place)
    problems = problems_of(cut, observation, tuple(frame_contour(f) for f in observation.frames))
    start = refine(
        problems.coarse,
        *place,
        float(dem.ground_m(*place)) + 2.0,
        0.7,
        iterations=4,
        noise=initial_noise(cut, 3.0),
        largest_dem_error_m=12.0,
        estimate_noise=True,
    )
    remaining = without_edge_columns(problems, start)
    frame = cut.geodesics.at(start.row, start.col)[0]
    on_edge, left = (
        evaluate(each.full, start.parameters(), (start.row, start.col), frame).dem_edge
        for each in (problems, remaining)
    )
    assert 0.02 < on_edge.mean() < 0.5
    assert len(left) == np.count_nonzero(~on_edge)
    assert not left.any()
    assert len(remaining.full.contours) == len(problems.full.contours)
    assert remaining.full.sector_columns == problems.full.sector_columns


def test_removed_columns_do_not_raise_the_weight_of_the_rest_of_their_sector(terrain):
    """A few columns here and there fit many a place."""
    observation = observe(terrain)
    contours = tuple(frame_contour(f) for f in observation.frames)
    few = tuple(FrameContour(c.frame, c.rays[::40], c.sigma_rad[::40]) for c in contours)
    eye_m = float(terrain.dem.ground_m(*PLACE)) + 2.0

    def evidence(problem: Problem) -> float:
        noise = initial_noise(terrain, 3.0)
        found = refine(
            problem,
            *PLACE,
            eye_m,
            0.7,
            iterations=3,
            noise=noise,
            largest_dem_error_m=12.0,
            estimate_noise=False,
        )
        return found.evidence

    whole = Problem(terrain, observation, contours)
    left = Problem(terrain, observation, few, uses_edge_columns=True, sector_columns=whole.sector_columns)
    assert evidence(left) < 0.1 * evidence(whole)
    assert evidence(Problem(terrain, observation, few)) > 0.5 * evidence(whole), "a thinned contour is whole"


@pytest.mark.long
def test_a_skyline_beyond_the_end_of_the_dem_does_not_lose_the_place(terrain):
    """What rises behind the last cells is seen, but not known; where the DEM ends no ridge is believed in."""
    place, dem = (300.3, 300.2), terrain.dem
    ends_near = prepare_terrain(dem_from_array(dem.z_m[: round(place[0]) + 60], dem.transform, dem.crs))
    located = locate(ends_near, observe(terrain, place))
    assert located.decision.status == "fix"
    assert error_cells(located, place) < 0.1
    without_edge = dataclasses.replace(ends_near, dem_edge=np.zeros_like(ends_near.dem_edge))
    assert locate(without_edge, observe(terrain, place)).decision.status == "none"


def test_no_contour_at_all_finds_nothing(terrain):
    observation = observe(terrain)
    empty = np.zeros(0)
    blind = tuple(dataclasses.replace(f, u_px=empty, v_px=empty, sigma_px=empty) for f in observation.frames)
    assert locate(terrain, dataclasses.replace(observation, frames=blind)).decision.status == "none"


def test_a_prior_keeps_the_search_within_its_circle(terrain):
    lon, lat = rowcol_to_lonlat(terrain.dem, *PLACE)
    near = PriorCircle(float(lat), float(lon), 1500.0)
    located = locate(terrain, dataclasses.replace(observe(terrain), prior=near))
    assert located.decision.status == "fix"
    assert located.stage1.survivors["altitude"].shape[0] < 10_000
    lon, lat = rowcol_to_lonlat(terrain.dem, 100.0, 700.0)
    wrong = PriorCircle(float(lat), float(lon), 1500.0)
    assert locate(terrain, dataclasses.replace(observe(terrain), prior=wrong)).decision.status == "none"


def test_the_fix_follows_the_contract(terrain, plain):
    observation, located = plain
    fix = fix_of(terrain, observation, located, "a bundle", located.timing_s)
    reread = Fix.model_validate_json(fix.to_json())
    assert reread.position.crs == "EPSG:32610"
    assert reread.position.row == pytest.approx(PLACE[0], abs=0.1)
    assert reread.nuisance.altitude_bias_m == pytest.approx(3.0, abs=2.0)
    assert reread.stage1.cells == 640_000
    assert list(reread.stage1.after) == list(located.stage1.survivors)[1:]
    assert set(reread.residual) == {f.label for f in observation.frames}


def test_refinement_converges_from_two_cells_away(terrain):
    observation = observe(terrain, azimuth_bias_deg=0.0)
    problem = Problem(terrain, observation, tuple(frame_contour(f) for f in observation.frames), stride=8)
    eye = float(terrain.dem.ground_m(*PLACE)) + 2.0

    def fit(row: float, col: float, altitude_m: float, noise: Noise) -> Refined:
        return refine(
            problem,
            row,
            col,
            altitude_m,
            0.0,
            iterations=25,
            noise=noise,
            largest_dem_error_m=12.0,
            estimate_noise=True,
        )

    descended = fit(PLACE[0] + 1.4, PLACE[1] - 1.4, eye, initial_noise(terrain, 6.0))
    assert np.hypot(descended.row - PLACE[0], descended.col - PLACE[1]) < 0.25
    around = grid_optima(problem, descended, [initial_noise(terrain, 0.5)], 0.75, 0.25, 2)
    converged = min((fit(*place) for place in around), key=lambda refined: refined.neg_log_posterior)
    assert np.hypot(converged.row - PLACE[0], converged.col - PLACE[1]) < 0.05
    assert converged.neg_log_posterior < descended.neg_log_posterior


def test_the_ellipse_reaches_only_to_places_that_are_plausible(terrain):
    observation = observe(terrain)
    problem = Problem(terrain, observation, tuple(frame_contour(f) for f in observation.frames), 16)
    noise = initial_noise(terrain, 5.0)
    fit = refine(
        problem,
        *PLACE,
        observation.altitude_m,
        0.0,
        iterations=8,
        noise=noise,
        largest_dem_error_m=5.0,
        estimate_noise=False,
    )

    def widest_cells(plausible: bool) -> float:
        flat = grid_second_moment(problem, fit, noise, 2.0, 1.0, 1000.0, lambda *_: plausible)
        return float(np.sqrt(np.linalg.eigvalsh(flat)[-1])) / terrain.cell_m

    # at such a temperature all of the lattice is about as likely
    assert 1.0 < widest_cells(True) < 2.0
    assert widest_cells(False) < 0.8 * widest_cells(True)


def test_an_altitude_sigma_of_zero_is_raised_to_a_positive_one(edit_bundle):
    bundle = load_bundle(edit_bundle(lambda b: b["altitude"].update(sigma_m=0.0)))
    nothing = np.full(16, np.nan)
    blind = Skyline(nothing, nothing, np.zeros(16), np.full(16, ColumnState.NO_SKY, np.uint8))
    assert observation_of(bundle, [blind, blind]).altitude_sigma_m > 0.0
