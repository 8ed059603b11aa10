"""How the covariance of a fit is put together: over error models, and what the linearised problem does not see."""

from types import SimpleNamespace

import numpy as np
import pytest

from localizer.search.fit.correlated_errors import ErrorModel, NormalEquations
from localizer.search.fit.refine import _averaged_covariance, _shift_sigma_m

MODEL = ErrorModel(1.0, 2.0, 240.0)


def problem_of(*, exact: bool = False, cell_m: float = 30.0) -> SimpleNamespace:
    return SimpleNamespace(terrain=SimpleNamespace(exact=exact, cell_m=cell_m))


@pytest.mark.parametrize(
    ("smooth_m", "cell_m", "sigma_m"),
    [(0.0, 30.0, 0.45), (0.6, 30.0, 0.75), (4.0, 200.0, 5.0)],  # 0.015 of a cell, and a metre for each metre
)
def test_a_place_shifts_with_the_smooth_error_and_the_surface_between_the_cells(smooth_m, cell_m, sigma_m):
    model = ErrorModel(9.0, smooth_m, 240.0)
    assert _shift_sigma_m(problem_of(cell_m=cell_m), model) == pytest.approx(sigma_m)  # type: ignore[arg-type]
    assert _shift_sigma_m(problem_of(exact=True), model) == 0.0  # type: ignore[arg-type]


def equations(hessian, gradient, log_evidence: float) -> tuple[ErrorModel, NormalEquations]:
    return MODEL, NormalEquations(np.array(hessian), np.array(gradient), 0.0, log_evidence)


def test_one_error_model_gives_the_inverse_hessian():
    hessian = np.array([[4.0, 1.0], [1.0, 2.0]])
    found = _averaged_covariance([equations(hessian, [1.0, -1.0], 5.0)])
    assert found == pytest.approx(np.array([[2.0, -1.0], [-1.0, 4.0]]) / 7.0)


def test_several_are_averaged_by_their_evidence_with_the_spread_of_their_optima():
    """Variances of 1 and 4 with shares of 3/4 and 1/4; the optima lie at -2 and +4 from here, whose mean is -0.5."""
    found = _averaged_covariance([equations([[1.0]], [2.0], np.log(3.0)), equations([[0.25]], [-1.0], 0.0)])
    within = 0.75 * 1.0 + 0.25 * 4.0
    between = 0.75 * 1.5**2 + 0.25 * 4.5**2
    assert found == pytest.approx(np.array([[within + between]]))
