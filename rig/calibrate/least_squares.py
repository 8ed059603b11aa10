"""Least squares with the covariance of the solution."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

Vector = NDArray[np.float64]

TOLERANCE = 1e-7


@dataclass(frozen=True)
class Solved:
    """The unknowns (n,) and their covariance (n, n), for weighted misfits of unit variance."""

    unknowns: Vector
    covariance: Vector


def solve(
    misfit: Callable[[Vector], Vector], start: Vector, loss: Literal["linear", "soft_l1"] = "linear"
) -> Solved:
    """Minimum of the sum of (robustified) squares of ``misfit``, which is weighted by its sigmas."""
    solution = least_squares(
        misfit, start, x_scale="jac", method="trf", loss=loss, ftol=TOLERANCE, xtol=TOLERANCE
    )
    jacobian = np.asarray(solution.jac)
    return Solved(np.asarray(solution.x), np.asarray(np.linalg.inv(jacobian.T @ jacobian)))
