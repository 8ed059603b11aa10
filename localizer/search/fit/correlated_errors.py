"""What makes the terrain's skyline differ from the one in the pictures, and how that is correlated along the ridges.

A column's residual is the sum of three errors. The contour's own is independent from column to column. The other two are the
DEM's: s metres seen from a distance of d metres are s / d radians. What the terrain does between the cells is forgotten in a
cell (an Ornstein-Uhlenbeck process along the ground); what is wrong with the cells themselves goes on smoothly for many of them
(a Matern process of smoothness 3/2). So a near ridge, which fills many columns with the same few cells, counts for little. Such
processes plus white noise are whitened exactly by a Kalman filter of three states (Hartikainen and Särkkä, 2010).

Where the DEM errs, so does the place where one ridge disappears behind another: for some columns the horizon is another ridge
than the predicted one. Hence a column may be astray, at a price.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from localizer.jit import kernel

Floats = NDArray[np.float64]

SIZE_STEP = 1.6
LENGTH_STEP = 2.0
"""Neighbouring models differ by these factors."""
LENGTH_RANGE_CELLS = (2.0, 64.0)
MOST_MODELS = 60
OUTLIER_NLL = 6.0
"""What it costs (in logarithms of probability) that a column is astray."""
NEGLIGIBLE_SHARE = 1e-3
"""Models less likely than the best one by this factor are left out of the average."""
_NEIGHBOUR_STEPS = (
    *((-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0), (0, 0, -1), (0, 0, 1)),
    *((0, 1, 1), (0, -1, -1), (-1, 1, 0), (1, -1, 0)),
)


@dataclass(frozen=True)
class ErrorModel:
    """The DEM's error.

    Attributes:
        rough_m: standard deviation of what lies between the cells.
        smooth_m: standard deviation of what is wrong with the cells.
        length_m: how far the latter is correlated along the ground.
    """

    rough_m: float
    smooth_m: float
    length_m: float

    @property
    def size_m(self) -> float:
        """Standard deviation of both together."""
        return float(np.hypot(self.rough_m, self.smooth_m))


@dataclass(frozen=True)
class ModelRange:
    """What error models are thought of for a DEM of a certain cell size."""

    cell_m: float
    least_rough_m: float
    least_smooth_m: float
    largest_m: float

    def contains(self, model: ErrorModel) -> bool:
        """Whether a model lies in the range."""
        shortest, longest = LENGTH_RANGE_CELLS
        return (
            self.least_rough_m <= model.rough_m <= self.largest_m
            and self.least_smooth_m <= model.smooth_m <= self.largest_m
            and shortest <= model.length_m / self.cell_m <= longest
        )


@dataclass(frozen=True)
class Columns:
    """What is known of n columns in the order of their azimuths, and of p parameters.

    Attributes:
        residual: (n,) radians.
        jacobian: (n, p) its derivatives.
        white: (n,) variances of what is independent in each column.
        per_m: (n,) radians per metre of the DEM's error.
        step_m: (n,) way along the ground from the column before; infinite where there is none.
        cell_m: how far the rough part of the DEM's error reaches.
        prior: (p, p) curvature of the negative logarithm of the parameters' prior.
        pull: (p,) its slope.
    """

    residual: Floats
    jacobian: Floats
    white: Floats
    per_m: Floats
    step_m: Floats
    cell_m: float
    prior_hessian: Floats
    prior_gradient: Floats


@dataclass(frozen=True)
class NormalEquations:
    """The parameters' posterior under one model: curvature (p, p), slope (p,), and the cost of where they are.

    ``log_evidence``: logarithm of the likelihood with the parameters integrated out, but for a constant.
    """

    hessian: Floats
    gradient: Floats
    nll: float
    log_evidence: float


def normal_equations(columns: Columns, model: ErrorModel, *, robust: bool = True) -> NormalEquations:
    """Generalised least squares; the cost is as ``whitened_cost``, priors left out."""
    both = np.column_stack([columns.jacobian, columns.residual])
    half_log_determinant, outlier_nll = _whitened(both, columns, model, robust)
    product = both.T @ both
    hessian = product[:-1, :-1] + columns.prior_hessian
    gradient = product[:-1, -1] + columns.prior_gradient
    nll = 0.5 * float(product[-1, -1]) + outlier_nll
    sign, log_determinant = np.linalg.slogdet(hessian)
    gain = 0.5 * float(gradient @ np.linalg.solve(hessian, gradient)) if sign > 0 else -np.inf
    return NormalEquations(
        hessian, gradient, nll, gain - nll - half_log_determinant - 0.5 * float(log_determinant)
    )


def whitened_nll(columns: Columns, model: ErrorModel, *, robust: bool = True) -> float:
    """Half the sum of the squares of the whitened residuals, and the price of those astray.

    Unless ``forgiving``, none are: while a fit is still on its way, what looks astray is what shows the way.
    """
    residual = columns.residual[:, None].copy()
    _, outlier_nll = _whitened(residual, columns, model, robust)
    return 0.5 * float((residual**2).sum()) + outlier_nll


def half_log_determinant(columns: Columns, model: ErrorModel) -> float:
    """Half the logarithm of the determinant of the residuals' covariance under a model."""
    return _whitened(np.zeros((len(columns.residual), 0)), columns, model, False)[0]


def likely_error_models(
    columns: Columns, start: ErrorModel, limits: ModelRange
) -> list[tuple[ErrorModel, NormalEquations]]:
    """The most likely model near ``start`` and those about it that are not negligible, the best first.

    Climbs on a grid of models, evenly spaced in the logarithms of the sizes and the length.
    """
    found: dict[tuple[int, ...], tuple[ErrorModel, NormalEquations] | None] = {}

    def evidence_of(at: tuple[int, ...]) -> float:
        if at not in found:
            model = ErrorModel(
                start.rough_m * SIZE_STEP ** at[0],
                start.smooth_m * SIZE_STEP ** at[1],
                start.length_m * LENGTH_STEP ** at[2],
            )
            inside = limits.contains(model) or not any(at)
            found[at] = (model, normal_equations(columns, model)) if inside else None
        entry = found[at]
        return entry[1].log_evidence if entry else -np.inf

    evaluation: tuple[int, ...] = (0, 0, 0)
    evidence_of(evaluation)
    while len(found) < MOST_MODELS:
        neighbours = [tuple(np.add(evaluation, step).tolist()) for step in _NEIGHBOUR_STEPS]
        best = max(neighbours, key=evidence_of)
        if evidence_of(best) <= evidence_of(evaluation):
            break
        evaluation = best
    seen = [entry for entry in found.values() if entry]
    seen.sort(key=lambda entry: -entry[1].log_evidence)
    least = seen[0][1].log_evidence + np.log(NEGLIGIBLE_SHARE)
    return [entry for entry in seen if entry[1].log_evidence >= least]


def _whitened(values: Floats, columns: Columns, model: ErrorModel, robust: bool) -> tuple[float, float]:
    return _whiten(
        values,
        columns.white,
        columns.per_m,
        model.rough_m,
        model.smooth_m,
        columns.step_m / columns.cell_m,
        np.sqrt(3.0) * columns.step_m / model.length_m,
        robust,
    )


@kernel()
def _whiten(
    values: Floats,
    white: Floats,
    per_m: Floats,
    rough: float,
    smooth: float,
    rough_step: Floats,
    smooth_step: Floats,
    robust: bool,
) -> tuple[float, float]:
    """Turn each column of ``values`` (n, k) into innovations of unit variance.

    Returns half the logarithm of the determinant undone, and the price of what was taken for astray, which the last column of
    ``values``, the residuals, decides. States: the rough process; the smooth one; its derivative, scaled to unit variance. The
    steps are in correlation lengths.
    """
    n, k = values.shape
    state = np.zeros((3, k))
    p00, p11, p22, p01, p02, p12 = 1.0, 1.0, 1.0, 0.0, 0.0, 0.0
    half_log_determinant, outlier_nll = 0.0, 0.0
    for i in range(n):
        if smooth_step[i] > 30.0:
            p00, p11, p22, p01, p02, p12 = 1.0, 1.0, 1.0, 0.0, 0.0, 0.0
            state[:] = 0.0
        else:
            decay = np.exp(-rough_step[i])
            x = smooth_step[i]
            e = np.exp(-x)
            f11, f12, f21, f22 = e * (1.0 + x), e * x, -e * x, e * (1.0 - x)
            p00 = decay * decay * p00 + 1.0 - decay * decay
            p01, p02 = decay * (f11 * p01 + f12 * p02), decay * (f21 * p01 + f22 * p02)
            a, b, c = (
                p11 - 1.0,
                p22 - 1.0,
                p12,
            )  # deviation from the stationary covariance, which the step preserves
            p11 = 1.0 + f11 * f11 * a + 2.0 * f11 * f12 * c + f12 * f12 * b
            p22 = 1.0 + f21 * f21 * a + 2.0 * f21 * f22 * c + f22 * f22 * b
            p12 = f11 * f21 * a + (f11 * f22 + f12 * f21) * c + f12 * f22 * b
            for j in range(k):
                state[0, j] *= decay
                s1, s2 = state[1, j], state[2, j]
                state[1, j] = f11 * s1 + f12 * s2
                state[2, j] = f21 * s1 + f22 * s2
        h0, h1 = rough * per_m[i], smooth * per_m[i]
        c0, c1, c2 = h0 * p00 + h1 * p01, h0 * p01 + h1 * p11, h0 * p02 + h1 * p12
        total = h0 * c0 + h1 * c1 + white[i]
        if robust:
            innovation = values[i, k - 1] - h0 * state[0, k - 1] - h1 * state[1, k - 1]
            if 0.5 * innovation * innovation / total > OUTLIER_NLL:
                values[i, :] = 0.0
                outlier_nll += OUTLIER_NLL
                half_log_determinant += 0.5 * np.log(total)
                continue
        g0, g1, g2 = c0 / total, c1 / total, c2 / total
        p00 -= g0 * c0
        p01 -= g0 * c1
        p02 -= g0 * c2
        p11 -= g1 * c1
        p12 -= g1 * c2
        p22 -= g2 * c2
        scale = 1.0 / np.sqrt(total)
        half_log_determinant += 0.5 * np.log(total)
        for j in range(k):
            innovation = values[i, j] - h0 * state[0, j] - h1 * state[1, j]
            state[0, j] += g0 * innovation
            state[1, j] += g1 * innovation
            state[2, j] += g2 * innovation
            values[i, j] = innovation * scale
    return half_log_determinant, outlier_nll
