"""Which columns speak for or against a place where something stands near."""

from types import SimpleNamespace

import numpy as np
import pytest

from localizer.search.fit.correlated_errors import ErrorModel, whitened_nll
from localizer.search.fit.objective import ordered_columns, visible_nll
from localizer.search.fit.outliers import (
    column_nll,
    informative_columns,
    log_bayes_factor,
    occam_penalty,
    weights,
)
from localizer.search.fit.residuals import Evaluation

SIGMA_RAD = 1e-3


def column(residual_rad: float, near: bool, above_rad: float = 0.0) -> Evaluation:
    return columns(np.array([residual_rad]), near, above_rad)


def columns(
    residual_rad: np.ndarray, near: bool = False, above_rad: float = 0.0, dem_edge: bool = False
) -> Evaluation:
    one = np.ones(len(residual_rad))
    return Evaluation(
        residual=residual_rad,
        jacobian=np.zeros((len(one), 8)),
        distance=1000.0 * one,
        near=np.full(len(one), near),
        near_excess=above_rad * one,
        dem_edge=np.full(len(one), dem_edge),
        guess_m=1000.0 * one,
        slope=0.0 * one,
        error_per_m=1e-3 * one,
        error_distance_m=1000.0 * one,
        ground_m=0.0,
        ground_gradient=np.zeros(2),
        ground_sigma_m=0.1,
    )


def tells(evaluation: Evaluation) -> bool:
    return bool(informative_columns(evaluation, np.array([SIGMA_RAD]))[0])


def cost(evaluation: Evaluation) -> float:
    return float(column_nll(evaluation, np.array([SIGMA_RAD]))[0])


@pytest.mark.parametrize("sigmas", [-30.0, -1.0, 0.0, 1.0, 30.0])
def test_a_column_with_nothing_near_tells_whatever_it_shows(sigmas):
    assert tells(column(sigmas * SIGMA_RAD, near=False))


def test_what_stands_near_hides_the_horizon_where_something_higher_is_seen():
    assert not tells(column(20.0 * SIGMA_RAD, near=True, above_rad=25.0 * SIGMA_RAD))


def test_what_stands_near_does_not_lower_the_horizon():
    assert tells(column(-20.0 * SIGMA_RAD, near=True, above_rad=25.0 * SIGMA_RAD))
    assert tells(column(-20.0 * SIGMA_RAD, near=True, above_rad=0.5 * SIGMA_RAD))


def test_the_horizon_seen_where_the_dem_has_something_much_nearer_and_higher_tells():
    assert tells(column(0.5 * SIGMA_RAD, near=True, above_rad=25.0 * SIGMA_RAD))


@pytest.mark.parametrize("sigmas", [-2.0, -0.5, 0.5, 2.0])
def test_what_stands_near_and_hardly_higher_leaves_open_what_is_seen(sigmas):
    """Else the low half of the noise would be taken and the high half not."""
    assert not tells(column(sigmas * SIGMA_RAD, near=True, above_rad=SIGMA_RAD))


def test_an_undecided_column_costs_what_a_telling_one_would_of_what_it_fits_better():
    assert cost(column(-1.5 * SIGMA_RAD, near=True, above_rad=SIGMA_RAD)) == pytest.approx(
        cost(column(-1.5 * SIGMA_RAD, near=False))
    )
    assert cost(column(2.5 * SIGMA_RAD, near=True, above_rad=SIGMA_RAD)) == pytest.approx(
        cost(column(1.5 * SIGMA_RAD, near=False))
    )


def test_a_hidden_column_costs_the_same_however_high_what_hides_it_is():
    low, high = (column(s * SIGMA_RAD, near=True, above_rad=25.0 * SIGMA_RAD) for s in (20.0, 40.0))
    assert cost(low) == cost(high) > 0.0


BLOCKS, IN_EACH = 44, 46
NOISE_RAD = np.radians(0.7)


def evidence(residual_rad: np.ndarray, white_rad: float, correlation_columns: float) -> float:
    """Of blocks (n, k) whose columns are uncertain by NOISE_RAD, ``white_rad`` of it from the contour."""
    n, k = residual_rad.shape
    problem = SimpleNamespace(sectors=np.split(np.arange(n * k), n), sector_columns=k)
    sigma, white = np.full(n * k, NOISE_RAD), np.full(n * k, white_rad)
    return log_bayes_factor(problem, columns(residual_rad.ravel()), sigma, white, correlation_columns)  # type: ignore[arg-type]


def noise(shape: tuple[int, ...], size_rad: float = NOISE_RAD) -> np.ndarray:
    return np.random.default_rng(1).normal(0.0, size_rad, shape)


def test_noise_that_differs_from_column_to_column_averages_out_of_the_evidence():
    seen = noise((BLOCKS, IN_EACH))
    by_columns = evidence(seen, NOISE_RAD, 1.0)
    assert by_columns > 2.0 * evidence(seen, 0.0, 1.0), "the DEM's error does not average out"
    assert by_columns > 2.0 * evidence(seen, NOISE_RAD, float(IN_EACH)), "nor does what neighbours share"


def test_stretches_that_are_off_together_by_one_columns_noise_speak_for_no_place():
    apart = np.repeat(noise((BLOCKS, 1)), IN_EACH, axis=1)
    assert evidence(apart, NOISE_RAD, float(IN_EACH)) > 20.0, (
        "as far as neighbours are known to share their noise"
    )
    assert evidence(apart + noise((BLOCKS, IN_EACH)), NOISE_RAD, 1.0) < 0.0


def test_a_horizon_where_the_dem_ends_tells_nothing_and_costs_at_most_what_any_other_stretch_would():
    sigma = np.array([SIGMA_RAD])
    hidden = column_nll(columns(0.5 * np.ones(1), near=True), sigma)
    for off, costs in ((-20.0, hidden), (0.0, 0.0), (20.0, hidden)):
        evaluation = columns(off * sigma, dem_edge=True)
        assert not informative_columns(evaluation, sigma)[0]
        assert column_nll(evaluation, sigma) == pytest.approx(costs)


def test_a_place_gains_nothing_by_leaving_columns_undecided():
    low = -np.abs(noise((400,), SIGMA_RAD))  # so none shows what stands near
    seen = np.maximum(low, -2.5 * SIGMA_RAD)
    n, model = len(seen), ErrorModel(0.1, 0.05, 240.0)
    problem = SimpleNamespace(
        order=np.arange(n),
        step_rad=np.full(n, 1e-3),
        sigma_rad=np.full(n, SIGMA_RAD),
        terrain=SimpleNamespace(cell_m=30.0),
        prior_sigma_deg=np.full(8, np.inf),
        observation=SimpleNamespace(altitude_m=None, mast_height_m=2.0),
        size=8,
    )

    def cost_of(evaluation: Evaluation) -> float:
        sigma, x = problem.sigma_rad, np.zeros(8)
        informative = weights(informative_columns(evaluation, sigma), evaluation.residual / sigma)
        told = whitened_nll(ordered_columns(problem, x, evaluation, model, informative), model)  # type: ignore[arg-type]
        return visible_nll(problem, x, evaluation, model, sigma, told)  # type: ignore[arg-type]

    far, undecided = (columns(seen, near, above_rad=SIGMA_RAD) for near in (False, True))
    far.ground_m = undecided.ground_m = np.nan
    assert not informative_columns(undecided, problem.sigma_rad).any()
    assert cost_of(undecided) == pytest.approx(cost_of(far), rel=0.02)
    assert cost_of(far) > 0.2 * n


def used_up(*, azimuth_bias_deg: float = 1.0, tilt_bias_deg: float = 0.05, frame_deg: float = 0.1) -> float:
    """With four frames, every angle found to 0.05 deg."""
    prior_deg = np.array([np.inf, np.inf, np.inf, azimuth_bias_deg, tilt_bias_deg, *[frame_deg] * 12])
    return occam_penalty(SimpleNamespace(prior_sigma_deg=prior_deg), 0.05**2 * np.eye(len(prior_deg)))  # type: ignore[arg-type]


def test_angles_that_sensors_give_use_up_no_evidence_and_open_ones_do():
    assert used_up() == used_up(azimuth_bias_deg=180.0) == 0.0
    assert used_up(frame_deg=180.0) == pytest.approx(12.0 * np.log(180.0 / 0.05))
    assert used_up(tilt_bias_deg=180.0) == pytest.approx(np.log(180.0 / 0.05))
