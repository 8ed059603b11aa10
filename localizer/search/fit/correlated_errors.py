"""Correlated errors of the DEM: Ornstein-Uhlenbeck and Matérn 3/2 processes in state-space form, whitened by a Kalman filter.

The residual of a column is the sum of three errors:

    r = w + h (rough(l) + smooth(l)),    h: radians per metre of DEM error, about 1 / distance.

w is the contour's noise, independent in each column. ``rough`` and ``smooth`` are errors of the DEM along the ground, l metres
along the ridge. With the step t between two columns, their autocorrelations are

    rough:   exp(-t / cell)                         Ornstein-Uhlenbeck: what lies between the cells
    smooth:  (1 + a) exp(-a),  a = sqrt(3) t / L    Matérn 3/2: errors of the cells themselves, correlation length L

Such processes plus white noise form a linear Gaussian state-space model with three states (Hartikainen and Särkkä, 2010).
A Kalman filter along the azimuth turns the residuals into independent innovations of unit variance in linear time. A near ridge
fills many columns with the same few cells; its residuals are highly correlated and count for few samples.

An error of the DEM can also make another ridge the horizon than the predicted one. A column whose innovation is too large is
therefore treated as an outlier, with the constant negative log-likelihood OUTLIER_NLL.

The parameters of the model are found by maximum marginal likelihood: the unknowns of the fit are integrated out (integrated
likelihood), so that models with different parameters can be compared.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from localizer.jit import kernel

Floats = NDArray[np.float64]

SIZE_STEP = 1.6
"""Factor between neighbouring standard deviations of the grid of models."""
LENGTH_STEP = 2.0
"""Factor between neighbouring correlation lengths of the grid of models."""
LENGTH_RANGE_CELLS = (2.0, 64.0)
"""Range of the correlation length of the smooth error."""
MOST_MODELS = 60
"""Models evaluated at most."""
OUTLIER_NLL = 6.0
"""Negative log-likelihood of an outlier column. Tuned on the scenario ``dem_error``. Sensitivity: halved, places move by 0.3
sigma, sigmas change by the factor 1.3; doubled, places move by 0.1 sigma (docs/sensitivity.md)."""
NEGLIGIBLE_SHARE = 1e-3
"""Models whose likelihood is a smaller share of the best one's are left out of the average. Tuned on the scenario
``dem_error``. Sensitivity: not measured yet (``sim sensitivity``)."""
_NEIGHBOUR_STEPS = (
    *((-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0), (0, 0, -1), (0, 0, 1)),
    *((0, 1, 1), (0, -1, -1), (-1, 1, 0), (1, -1, 0)),
)


@dataclass(frozen=True)
class ErrorModel:
    """Covariance model of the DEM's error.

    Attributes:
        rough_m: standard deviation of the rough part.
        smooth_m: standard deviation of the smooth part.
        length_m: correlation length of the smooth part along the ground.
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
    """Admissible error models for a DEM."""

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
    """The linearised problem: n columns ordered by azimuth, p parameters.

    Attributes:
        residual: (n,) radians.
        jacobian: (n, p) derivatives of the residuals.
        white: (n,) variances of the independent noise.
        per_m: (n,) radians per metre of DEM error.
        step_m: (n,) distance along the ground from the column before; infinite for the first.
        cell_m: correlation length of the rough error.
        prior_hessian: (p, p) of the negative log-prior.
        prior_gradient: (p,) of the negative log-prior.
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
    """Gauss-Newton approximation of the negative log-posterior under one model: ``hessian`` (p, p), ``gradient`` (p,).

    ``nll``: negative log-likelihood at the current parameters. ``log_evidence``: log marginal likelihood of the model, the
    parameters integrated out by Laplace approximation, up to a constant: 0.5 g' H^-1 g - nll - 0.5 ln det S - 0.5 ln det H,
    with the covariance S of the residuals.
    """

    hessian: Floats
    gradient: Floats
    nll: float
    log_evidence: float


def normal_equations(columns: Columns, model: ErrorModel, *, robust: bool = True) -> NormalEquations:
    """Generalised least squares: J' S^-1 J + prior, J' S^-1 r + prior; ``nll`` is as of ``whitened_nll``, without priors."""
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
    """Half the sum of the squared whitened residuals, plus OUTLIER_NLL for each outlier.

    Without ``robust`` no column is an outlier. Early iterations need that: far from the optimum, large residuals carry the
    information about the direction of descent.
    """
    residual = columns.residual[:, None].copy()
    _, outlier_nll = _whitened(residual, columns, model, robust)
    return 0.5 * float((residual**2).sum()) + outlier_nll


def half_log_determinant(columns: Columns, model: ErrorModel) -> float:
    """0.5 ln det of the covariance of the residuals under a model."""
    return _whitened(np.zeros((len(columns.residual), 0)), columns, model, False)[0]


def likely_error_models(
    columns: Columns, start: ErrorModel, limits: ModelRange
) -> list[tuple[ErrorModel, NormalEquations]]:
    """The model of maximum marginal likelihood near ``start``, and its neighbours that are not negligible, the best first.

    Hill climbing on a grid of models that is even in the logarithms of the parameters.
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

    current: tuple[int, ...] = (0, 0, 0)
    evidence_of(current)
    while len(found) < MOST_MODELS:
        neighbours = [tuple(np.add(current, step).tolist()) for step in _NEIGHBOUR_STEPS]
        best = max(neighbours, key=evidence_of)
        if evidence_of(best) <= evidence_of(current):
            break
        current = best
    evaluated = [entry for entry in found.values() if entry]
    evaluated.sort(key=lambda entry: -entry[1].log_evidence)
    least = evaluated[0][1].log_evidence + np.log(NEGLIGIBLE_SHARE)
    return [entry for entry in evaluated if entry[1].log_evidence >= least]


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
    """Kalman filter: replace each column of ``values`` (n, k) by its innovations, scaled to unit variance.

    States: the rough process; the smooth process; its derivative, scaled to unit variance. Transition of the smooth pair over a
    step a in correlation lengths: exp(-a) [[1 + a, a], [-a, 1 - a]]. The steps are in correlation lengths.

    Returns 0.5 ln det of the covariance, and the sum of OUTLIER_NLL. The last column of ``values``, the residuals, decides
    which rows are outliers; such a row is set to zero in all columns, and the states are not updated.
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
            )  # deviation from the stationary covariance, which the transition preserves
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
