"""The localizer's result for a case, uniform for contours and pictures."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from localizer import Fix, LocateResult, Observation, SolvedErrors
from localizer.experiments import Located, Terrain, fix_of, ground_offset_m, metric_covariance

Array = NDArray[np.float64]

NEAR_SIGMAS = 5.0


@dataclass(frozen=True)
class CaseResult:
    """The result. ``covariances_m2`` (k, 2, 2) are those of the fix's candidates; ``contours_px`` (u, v) the columns
    used of each frame.
    """

    fix: Fix
    covariances_m2: Array
    errors: SolvedErrors | None
    contours_px: tuple[tuple[Array, Array], ...]

    @classmethod
    def to_observation(cls, terrain: Terrain, observation: Observation, located: Located) -> Self:
        """From a search with contours."""
        best = located.best
        covariances = [metric_covariance(terrain, candidate) for candidate in located.decision.candidates]
        errors = None
        if best is not None:
            errors = SolvedErrors(
                altitude_m=best.altitude_m,
                dem_error_m=best.dem_error_m,
                correlation_columns=best.correlation_columns,
                inlier_share=best.inlier_share,
                prior_chi2=best.prior_chi2,
                evidence=best.evidence,
            )
        return cls(
            fix=fix_of(terrain, observation, located, "case", located.timing_s),
            covariances_m2=np.array(covariances).reshape(-1, 2, 2),
            errors=errors,
            contours_px=tuple((frame.u_px, frame.v_px) for frame in observation.frames),
        )

    @classmethod
    def to_bundle(cls, result: LocateResult) -> Self:
        """From a search with pictures."""
        details = result.details
        return cls(
            fix=result.fix,
            covariances_m2=details.candidate_covariances_m2,
            errors=details.errors,
            contours_px=tuple((f.found_u_px[f.used], f.found_v_px[f.used]) for f in details.frames),
        )

    def off_by(self, easting_m: float, northing_m: float) -> tuple[float, float] | None:
        """Distance of the position from a place, metres of the ground, and its square in the fix's own covariance."""
        fix = self.fix
        if fix.position is None or fix.covariance_m2 is None:
            return None
        here = fix.position.easting_northing_m
        off = ground_offset_m(fix.position.crs, here, (easting_m, northing_m))
        return float(np.hypot(*off)), float(off @ np.linalg.solve(np.array(fix.covariance_m2), off))

    def probability_of(self, easting_m: float, northing_m: float, near_m: float) -> float | None:
        """Probability of the nearest candidate within ``near_m`` or 5 sigma of a place; None without one."""
        found = []
        crs = self.fix.position.crs if self.fix.position else ""
        for candidate, covariance in zip(self.fix.candidates, self.covariances_m2, strict=True):
            off = ground_offset_m(crs, (candidate.easting_m, candidate.northing_m), (easting_m, northing_m))
            distance_m = float(np.hypot(*off))
            if distance_m <= near_m or off @ np.linalg.solve(covariance, off) <= NEAR_SIGMAS**2:
                found.append((distance_m, candidate.probability))
        return min(found)[1] if found else None
