"""Informative, occluded and undetermined columns, outliers and evidence."""

from types import SimpleNamespace

import numpy as np
import pytest
from fits import evaluated_columns

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
    return evaluated_columns(
        residual_rad,
        near=np.full(len(one), near),
        near_excess=above_rad * one,
        dem_edge=np.full(len(one), dem_edge),
    )


def is_informative(evaluation: Evaluation) -> bool:
    return bool(informative_columns(evaluation, np.array([SIGMA_RAD]))[0])


def nll_of(evaluation: Evaluation) -> float:
    return float(column_nll(evaluation, np.array([SIGMA_RAD]))[0])


@pytest.mark.parametrize("sigmas", [-30.0, -1.0, 0.0, 1.0, 30.0])
def test_a_column_without_near_terrain_is_informative_for_any_residual(sigmas):
    assert is_informative(column(sigmas * SIGMA_RAD, near=False))


def test_near_terrain_occludes_the_horizon_where_something_higher_is_seen():
    assert not is_informative(column(20.0 * SIGMA_RAD, near=True, above_rad=25.0 * SIGMA_RAD))


def test_near_terrain_does_not_lower_the_horizon():
    assert is_informative(column(-20.0 * SIGMA_RAD, near=True, above_rad=25.0 * SIGMA_RAD))
    assert is_informative(column(-20.0 * SIGMA_RAD, near=True, above_rad=0.5 * SIGMA_RAD))


def test_a_column_that_fits_the_horizon_is_informative_despite_much_higher_near_terrain():
    assert is_informative(column(0.5 * SIGMA_RAD, near=True, above_rad=25.0 * SIGMA_RAD))


@pytest.mark.parametrize("sigmas", [-2.0, -0.5, 0.5, 2.0])
def test_a_column_is_undetermined_if_near_terrain_is_hardly_higher_than_the_horizon(sigmas):
    """Otherwise the lower half of the noise would be selected."""
    assert not is_informative(column(sigmas * SIGMA_RAD, near=True, above_rad=SIGMA_RAD))


def test_an_undetermined_column_has_the_likelihood_of_the_surface_that_fits_better():
    assert nll_of(column(-1.5 * SIGMA_RAD, near=True, above_rad=SIGMA_RAD)) == pytest.approx(
        nll_of(column(-1.5 * SIGMA_RAD, near=False))
    )
    assert nll_of(column(2.5 * SIGMA_RAD, near=True, above_rad=SIGMA_RAD)) == pytest.approx(
        nll_of(column(1.5 * SIGMA_RAD, near=False))
    )


def test_the_likelihood_of_an_occluded_column_does_not_depend_on_the_occluders_height():
    low, high = (column(s * SIGMA_RAD, near=True, above_rad=25.0 * SIGMA_RAD) for s in (20.0, 40.0))
    assert nll_of(low) == nll_of(high) > 0.0


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


def test_correlated_residuals_of_whole_sectors_give_no_evidence():
    apart = np.repeat(noise((BLOCKS, 1)), IN_EACH, axis=1)
    assert evidence(apart, NOISE_RAD, float(IN_EACH)) > 20.0, (
        "as far as neighbours are known to share their noise"
    )
    assert evidence(apart + noise((BLOCKS, IN_EACH)), NOISE_RAD, 1.0) < 0.0


def test_a_column_at_the_dem_edge_is_not_informative_and_costs_at_most_what_an_occluded_one_does():
    sigma = np.array([SIGMA_RAD])
    hidden = column_nll(columns(0.5 * np.ones(1), near=True), sigma)
    for off, costs in ((-20.0, hidden), (0.0, 0.0), (20.0, hidden)):
        evaluation = columns(off * sigma, dem_edge=True)
        assert not informative_columns(evaluation, sigma)[0]
        assert column_nll(evaluation, sigma) == pytest.approx(costs)


def test_undetermined_columns_do_not_favour_a_place():
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

    def total_nll_of(evaluation: Evaluation) -> float:
        sigma, x = problem.sigma_rad, np.zeros(8)
        informative = weights(informative_columns(evaluation, sigma), evaluation.residual / sigma)
        informative_nll = whitened_nll(ordered_columns(problem, x, evaluation, model, informative), model)  # type: ignore[arg-type]
        return visible_nll(problem, x, evaluation, model, sigma, informative_nll)  # type: ignore[arg-type]

    far, undetermined = (columns(seen, near, above_rad=SIGMA_RAD) for near in (False, True))
    far.ground_m = undetermined.ground_m = np.nan
    assert not informative_columns(undetermined, problem.sigma_rad).any()
    assert total_nll_of(undetermined) == pytest.approx(total_nll_of(far), rel=0.02)
    assert total_nll_of(far) > 0.2 * n


def occam_of(*, azimuth_bias_deg: float = 1.0, tilt_bias_deg: float = 0.05, frame_deg: float = 0.1) -> float:
    """With four frames, every angle found to 0.05 deg."""
    prior_deg = np.array([np.inf, np.inf, np.inf, azimuth_bias_deg, tilt_bias_deg, *[frame_deg] * 12])
    return occam_penalty(SimpleNamespace(prior_sigma_deg=prior_deg), 0.05**2 * np.eye(len(prior_deg)))  # type: ignore[arg-type]


def test_the_occam_factor_counts_free_angles_and_not_measured_ones():
    assert occam_of() == occam_of(azimuth_bias_deg=180.0) == 0.0
    assert occam_of(frame_deg=180.0) == pytest.approx(12.0 * np.log(180.0 / 0.05))
    assert occam_of(tilt_bias_deg=180.0) == pytest.approx(np.log(180.0 / 0.05))
