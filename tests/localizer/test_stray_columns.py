"""Which columns speak for or against a place where something stands near."""

import numpy as np
import pytest

from localizer.search.residuals import Evaluation
from localizer.search.stray import surprise, telling_columns

SIGMA_RAD = 1e-3


def column(residual_rad: float, near: bool, above_rad: float = 0.0) -> Evaluation:
    one = np.ones(1)
    return Evaluation(
        residual=np.array([residual_rad]),
        jacobian=np.zeros((1, 8)),
        distance=1000.0 * one,
        near=np.array([near]),
        above=np.array([above_rad]),
        guess_m=1000.0 * one,
        slope=np.zeros(1),
        dem_error_share=one,
        ground_m=0.0,
        ground_gradient=np.zeros(2),
        ground_sigma_m=0.1,
    )


def tells(here: Evaluation) -> bool:
    return bool(telling_columns(here, np.array([SIGMA_RAD]))[0])


def cost(here: Evaluation) -> float:
    return float(surprise(here, np.array([SIGMA_RAD]))[0])


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


def test_an_undecided_column_costs_what_a_telling_one_would():
    assert cost(column(1.5 * SIGMA_RAD, near=True, above_rad=SIGMA_RAD)) == pytest.approx(
        cost(column(1.5 * SIGMA_RAD, near=False))
    )


def test_a_hidden_column_costs_the_same_however_high_what_hides_it_is():
    low, high = (column(s * SIGMA_RAD, near=True, above_rad=25.0 * SIGMA_RAD) for s in (20.0, 40.0))
    assert cost(low) == cost(high) > 0.0
