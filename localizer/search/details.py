"""What the search knows beyond the fix itself: enough to draw it, to explain it and to test it."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from localizer.fix import Fix

INCONSISTENT_BELOW = 0.4
"""A frame of which less than this share of the columns fits a place contradicts it."""


@dataclass(frozen=True)
class FrameDetail:
    """One frame's skylines, in pixels of the frame as recorded (pixel centres at whole numbers)."""

    label: str
    found_u_px: NDArray[np.float64]
    """(n,) columns in which a skyline was found in the image."""
    found_v_px: NDArray[np.float64]
    """(n,) its row there."""
    used: NDArray[np.bool_]
    """(n,) whether the search used the point (it may be too doubtful)."""
    predicted_u_px: NDArray[np.float64]
    """(m,) columns of the terrain's horizon as seen from the fix; empty when there is no fix."""
    predicted_v_px: NDArray[np.float64]
    """(m,) its row there; may lie outside the image."""
    errors_deg: tuple[float, float, float] | None = None
    """Of azimuth, tilt and roll, this frame's own beside the biases, reading minus truth; None where not solved for."""
    agreement: float | None = None
    """Share of the columns used that fit the place found, by what the sensors say; None where there is no telling."""
    left_out: bool = False
    """Whether the search did without this frame, because it contradicts the others."""
    dem_edge_share: float = 0.0
    """Of the horizon as seen from the fix, the share that lies where the DEM ends and tells nothing."""
    quarter_turns: int = 0
    """By so many quarters clockwise the frame is turned to have its sky up."""

    def turned_px(
        self, u_px: NDArray[np.float64], v_px: NDArray[np.float64], height_px: int = 0, width_px: int = 0
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Column and row, in the frame turned so, of pixels of the frame as recorded; without its size but for a constant."""
        for _ in range(self.quarter_turns):
            u_px, v_px, width_px, height_px = height_px - 1.0 - v_px, u_px, height_px, width_px
        return u_px, v_px


@dataclass(frozen=True)
class SolvedErrors:
    """What the search found out about the errors while it solved for the place."""

    altitude_m: float
    """Of the optical centre, as solved for."""
    dem_error_m: float
    """Of the ridges' elevations, one standard deviation; 0 where the DEM was said to be the terrain itself, and it fits."""
    correlation_columns: float
    """So many neighbouring columns are worth one independent one."""
    inlier_share: float
    """Share of the columns within three standard deviations."""
    prior_chi2: float
    """Sum of the squared deviations of all readings, each in its own standard deviations."""
    evidence: float
    """Logarithm of how much better than chance the terrain explains the skylines."""


@dataclass(frozen=True)
class LocateDetails:
    """How a fix came about."""

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
    """What ``localizer.search.locate.locate_bundle`` returns."""

    fix: Fix
    details: LocateDetails
