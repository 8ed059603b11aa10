"""Results of a fit, and evaluations of its columns, in numbers that a test chooses."""

import dataclasses

import numpy as np
from numpy.typing import ArrayLike

from localizer.search.fit.correlated_errors import ErrorModel
from localizer.search.fit.refine import Refined
from localizer.search.fit.residuals import Evaluation


def refined(row: float, col: float = 50.0, **changes: object) -> Refined:
    """A place that explains what is seen, with ``changes``."""
    good = Refined(
        row=row,
        col=col,
        altitude_m=800.0,
        azimuth_bias_deg=0.0,
        azimuth_bias_sigma_deg=0.1,
        tilt_bias_deg=0.0,
        frame_errors_deg=np.zeros((4, 3)),
        covariance_enu_m2=np.eye(2),
        neg_log_posterior=0.0,
        dem_error_m=1.0,
        correlation_columns=2.0,
        inlier_share=0.98,
        prior_chi2=4.0,
        residual_px={"N": 0.5},
        mean_column_nll=0.0,
        evidence=90.0,
        error_model=ErrorModel(0.1, 0.5, 240.0),
    )
    return dataclasses.replace(good, **changes)


def evaluated_columns(residual_rad: ArrayLike, distance_m: float = 1000.0, **changes: object) -> Evaluation:
    """Columns with these residuals, all of terrain at one distance, with ``changes``."""
    residual = np.asarray(residual_rad, float)
    one = np.ones(len(residual))
    level = Evaluation(
        residual=residual,
        jacobian=np.zeros((len(one), 8)),
        distance=distance_m * one,
        near=np.zeros(len(one), bool),
        near_excess=0.0 * one,
        dem_edge=np.zeros(len(one), bool),
        guess_m=distance_m * one,
        slope=0.0 * one,
        error_per_m=one / distance_m,
        error_distance_m=distance_m * one,
        ground_m=0.0,
        ground_gradient=np.zeros(2),
        ground_sigma_m=0.1,
    )
    return dataclasses.replace(level, **changes)
