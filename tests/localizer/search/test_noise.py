"""The noise that is estimated from residuals of known noise: its size, its length, and what it is bounded by."""

from types import SimpleNamespace

import numpy as np
import pytest
from fits import evaluated_columns

from localizer.search.fit.correlated_errors import ErrorModel
from localizer.search.fit.noise import Noise, estimated_noise, initial_noise, possible_models
from localizer.search.fit.residuals import Evaluation

CELL_M = 30.0
DISTANCE_M = 3000.0
CONTOUR_RAD = 5e-5
NOMINAL_M, LARGEST_M = 3.0, 12.0
PRIOR = Noise(NOMINAL_M, 1.0, ErrorModel(NOMINAL_M, 0.05, 8.0 * CELL_M))


def problem_of(count: int, frames: int = 1, step_m: float = 20.0) -> SimpleNamespace:
    """Columns ``step_m`` apart on a ridge 3 km away."""
    step_rad = np.full(count, step_m / DISTANCE_M)
    step_rad[0] = np.inf
    return SimpleNamespace(
        order=np.arange(count),
        step_rad=step_rad,
        sigma_rad=np.full(count, CONTOUR_RAD),
        frame_of=np.repeat(np.arange(frames), count // frames),
        contours=[None] * frames,
        terrain=SimpleNamespace(cell_m=CELL_M, exact=False, mean_second_difference_m=2.0),
        nominal_error_m=NOMINAL_M,
        prior_sigma_deg=np.full(8, np.inf),
        observation=SimpleNamespace(altitude_m=None, mast_height_m=2.0),
        size=8,
    )


def evaluated(residual_rad: np.ndarray, **changes: object) -> Evaluation:
    return evaluated_columns(residual_rad, DISTANCE_M, **({"ground_m": np.nan} | changes))


def estimate(residual_rad: np.ndarray, *, by_likelihood: bool, largest_m: float = LARGEST_M, frames: int = 1):
    problem = problem_of(len(residual_rad), frames)
    return estimated_noise(
        problem,
        np.zeros(8),
        evaluated(residual_rad),
        PRIOR,
        largest_m,
        by_likelihood,  # type: ignore[arg-type]
    )


def drawn(sigma_m: float, count: int = 600, correlation: float = 0.0, seed: int = 1) -> np.ndarray:
    """Residuals by a DEM error of ``sigma_m`` (AR(1) from column to column) and the contour's noise."""
    rng = np.random.default_rng(seed)
    error = np.empty(count)
    error[0] = rng.normal()
    for i, shock in enumerate(rng.normal(size=count - 1), 1):
        error[i] = correlation * error[i - 1] + np.sqrt(1.0 - correlation**2) * shock
    return sigma_m * error / DISTANCE_M + rng.normal(0.0, CONTOUR_RAD, count)


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("by_likelihood", [False, True])
def test_residuals_of_4_m_are_estimated_as_4_m(by_likelihood, seed):
    """Columns are 20 m apart on the ridge and cells 30 m: what lies between the cells is correlated by exp(-20 / 30)."""
    noise = estimate(drawn(4.0, correlation=np.exp(-20.0 / 30.0), seed=seed), by_likelihood=by_likelihood)
    assert 3.0 < noise.robust_sigma_m < 5.0
    assert 3.0 < noise.model.rough_m < 5.0
    assert noise.model.smooth_m < 1.5


def test_the_size_is_not_raised_by_a_fifth_of_columns_that_show_something_else():
    residual = drawn(4.0)
    residual[100:220] += 0.2
    assert 3.0 < estimate(residual, by_likelihood=False).robust_sigma_m < 6.0


def test_errors_shared_by_many_columns_are_estimated_as_smooth():
    """exp(-20 / 480) from column to column: 16 cells."""
    noise = estimate(drawn(4.0, correlation=np.exp(-20.0 / 480.0), count=1200), by_likelihood=True)
    assert noise.model.smooth_m > 2.0 > noise.model.rough_m


def test_without_likelihood_all_of_the_error_counts_as_rough_over_8_cells():
    model = estimate(drawn(4.0, correlation=0.9), by_likelihood=False).model
    assert model.smooth_m == 0.05
    assert model.length_m == 240.0
    assert model.rough_m > 2.0


def test_the_size_is_the_one_whose_median_normalised_residual_is_that_of_a_gaussian():
    """Half the columns off by 1 mrad, half by 2: the median of 1.5 mrad is 0.6745 sigma at 3 km, less the contour's noise."""
    residual = np.tile([1e-3, -2e-3], 300)
    sigma_rad = 1.5e-3 / 0.6745
    expected_m = np.sqrt(sigma_rad**2 - CONTOUR_RAD**2) * DISTANCE_M
    assert estimate(residual, by_likelihood=False).robust_sigma_m == pytest.approx(expected_m, rel=1e-6)


@pytest.mark.parametrize(
    ("residual_rad", "largest_m", "expected_m"),
    [
        (0.0, 12.0, 0.1),
        (1e-4, 12.0, np.sqrt((1e-4 / 0.6745) ** 2 - CONTOUR_RAD**2) * DISTANCE_M),  # 0.42 m
        (1e-2, 12.0, 12.0),
        (1e-2, 5.0, 5.0),
    ],
)
def test_the_size_is_bounded(residual_rad, largest_m, expected_m):
    residual = np.tile([residual_rad, -residual_rad], 50)
    found = estimate(residual, by_likelihood=False, largest_m=largest_m).robust_sigma_m
    assert found == pytest.approx(expected_m, rel=1e-6)


def test_without_an_informative_column_the_size_is_the_largest():
    problem = problem_of(50)
    at_edge = evaluated(np.zeros(50), dem_edge=np.ones(50, bool))
    found = estimated_noise(problem, np.zeros(8), at_edge, PRIOR, LARGEST_M, False)  # type: ignore[arg-type]
    assert found.robust_sigma_m == LARGEST_M


def test_near_terrain_does_not_count_for_the_size():
    residual = np.concatenate([np.tile([1e-3, -1e-3], 100), np.full(150, 0.3)])
    occluded = np.arange(350) >= 200
    problem = problem_of(350)
    evaluation = evaluated(residual, near=occluded, near_excess=np.where(occluded, 0.5, 0.0))
    found = estimated_noise(problem, np.zeros(8), evaluation, PRIOR, LARGEST_M, False)  # type: ignore[arg-type]
    expected_m = np.sqrt((1e-3 / 0.6745) ** 2 - CONTOUR_RAD**2) * DISTANCE_M
    assert found.robust_sigma_m == pytest.approx(expected_m, rel=1e-6)


# ---- columns per effective sample


def columns_per_sample(correlation: float) -> float:
    """1 + 2 (r + r^2 + ...), up to the last term that is not below 0.05."""
    terms = correlation ** np.arange(1, 1000)
    return 1.0 + 2.0 * float(terms[terms >= 0.05].sum())


@pytest.mark.parametrize(
    ("correlation", "expected", "tolerance"),
    [(0.0, 1.0, 0.0), (0.5, 2.875, 0.15), (0.8, 8.56, 0.6)],  # 1 + 2 (0.5 + ... + 0.5^4); 1 + 8 (1 - 0.8^13)
)
def test_columns_per_sample_are_those_of_an_autoregressive_series(correlation, expected, tolerance):
    assert columns_per_sample(correlation) == pytest.approx(expected, abs=0.01)
    noise = estimate(drawn(4.0, 30_000, correlation), by_likelihood=False)
    assert noise.correlation_columns == pytest.approx(expected, abs=tolerance)


def test_the_ends_of_two_frames_are_no_neighbours():
    """Alternating signs within each of two frames, which join with the same sign."""
    frame = np.tile([1e-3, -1e-3], 3)
    assert (
        estimate(np.concatenate([frame, frame[::-1]]), by_likelihood=False, frames=2).correlation_columns
        == 1.0
    )


def test_one_residual_for_all_columns_is_correlated_over_a_third_of_the_frame():
    noise = estimate(np.full(30, 1e-3), by_likelihood=False)
    assert noise.correlation_columns == pytest.approx(1.0 + 2.0 * 9.0)  # lags 1 to 9 of 30 columns


def test_a_stretch_of_outliers_does_not_count_as_correlation():
    residual = drawn(4.0, count=3000)
    assert estimate(residual, by_likelihood=False).correlation_columns < 1.3
    residual[500:1100] += 0.2
    assert estimate(residual, by_likelihood=False).correlation_columns < 1.6


def test_the_longest_frame_says_how_far_columns_are_correlated():
    problem = problem_of(36, 2)
    problem.frame_of = np.repeat([0, 1], [30, 6])
    found = estimated_noise(problem, np.zeros(8), evaluated(np.full(36, 1e-3)), PRIOR, LARGEST_M, False)  # type: ignore[arg-type]
    assert found.correlation_columns == pytest.approx(1.0 + 2.0 * 9.0)


# ---- limits


def terrain(**fields: object) -> SimpleNamespace:
    return SimpleNamespace(**{"exact": False, "cell_m": CELL_M, "mean_second_difference_m": 20.0, **fields})


def test_what_lies_between_the_cells_is_never_known_better_than_a_share_of_their_second_difference():
    limits = possible_models(SimpleNamespace(terrain=terrain(), nominal_error_m=3.0), 12.0)  # type: ignore[arg-type]
    assert limits.least_rough_m == pytest.approx(0.15 * 0.1 * 20.0 + 0.01)
    assert (limits.least_smooth_m, limits.largest_m, limits.cell_m) == (0.05, 12.0, CELL_M)


def test_an_exact_dem_has_only_the_least_rough_error_and_none_is_above_the_usual_one():
    exact = possible_models(SimpleNamespace(terrain=terrain(exact=True), nominal_error_m=3.0), 12.0)  # type: ignore[arg-type]
    assert exact.least_rough_m == pytest.approx(0.01)
    small = possible_models(SimpleNamespace(terrain=terrain(), nominal_error_m=0.02), 12.0)  # type: ignore[arg-type]
    assert (small.least_rough_m, small.least_smooth_m) == (0.02, 0.02)


def test_the_first_noise_is_rough_and_the_columns_are_independent():
    noise = initial_noise(terrain(nominal_error_m=3.0), 6.0)  # type: ignore[arg-type]
    assert noise == Noise(6.0, 1.0, ErrorModel(6.0, 0.05, 240.0))
    assert initial_noise(terrain(nominal_error_m=0.02), 6.0).model.smooth_m == 0.02  # type: ignore[arg-type]
