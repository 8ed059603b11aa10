"""The table row of one case."""

import json
from typing import Literal

from pydantic import BaseModel, ConfigDict


class CaseRow(BaseModel):
    """One table row. None if not applicable: no fix, no bound, no altimeter."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    case: int
    seed: int
    dem: str
    outside: bool  # the truth does not lie on the searched DEM
    true_row: float
    true_col: float
    true_easting_m: float
    true_northing_m: float
    true_altitude_m: float
    frames: int
    status: Literal["fix", "ambiguous", "none"]
    error_m: float | None
    error_cells: float | None
    mahalanobis2: float | None  # of the error against the fix's covariance
    probability: float | None
    best_candidate_probability: float | None
    candidates: int
    truth_among: bool  # a candidate within 3 cells or 5 sigma of the truth
    truth_probability: float  # of the nearest such candidate
    sigma_major_m: float | None
    crlb_rms_m: float | None
    crlb_free_altitude_rms_m: float | None
    crlb_far_horizon_rms_m: float | None
    crlb_wary_rms_m: float | None
    easting_m: float | None
    northing_m: float | None
    dem_error_m: float | None
    correlation_columns: float | None
    inlier_share: float | None
    evidence: float | None
    prior_chi2: float | None
    azimuth_bias_deg: float | None
    columns_used: int
    contour_median_px: float | None  # of the distances from the terrain's true skyline
    contour_stray_share: float | None  # of the columns used, more than 3 px from it
    cells: int
    after_altitude: int
    after: str  # JSON: cells left after each direction
    points_explored: int
    time_s: float
    timing_s: str  # JSON: seconds of each part

    def to_cells(self) -> dict[str, str]:
        """The row as CSV has it."""
        return {name: _cell(value) for name, value in self.model_dump().items()}

    @classmethod
    def from_cells(cls, cells: dict[str, str]) -> "CaseRow":
        """The row that was written as ``cells``; raises pydantic's ValidationError."""
        return cls.model_validate({name: None if text == "" else text for name, text in cells.items()})


def _cell(value: object) -> str:
    if value is None:
        return ""
    return f"{value:.6g}" if isinstance(value, float) and abs(value) < 1e5 else str(value)


def compact_json(numbers: dict[str, int] | dict[str, float]) -> str:
    """Numbers by name as compact JSON."""
    return json.dumps({name: round(value, 4) for name, value in numbers.items()}, separators=(",", ":"))
