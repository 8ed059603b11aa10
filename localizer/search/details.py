"""Results of the search beyond the fix: what plots, reports and tests need."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from localizer.fix import Fix

INCONSISTENT_BELOW = 0.4
"""A frame contradicts a place if less than this share of its columns fits. Tuned on rendered bundles with one frame misread;
not in docs/sensitivity.md, whose cases leave no frame out."""


@dataclass(frozen=True)
class FrameDetail:
    """One frame's skylines, in pixels of the frame as recorded (pixel centres at whole numbers)."""

    label: str
    """The frame's."""
    found_u_px: NDArray[np.float64]
    """(n,) columns in which a skyline was found in the image."""
    found_v_px: NDArray[np.float64]
    """(n,) its row there."""
    used: NDArray[np.bool_]
    """(n,) whether the search used the point; points of low confidence are not used."""
    predicted_u_px: NDArray[np.float64]
    """(m,) columns of the horizon predicted at the fix; empty without one."""
    predicted_v_px: NDArray[np.float64]
    """(m,) its row there; may lie outside the image."""
    errors_deg: tuple[float, float, float] | None = None
    """Errors of azimuth, tilt and roll of this frame beyond the biases, reading minus truth; None if not solved for."""
    agreement: float | None = None
    """Share of the used columns that fit the place by the sensors' attitude; None if it cannot be judged."""
    left_out: bool = False
    """Whether this frame was excluded because it contradicts the others."""
    dem_edge_share: float = 0.0
    """Share of the predicted horizon that lies at the DEM edge and is not used."""
    quarter_turns: int = 0
    """Quarter turns clockwise that put the frame's sky up."""

    def turned_px(
        self, u_px: NDArray[np.float64], v_px: NDArray[np.float64], height_px: int = 0, width_px: int = 0
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Column and row in the upright frame of pixels of the recorded frame. Without its size both are off by a constant."""
        for _ in range(self.quarter_turns):
            u_px, v_px, width_px, height_px = height_px - 1.0 - v_px, u_px, height_px, width_px
        return u_px, v_px


@dataclass(frozen=True)
class SolvedErrors:
    """Errors that were estimated together with the place."""

    altitude_m: float
    """Of the optical centre, as solved for."""
    dem_error_m: float
    """Standard deviation of the ridges' elevations; 0 if the DEM was declared exact and fits."""
    correlation_columns: float
    """Columns per effective sample (integrated autocorrelation along the contour)."""
    inlier_share: float
    """Share of the informative columns within three standard deviations."""
    prior_chi2: float
    """Sum of the squared normalised errors of all readings."""
    evidence: float
    """Log Bayes factor of the place against an unrelated one."""


@dataclass(frozen=True)
class LocateDetails:
    """Intermediate results behind a fix."""

    frames: tuple[FrameDetail, ...]
    """In the order of the bundle's frames."""
    survivors: Mapping[str, NDArray[np.int64]]
    """Cells (row, col), each (n, 2), that were left after each step of stage 1, in the order of the steps:
    first "altitude", then the frames' labels as they were searched."""
    candidates_rowcol: NDArray[np.float64]
    """(k, 2) row and col of the fix's candidates, in the fix's order."""
    candidate_covariances_m2: NDArray[np.float64]
    """(k, 2, 2) of their easting and northing in the DEM's metric CRS; the first is the fix's own."""
    errors: SolvedErrors | None
    """At the best place; None where there is none."""


@dataclass(frozen=True)
class LocateResult:
    """What `locate` returns.

    Attributes
    ----------
    fix : Fix
        The position with its covariance, and the status.
    details : LocateDetails
        How it came about: contours, predicted skylines, surviving cells, candidates, solved errors.
    """

    fix: Fix
    details: LocateDetails
