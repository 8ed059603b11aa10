"""The objective's terms: priors, order and weights of the columns, outliers and occlusion, by numbers written down."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest
from fits import evaluated_columns

from localizer.observation import FrameObservation
from localizer.search.contours import FrameContour, frame_contour
from localizer.search.fit import objective
from localizer.search.fit.correlated_errors import ErrorModel
from localizer.search.fit.objective import (
    normalisation_term,
    ordered_columns,
    prior_nll,
    prior_residuals,
    visible_nll,
)
from localizer.search.fit.outliers import (
    column_nll,
    geman_mcclure,
    informative_columns,
    log_bayes_factor,
    occam_penalty,
    outlier_penalty,
    visible_columns,
    visible_residual,
    weights,
)
from localizer.search.fit.problem import ALTITUDE, AZIMUTH_BIAS, EAST, NORTH, TILT_BIAS
from localizer.search.fit.residuals import Evaluation

UNRELATED_RAD = np.radians(3.0)


def evaluated(residual_rad, **changes: object) -> Evaluation:
    ground = {"ground_m": 500.0, "ground_gradient": np.array([0.3, -0.2]), "ground_sigma_m": 4.0}
    return evaluated_columns(residual_rad, **(ground | changes))


def problem_of(count: int = 3, **changes: object) -> SimpleNamespace:
    prior = np.full(8, np.inf)
    prior[AZIMUTH_BIAS], prior[TILT_BIAS], prior[5:] = 2.0, 0.5, 0.1
    step = np.full(count, 0.01)
    step[0] = np.inf
    fields = {
        "order": np.arange(count),
        "step_rad": step,
        "sigma_rad": np.full(count, 1e-3),
        "terrain": SimpleNamespace(cell_m=30.0, exact=False),
        "prior_sigma_deg": prior,
        "observation": SimpleNamespace(altitude_m=510.0, altitude_sigma_m=5.0, mast_height_m=2.0),
        "size": 8,
        "sectors": [np.arange(count)],
        "sector_columns": count,
    }
    return SimpleNamespace(**{**fields, **changes})


# ---- priors


def test_the_readings_are_normalised_by_their_sigmas():
    """Biases of 3 and -1 deg, a tilt error of 0.05 deg; the eye at 508 m: 6 above mast and ground, 2 below the altimeter."""
    x = np.array([0.0, 0.0, 508.0, 3.0, -1.0, 0.0, 0.05, 0.0])
    residual, jacobian = prior_residuals(problem_of(), x, evaluated(np.zeros(3)), 2.0)  # type: ignore[arg-type]
    # the ground is known to hypot(1.5 * 2, 4) = 5 m
    assert residual == pytest.approx([1.5, -2.0, 0.0, 0.5, 0.0, 6.0 / 5.0, -2.0 / 5.0])
    ground, altimeter = jacobian[-2], jacobian[-1]
    assert (ground[ALTITUDE], ground[EAST], ground[NORTH]) == pytest.approx((0.2, -0.3 / 5.0, 0.2 / 5.0))
    assert altimeter[ALTITUDE] == pytest.approx(0.2)
    assert np.count_nonzero(altimeter) == 1
    assert jacobian[:5, 3:] == pytest.approx(np.diag([0.5, 2.0, 10.0, 10.0, 10.0]))
    model = ErrorModel(1.2, 1.6, 200.0)  # 2 m together
    assert prior_nll(problem_of(), x, evaluated(np.zeros(3)), model) == pytest.approx(  # type: ignore[arg-type]
        0.5 * (1.5**2 + 4.0 + 0.25 + 1.44 + 0.16)
    )


def test_without_an_altimeter_or_ground_they_say_nothing_and_an_exact_dem_is_exact():
    x = np.array([0.0, 0.0, 508.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    no_altimeter = problem_of(observation=SimpleNamespace(altitude_m=None, mast_height_m=2.0))
    assert len(prior_residuals(no_altimeter, x, evaluated(np.zeros(3)), 2.0)[0]) == 6  # type: ignore[arg-type]
    no_ground = evaluated(np.zeros(3), ground_m=np.nan)
    assert len(prior_residuals(problem_of(), x, no_ground, 2.0)[0]) == 6  # type: ignore[arg-type]
    exact = problem_of(terrain=SimpleNamespace(cell_m=30.0, exact=True))
    assert prior_residuals(exact, x, evaluated(np.zeros(3)), 2.0)[0][-2] == pytest.approx(6.0 / 4.0)  # type: ignore[arg-type]


# ---- columns


def test_columns_are_ordered_by_azimuth_with_steps_along_the_ground():
    """Steps of 0.01 rad at 1000 and 2000 m: 15 m across and 1000 m along; then 20 m across."""
    order = np.array([2, 0, 1])
    evaluation = evaluated(
        [1e-3, 2e-3, 3e-3],
        jacobian=np.arange(24.0).reshape(3, 8),
        slope=np.array([0.0, 2.0, 9.0]),
        error_distance_m=np.array([2000.0, 2000.0, 1000.0]),
        error_per_m=np.array([1.0, 2.0, 3.0]),
    )
    columns = ordered_columns(
        problem_of(order=order),
        np.zeros(8),
        evaluation,
        ErrorModel(1.2, 1.6, 200.0),
        np.array([1.0, 0.5, 0.0]),  # type: ignore[arg-type]
    )
    assert list(columns.residual) == [3e-3, 1e-3, 2e-3]
    assert list(columns.jacobian[:, 0]) == [16.0, 0.0, 8.0]
    # (1 + slope^2) / weight; slopes of 5 at most, weights of 1e-6 at least
    assert columns.white == pytest.approx(np.array([26.0e6, 1.0, 10.0]) * 1e-6)
    assert list(columns.per_m) == [3.0, 1.0, 2.0]
    assert columns.step_m[0] == np.inf
    assert columns.step_m[1:] == pytest.approx([np.hypot(15.0, 1000.0), 20.0])
    assert columns.cell_m == 30.0
    residual, jacobian = prior_residuals(problem_of(), np.zeros(8), evaluation, 2.0)  # type: ignore[arg-type]
    assert columns.prior_hessian == pytest.approx(jacobian.T @ jacobian, abs=1e-11)
    assert columns.prior_gradient == pytest.approx(jacobian.T @ residual)


def test_the_normalisation_is_that_of_the_covariance_without_weights():
    """Columns far apart: ln of sqrt(white + h^2 (rough^2 + smooth^2)) each, however large their residuals are."""
    evaluation = evaluated([0.5, -0.5, 0.0], error_distance_m=np.array([1.0, 1e9, 1.0]))
    total = 1e-6 + 1e-6 * (1.5**2 + 2.0**2)
    term = normalisation_term(problem_of(), np.zeros(8), evaluation, ErrorModel(1.5, 2.0, 200.0))  # type: ignore[arg-type]
    assert term == pytest.approx(1.5 * np.log(total), rel=1e-6)


def test_columns_that_all_are_informative_keep_their_likelihood(monkeypatch):
    monkeypatch.setattr(objective, "whitened_nll", lambda *_: pytest.fail("was computed again"))
    sigma = np.full(3, 1e-3)
    assert (
        visible_nll(problem_of(), np.zeros(8), evaluated(np.zeros(3)), ErrorModel(1, 1, 200), sigma, 7.0)
        == 7.0
    )  # type: ignore[arg-type]


# ---- weights and losses


@pytest.mark.parametrize(
    ("sigmas", "loss", "weight"),
    [(0.0, 0.0, 1.0), (4.0, 4.0, 0.25), (-4.0, 4.0, 0.25), (12.0, 7.2, 0.01), (1e6, 8.0, 0.0)],
)
def test_the_loss_and_the_weight_of_geman_and_mcclure_have_a_scale_of_4_sigma(sigmas, loss, weight):
    """0.5 u / (1 + u / 16) and 1 / (1 + u / 16)^2."""
    one = np.array([sigmas])
    assert geman_mcclure(one)[0] == pytest.approx(loss, abs=1e-6)
    assert weights(np.array([True]), one)[0] == pytest.approx(weight, abs=1e-9)
    assert weights(np.array([False]), one)[0] == 0.0


SIGMA = np.array([1e-3])


def near(residual_sigmas: float, excess_sigmas: float) -> Evaluation:
    return evaluated(
        [residual_sigmas * 1e-3], near=np.array([True]), near_excess=np.array([excess_sigmas * 1e-3])
    )


@pytest.mark.parametrize(
    ("residual_sigmas", "excess_sigmas", "informative"),
    [
        (0.0, 2.99, False),  # three sigma are not resolved
        (0.0, 3.01, True),
        (-2.99, 1.0, False),
        (-3.01, 1.0, True),
    ],
)
def test_near_terrain_is_resolved_beyond_three_sigma(residual_sigmas, excess_sigmas, informative):
    assert informative_columns(near(residual_sigmas, excess_sigmas), SIGMA)[0] == informative


@pytest.mark.parametrize(("sigmas", "visible"), [(3.82, True), (3.90, False)])
def test_the_horizon_is_occluded_where_an_unrelated_skyline_is_likelier(sigmas, visible):
    """ln(0.05236 / 1e-3) = 3.9581 for an unrelated one; 0.5 u / (1 + u / 16) is as much at u = 3.9581 / (0.5 - 3.9581 / 16)."""
    limit = np.sqrt(3.9581 / (0.5 - 3.9581 / 16.0))
    assert limit == pytest.approx(3.9587, abs=1e-3)
    at = sigmas + limit - 3.86
    assert visible_columns(near(at, 25.0), SIGMA)[0] == visible
    assert visible_columns(evaluated([at * 1e-3]), SIGMA)[0], "without near terrain nothing occludes"


def test_an_undetermined_column_refers_to_the_surface_that_fits_better():
    found = [visible_residual(near(at, 2.0), SIGMA)[0] / 1e-3 for at in (-1.0, 0.9, 1.1, 2.0)]
    assert found == pytest.approx([-1.0, 0.9, -0.9, 0.0])
    assert visible_residual(near(2.0, 5.0), SIGMA)[0] / 1e-3 == pytest.approx(2.0)


def test_an_occluded_column_costs_what_an_unrelated_skyline_would():
    assert column_nll(near(20.0, 25.0), SIGMA)[0] == pytest.approx(np.log(UNRELATED_RAD / 1e-3))
    assert column_nll(evaluated([4e-3]), SIGMA)[0] == pytest.approx(4.0)


def test_outliers_come_in_stretches_of_15_deg():
    """A column of 12 sigma costs 7.2; the sum of squares has 0.5 * 144 * 0.01 of it. 30 columns to a sector of 6 deg."""
    problem = problem_of(75, sector_columns=30)
    found = outlier_penalty(problem, evaluated(np.full(75, 12e-3)), np.full(75, 1e-3))  # type: ignore[arg-type]
    assert found == pytest.approx(7.2 - 0.72)
    assert outlier_penalty(problem, evaluated(np.zeros(75)), np.full(75, 1e-3)) == 0.0  # type: ignore[arg-type]


# ---- evidence


def evidence(
    residual_rad, sigma_rad=1e-3, white_rad=0.0, correlation=1.0, sector_columns=10, **changes
) -> float:
    residual = np.asarray(residual_rad, float)
    problem = problem_of(len(residual), sector_columns=sector_columns)
    return log_bayes_factor(
        problem,  # type: ignore[arg-type]
        evaluated(residual, **changes),
        np.full(len(residual), sigma_rad),
        np.full(len(residual), white_rad),
        correlation,
    )


def of_sector(sigma_rad: float, off: float) -> float:
    return float(np.log(0.9 * UNRELATED_RAD / sigma_rad * np.exp(-0.5 * off**2) + 0.1))


def test_a_sector_that_fits_exactly_counts_by_the_ratio_of_the_sigmas():
    assert evidence(np.zeros(10)) == pytest.approx(of_sector(1e-3, 0.0))
    assert evidence(np.zeros(5)) == pytest.approx(0.5 * of_sector(1e-3, 0.0)), "half a sector"


def test_a_sector_that_is_off_counts_by_its_median():
    assert evidence(np.full(10, -2e-3)) == pytest.approx(of_sector(1e-3, 2.0 / 0.6745))
    assert evidence(np.full(10, 1.0)) == pytest.approx(np.log(0.1)), "an outlier, at least"


def test_the_scatter_of_a_sector_counts_as_its_median_absolute_residual():
    assert evidence(np.tile([-2e-3, 2e-3], 5)) == pytest.approx(of_sector(1e-3, 2.0 / 0.6745))


@pytest.mark.parametrize(("correlation", "effective"), [(1.0, 10.0), (5.0, 2.0), (0.5, 10.0), (100.0, 1.0)])
def test_the_contour_s_noise_averages_out_over_independent_columns_and_no_other(correlation, effective):
    """Half of the variance is the contour's: of that pi / 2 / n stays, all of it if n is smaller than pi / 2."""
    white = np.sqrt(0.5) * 1e-3
    shared = np.sqrt(0.5 + 0.5 * min(1.0, np.pi / 2.0 / effective))
    found = evidence(np.full(10, 1e-3), white_rad=white, correlation=correlation)
    assert found == pytest.approx(of_sector(1e-3 * shared, max(1.0 / shared, 1.0 / 0.6745)))


def test_columns_that_are_not_informative_do_not_count():
    edge = np.arange(10) >= 4
    assert evidence(np.where(edge, 9.0, 0.0), dem_edge=edge) == pytest.approx(0.4 * of_sector(1e-3, 0.0))
    assert evidence(np.zeros(10), dem_edge=np.ones(10, bool)) == 0.0


@pytest.mark.parametrize(("prior_deg", "penalty"), [(2.99, 0.0), (3.01, np.log(3.01 / 0.05))])
def test_an_angle_is_free_if_it_is_known_no_better_than_an_unrelated_skyline(prior_deg, penalty):
    problem = problem_of(prior_sigma_deg=np.array([np.inf] * 3 + [180.0, prior_deg, 0.1, 0.1, 0.1]))
    assert occam_penalty(problem, 0.05**2 * np.eye(8)) == pytest.approx(penalty)  # type: ignore[arg-type]


def test_an_angle_that_the_fit_does_not_determine_costs_nothing():
    problem = problem_of(prior_sigma_deg=np.array([np.inf] * 4 + [10.0, 0.1, 0.1, 0.1]))
    assert occam_penalty(problem, 20.0**2 * np.eye(8)) == 0.0  # type: ignore[arg-type]


# ---- the contour's sigma


@dataclass(frozen=True)
class Lens:
    fx_px: float = 500.0
    fy_px: float = 500.0
    cx_px: float = 320.0
    cy_px: float = 240.0
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)


def test_a_pixel_subtends_less_away_from_the_axis():
    """In the middle 1 / f; 500 px aside, at 45 deg, the vertical is 1 / (f sqrt 2)."""
    frame = FrameObservation(
        "N",
        Lens(),
        0.0,
        0.1,
        0.0,
        0.1,
        0.0,
        0.1,
        np.array([320.0, 820.0]),
        np.array([240.0, 240.0]),
        np.array([0.5, 2.0]),
    )
    contour: FrameContour = frame_contour(frame)
    assert contour.sigma_rad == pytest.approx([0.5 / 500.0, 2.0 / (500.0 * np.sqrt(2.0))], rel=1e-4)
