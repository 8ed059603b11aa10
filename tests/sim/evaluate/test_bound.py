"""The Cramér-Rao bound against what is known of it otherwise."""

import numpy as np
import pytest

from sim.evaluate.crlb import cramer_rao_bound, position_covariance, rms_m
from sim.evaluate.disturb import Disturbed, disturb, true_contours
from sim.evaluate.scenario import EvaluationScenario
from sim.evaluate.truth import Truth, case_generators, draw_truth
from sim.world.contour import skyline_contour
from sim.world.surface import Surface
from sim.world.terrain import read_terrain

COLUMNS = 80


def scenario(**sections: dict[str, object]) -> EvaluationScenario:
    camera = {
        "width_px": COLUMNS,
        "height_px": 60,
        "fx_px": 60.0,
        "fy_px": 60.0,
        "cx_px": 39.5,
        "cy_px": 29.5,
    }
    exact = dict.fromkeys(("azimuth_bias_sigma_deg", "tilt_bias_sigma_deg"), 0.0)
    exact |= dict.fromkeys(("azimuth_sigma_deg", "tilt_sigma_deg", "roll_sigma_deg"), 0.0)
    errors = exact | {"contour_sigma_px": 0.5} | sections.pop("errors", {})
    return EvaluationScenario.model_validate({"camera": camera, "errors": errors, **sections})


@pytest.fixture(scope="module")
def surface(santa_cruz) -> Surface:
    return Surface(read_terrain([santa_cruz]))


def drawn(surface: Surface, what: EvaluationScenario, case: int = 0) -> tuple[Truth, Disturbed, np.ndarray]:
    rng = case_generators(3, case)
    truth = draw_truth(surface, what, rng)
    columns = np.arange(COLUMNS, dtype=float)
    return truth, disturb(truth, what, columns, true_contours(truth, what.camera, columns), rng), columns


def test_two_observations_of_one_coordinate_each_give_each_its_own_sigma() -> None:
    """Rows that change by 0.5 px/m to the east and 0.25 px/m to the north, known to 1 px: 2 m and 4 m."""
    covariance = position_covariance(np.diag([0.5, 0.25]), np.eye(2), np.zeros(2))
    np.testing.assert_allclose(covariance, np.diag([4.0, 16.0]))
    assert rms_m(covariance) == pytest.approx(np.sqrt(20.0))


def test_an_unknown_bias_costs_what_its_prior_leaves_open() -> None:
    """The bias adds to east's row: its variance adds to the row's."""
    jacobian = np.array([[1.0, 0.0, 1.0], [0.0, 1.0, 0.0]])
    covariance = position_covariance(jacobian, np.eye(2), np.array([0.0, 0.0, 1.0 / 9.0]))
    np.testing.assert_allclose(covariance, np.diag([1.0 + 9.0, 1.0]))


def test_a_coordinate_that_nothing_depends_on_has_no_bound() -> None:
    assert position_covariance(np.array([[1.0, 0.0]]), np.eye(1), np.zeros(2)) is None


def test_a_least_squares_fit_to_noisy_contours_errs_as_the_bound_says(surface: Surface) -> None:
    """All but east and north is known, and the fit uses nothing but exact contours around."""
    what = scenario()
    truth, clean, columns = drawn(surface, what)
    bound = cramer_rao_bound(truth, what, columns, clean)
    south_m, east_m = surface.terrain.cell_size_m()
    here = truth.observer

    def contour(offset_m: np.ndarray) -> np.ndarray:
        row, col = here.row - offset_m[1] / south_m, here.col + offset_m[0] / east_m
        eye = surface.observer(row, col, surface.height(row, col) + what.vehicle.mast_height_m)
        return np.concatenate(
            [skyline_contour(surface, eye, what.camera, f.rotation, columns) for f in truth.frames]
        )

    def slope(at: np.ndarray) -> np.ndarray:
        return np.column_stack([(contour(at + step) - contour(at - step)) / 0.2 for step in 0.1 * np.eye(2)])

    exact, first = contour(np.zeros(2)), slope(np.zeros(2))
    good = np.isfinite(exact) & np.isfinite(first).all(axis=1)
    rng = np.random.default_rng(5)
    errors = []
    for _ in range(40):
        seen = exact + 0.5 * rng.standard_normal(len(exact))
        place = np.zeros(2)
        for _ in range(2):
            step, *_ = np.linalg.lstsq(first[good], (seen - contour(place))[good], rcond=None)
            place = place + step
        errors.append(place)
    rmse = np.sqrt(np.mean(np.sum(np.square(errors), axis=1)))
    assert rmse == pytest.approx(rms_m(bound.covariance_m2), rel=0.3)


def test_what_is_known_less_well_bounds_the_place_less(surface: Surface) -> None:
    truth, clean, columns = drawn(surface, scenario())

    def rms(**sections: dict[str, object]) -> tuple[float, float]:
        bound = cramer_rao_bound(truth, scenario(**sections), columns, clean)
        return rms_m(bound.covariance_m2), rms_m(bound.free_altitude_m2)

    least, least_free = rms()
    noisy, _ = rms(errors={"contour_sigma_px": 1.0})
    assert noisy == pytest.approx(2.0 * least, rel=0.02)
    assert least_free > least
    assert rms(errors={"azimuth_bias_sigma_deg": 1.0})[0] > 1.005 * least
    assert rms(errors={"contour_correlated_sigma_px": 0.5})[0] > 1.2 * least
    assert rms(dem_error={"rms_m": 5.0})[0] > 1.5 * least


def test_a_horizon_close_by_counts_only_where_the_surface_is_known_exactly(surface: Surface) -> None:
    worse = []
    for case in range(6):
        truth, clean, columns = drawn(surface, scenario(), case)
        bound = cramer_rao_bound(truth, scenario(), columns, clean)
        worse.append(rms_m(bound.far_horizon_m2) / rms_m(bound.covariance_m2))
        assert rms_m(bound.wary_m2) >= max(rms_m(bound.far_horizon_m2), rms_m(bound.free_altitude_m2)) - 1e-9
    assert min(worse) >= 1.0 - 1e-9
    assert max(worse) > 1.2


def test_an_error_that_camera_and_skyline_share_does_little_harm(surface: Surface) -> None:
    """Raised by 5 m over many kilometres, the DEM is as good as before to all but an altimeter."""
    blind = {"errors": {"altimeter": False}}
    truth, clean, columns = drawn(surface, scenario(**blind))
    least = rms_m(cramer_rao_bound(truth, scenario(**blind), columns, clean).covariance_m2)

    def rms(correlation_m: float) -> float:
        wrong = scenario(**blind, dem_error={"rms_m": 5.0, "correlation_m": correlation_m})
        return rms_m(cramer_rao_bound(truth, wrong, columns, clean).covariance_m2)

    assert rms(1e6) == pytest.approx(least, rel=0.1)
    assert rms(200.0) > 1.5 * least
