"""The whitening filter against the covariance that it stands for, written out as a dense matrix."""

from dataclasses import replace

import numpy as np
import pytest

from localizer.search.fit.correlated_errors import (
    Columns,
    ErrorModel,
    ModelRange,
    half_log_determinant,
    likely_error_models,
    normal_equations,
    whitened_nll,
)

CELL_M = 30.0
COUNT, PARAMETERS = 40, 3
MODELS = [
    ErrorModel(3.0, 0.0, 200.0),
    ErrorModel(0.0, 4.0, 200.0),
    ErrorModel(3.0, 4.0, 200.0),
    ErrorModel(1.0, 6.0, 1500.0),
]


def dense_covariance(columns: Columns, model: ErrorModel) -> np.ndarray:
    """White noise; an exponential term with the cell as its length; a Matern term of order 3/2."""
    along_m = np.cumsum(np.where(np.isfinite(columns.step_m), columns.step_m, 0.0))
    apart_m = np.abs(along_m[:, None] - along_m)
    a = np.sqrt(3.0) * apart_m / model.length_m
    of_dem_m2 = model.rough_m**2 * np.exp(-apart_m / CELL_M) + model.smooth_m**2 * (1.0 + a) * np.exp(-a)
    return np.diag(columns.white) + np.outer(columns.per_m, columns.per_m) * of_dem_m2


def some_columns(count: int = COUNT, seed: int = 1) -> Columns:
    """Residuals of about a standard deviation of ``ErrorModel(3, 4, 200)``, at uneven steps and distances."""
    rng = np.random.default_rng(seed)
    prior = rng.normal(size=(PARAMETERS, PARAMETERS))
    columns = Columns(
        residual=np.zeros(count),
        jacobian=rng.normal(0.0, 1e-3, (count, PARAMETERS)),
        white=rng.uniform(0.5e-3, 2e-3, count) ** 2,
        per_m=1.0 / rng.uniform(800.0, 5000.0, count),
        step_m=np.concatenate([[np.inf], rng.uniform(2.0, 90.0, count - 1)]),
        cell_m=CELL_M,
        prior_hessian=prior @ prior.T,
        prior_gradient=rng.normal(size=PARAMETERS),
    )
    drawn = np.linalg.cholesky(dense_covariance(columns, ErrorModel(3.0, 4.0, 200.0))) @ rng.normal(
        size=count
    )
    return replace(columns, residual=drawn)


@pytest.mark.parametrize("model", MODELS)
def test_the_likelihood_is_that_of_the_dense_covariance(model):
    columns = some_columns()
    dense = dense_covariance(columns, model)
    assert half_log_determinant(columns, model) == pytest.approx(0.5 * np.linalg.slogdet(dense)[1], rel=1e-9)
    assert whitened_nll(columns, model, robust=False) == pytest.approx(
        0.5 * columns.residual @ np.linalg.solve(dense, columns.residual), rel=1e-9
    )


@pytest.mark.parametrize("model", MODELS)
def test_the_normal_equations_are_generalised_least_squares_with_the_priors(model):
    columns = some_columns()
    dense = dense_covariance(columns, model)
    found = normal_equations(columns, model, robust=False)
    hessian = columns.jacobian.T @ np.linalg.solve(dense, columns.jacobian) + columns.prior_hessian
    gradient = columns.jacobian.T @ np.linalg.solve(dense, columns.residual) + columns.prior_gradient
    assert found.hessian == pytest.approx(hessian, rel=1e-8)
    assert found.gradient == pytest.approx(gradient, rel=1e-8)
    assert found.nll == pytest.approx(
        0.5 * columns.residual @ np.linalg.solve(dense, columns.residual), rel=1e-9
    )


def test_the_evidence_of_a_model_is_its_marginal_likelihood():
    """With linear parameters of a Gaussian prior the residuals are Gaussian: their density is written out."""
    columns = replace(some_columns(), prior_gradient=np.zeros(PARAMETERS))

    def log_marginal(model: ErrorModel) -> float:
        prior_covariance = np.linalg.inv(columns.prior_hessian)
        dense = dense_covariance(columns, model) + columns.jacobian @ prior_covariance @ columns.jacobian.T
        return float(
            -0.5 * columns.residual @ np.linalg.solve(dense, columns.residual)
            - 0.5 * np.linalg.slogdet(dense)[1]
        )

    one, other = (normal_equations(columns, m, robust=False).log_evidence for m in MODELS[2:])
    assert one - other == pytest.approx(log_marginal(MODELS[2]) - log_marginal(MODELS[3]), abs=1e-6)


@pytest.mark.parametrize(("sigmas", "is_outlier"), [(3.46, False), (3.47, True)])  # 0.5 * 3.464^2 = 6
def test_a_column_whose_innovation_is_improbable_is_left_out_at_a_constant_price(sigmas, is_outlier):
    columns, model, at = some_columns(), MODELS[2], 17
    dense = dense_covariance(columns, model)
    before = np.arange(at)
    gain = np.linalg.solve(dense[np.ix_(before, before)], dense[before, at])
    expected = gain @ columns.residual[before]
    sigma = np.sqrt(dense[at, at] - gain @ dense[before, at])
    residual = columns.residual.copy()
    residual[at] = expected + sigmas * sigma
    # the columns after it are as they would be expected, so that they are no outliers whether it is one or not
    known = np.delete(np.arange(at + 1), at) if is_outlier else np.arange(at + 1)
    after = np.arange(at + 1, COUNT)
    residual[after] = dense[np.ix_(after, known)] @ np.linalg.solve(
        dense[np.ix_(known, known)], residual[known]
    )
    columns = replace(columns, residual=residual)
    used = np.delete(np.arange(COUNT), at) if is_outlier else np.arange(COUNT)
    of_used = 0.5 * residual[used] @ np.linalg.solve(dense[np.ix_(used, used)], residual[used])
    price = 6.0 if is_outlier else 0.0
    assert whitened_nll(columns, model) == pytest.approx(of_used + price, rel=1e-9)
    found = normal_equations(columns, model)
    assert found.nll == pytest.approx(of_used + price, rel=1e-9)
    jacobian = columns.jacobian[used]
    assert found.hessian - columns.prior_hessian == pytest.approx(
        jacobian.T @ np.linalg.solve(dense[np.ix_(used, used)], jacobian), rel=1e-8
    )
    assert whitened_nll(columns, model, robust=False) == pytest.approx(
        0.5 * residual @ np.linalg.solve(dense, residual), rel=1e-9
    )


def test_columns_on_either_side_of_a_wide_gap_share_no_error():
    columns, model = some_columns(), MODELS[2]
    step_m = columns.step_m.copy()
    step_m[20] = 1e6
    gap = replace(columns, step_m=step_m)
    parts = [
        replace(
            gap,
            residual=gap.residual[part],
            jacobian=gap.jacobian[part],
            white=gap.white[part],
            per_m=gap.per_m[part],
            step_m=np.concatenate([[np.inf], step_m[part][1:]]),
        )
        for part in (slice(0, 20), slice(20, None))
    ]
    assert whitened_nll(gap, model, robust=False) == pytest.approx(
        sum(whitened_nll(part, model, robust=False) for part in parts)
    )
    assert half_log_determinant(gap, model) == pytest.approx(
        sum(half_log_determinant(part, model) for part in parts)
    )


def test_both_parts_of_the_error_add_up():
    assert ErrorModel(3.0, 4.0, 200.0).size_m == pytest.approx(5.0)


LIMITS = ModelRange(cell_m=CELL_M, least_rough_m=0.1, least_smooth_m=0.05, largest_m=12.0)


@pytest.mark.parametrize(
    ("model", "inside"),
    [
        (ErrorModel(0.1, 0.05, 60.0), True),
        (ErrorModel(12.0, 12.0, 1920.0), True),  # 2 to 64 cells
        (ErrorModel(0.099, 1.0, 200.0), False),
        (ErrorModel(12.01, 1.0, 200.0), False),
        (ErrorModel(1.0, 0.049, 200.0), False),
        (ErrorModel(1.0, 12.01, 200.0), False),
        (ErrorModel(1.0, 1.0, 59.9), False),
        (ErrorModel(1.0, 1.0, 1921.0), False),
    ],
)
def test_a_model_lies_within_the_limits_of_each_of_its_parts(model, inside):
    assert LIMITS.contains(model) == inside


@pytest.mark.parametrize(
    ("truth", "size"), [(ErrorModel(4.0, 0.1, 240.0), "rough_m"), (ErrorModel(0.3, 4.0, 240.0), "smooth_m")]
)
def test_the_likeliest_model_is_the_one_that_the_residuals_were_drawn_from(truth, size):
    columns = some_columns(400)
    rng = np.random.default_rng(5)
    drawn = np.linalg.cholesky(dense_covariance(columns, truth)) @ rng.normal(size=400)
    models = likely_error_models(replace(columns, residual=drawn), ErrorModel(1.0, 1.0, 240.0), LIMITS)
    best = models[0][0]
    assert 3.0 < getattr(best, size) < 5.0
    assert best.size_m < 6.0
    evidence = [normal.log_evidence for _, normal in models]
    assert evidence == sorted(evidence, reverse=True)
    assert evidence[-1] >= evidence[0] + np.log(1e-3)
    assert all(LIMITS.contains(model) for model, _ in models)
