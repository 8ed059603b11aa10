"""The tuned constants of ``localizer.search``, in the order in which they are measured: what decides an answer first.

Limits of physics, numerical steps and resource limits that change no answer are not listed.
"""

from dataclasses import dataclass
from typing import Literal

Kind = Literal["scale", "complement", "count", "first", "all"]
Setting = Literal["contours", "exact DEM"]
FACTORS = {"half": 0.5, "double": 2.0}


@dataclass(frozen=True)
class Tuned:
    """One constant.

    ``kind``: what is halved and doubled. ``scale``: the value; ``complement``: its distance from 1 (probabilities);
    ``count``: the value, as a whole number of at least 1; ``first``: the first of a tuple, such as a grid's reach; ``all``:
    every value of a tuple.
    ``setting``: which cases show its effect.
    """

    module: str
    name: str
    meaning: str
    kind: Kind = "scale"
    setting: Setting = "contours"

    @property
    def label(self) -> str:
        """As the table names it: ``decide.FIX_EVIDENCE``."""
        return f"{self.module}.{self.name}"


_FIT = "fit."

TUNED: tuple[Tuned, ...] = (
    Tuned("decide", "TEMPERING_EXPONENT", "exponent on the likelihood when places are compared"),
    Tuned("decide", "FIX_EVIDENCE", "log Bayes factor that a fix needs"),
    Tuned("decide", "LEAST_EVIDENCE", "log Bayes factor below which no place is believed"),
    Tuned("decide", "FIX_PROBABILITY", "posterior probability that a fix needs", "complement"),
    Tuned("decide", "LEAST_INLIERS", "least share of inlier columns at a believed place", "complement"),
    Tuned("decide", "MOST_PRIOR_SIGMAS", "largest normalised error of the readings at a believed place"),
    Tuned("decide", "LARGEST_FIX_SIGMA_CELLS", "largest standard deviation of a fix"),
    Tuned("decide", "LEAST_MODE_SIGMA_CELLS", "least width of a mode when places are compared"),
    Tuned(f"{_FIT}outliers", "UNRELATED_SKYLINE_RAD", "how far skylines of unrelated places differ"),
    Tuned(f"{_FIT}outliers", "OUTLIER_SHARE", "prior share of sectors that show no terrain"),
    Tuned(f"{_FIT}outliers", "OUTLIER_STRETCH_RAD", "length of a stretch of outliers"),
    Tuned(f"{_FIT}outliers", "RESOLVED_SIGMAS", "height difference that a column resolves"),
    Tuned(f"{_FIT}problem", "SECTOR_RAD", "sector of the horizon that counts as one sample"),
    Tuned("stage2", "GEMAN_MCCLURE_SIGMAS", "scale of the Geman-McClure loss"),
    Tuned(f"{_FIT}correlated_errors", "OUTLIER_NLL", "negative log-likelihood of an outlier column"),
    Tuned(
        f"{_FIT}objective", "GROUND_ERROR_FACTOR", "error of the ground under the camera over that of ridges"
    ),
    Tuned(f"{_FIT}local_optima", "TEMPERATURE_PER_M", "temperature of the likelihood per metre of DEM error"),
    Tuned(f"{_FIT}refine", "PLACE_SHIFT_PER_M", "place error per metre of smooth DEM error"),
    Tuned(
        f"{_FIT}refine", "RESAMPLING_SHIFT_CELLS", "place error by the choice of the interpolating surface"
    ),
    Tuned(f"{_FIT}residuals", "LATERAL_ERROR_SHARE", "horizontal over vertical DEM error"),
    Tuned(f"{_FIT}residuals", "INTERPOLATION_ERROR_SHARE", "error between cells over the second difference"),
    Tuned(f"{_FIT}residuals", "SUMMIT_SMOOTHING_SHARE", "summit height lost by a DEM"),
    Tuned(f"{_FIT}residuals", "LARGEST_SLOPE", "largest skyline slope that counts"),
    Tuned(f"{_FIT}noise", "INITIAL_LENGTH_CELLS", "correlation length before it is estimated"),
    Tuned(f"{_FIT}noise", "LEAST_AUTOCORRELATION", "where the sum of autocorrelations is cut off"),
    Tuned(f"{_FIT}noise", "LEAST_ROUGH_SHARE", "least rough DEM error"),
    Tuned(f"{_FIT}noise", "LEAST_DEM_ERROR_M", "least robust DEM error"),
    Tuned(f"{_FIT}noise", "LEAST_SMOOTH_M", "least smooth DEM error"),
    Tuned("compare", "GROSS_NATS", "penalty for a sector missed grossly that another place explains"),
    Tuned("compare", "GROSS_RAD", "least angle of a gross error"),
    Tuned("compare", "GROSS_SIGMAS", "least normalised size of a gross error"),
    Tuned("compare", "DECIDED_NATS", "lead that ends the comparison"),
    Tuned("compare", "COMPARISON_ROUNDS", "rounds of comparison", "count"),
    Tuned("selection", "UNREFINED_GAIN_NATS", "gain that refinement may bring a rejected place"),
    Tuned("selection", "MODE_NATS", "log-odds behind the best at which a place leaves the comparison"),
    Tuned("selection", "LEAST_LOG_ODDS", "least log-odds of a compared place"),
    Tuned("selection", "MOST_MODES", "compared places at most", "count"),
    Tuned("selection", "START_SIGMAS", "stage-2 disparity up to which cells start a coarse fit"),
    Tuned("selection", "SHORTLIST_COLUMN_NATS", "shortlist: deficit of a column's log-likelihood"),
    Tuned("selection", "SHORTLIST_NATS", "shortlist: deficit of the whole log-likelihood"),
    Tuned("selection", "SHORTLIST_ODDS_SHARE", "shortlist: share of the best log-odds"),
    Tuned("stage1", "SIGMAS", "half width of the band of stage 1"),
    Tuned("coarse_to_fine", "KEPT_SIGMAS", "stage-2 disparity up to which cells stay"),
    Tuned("coarse_to_fine", "SECTOR_DEG", "sector of the horizon that counts as one sample in stage 2"),
    Tuned(f"{_FIT}local_optima", "GRID_CELLS", "reach of the search grid around a fit", "first"),
    Tuned(f"{_FIT}local_optima", "GRID_ERROR_FACTORS", "DEM errors assumed on that grid", "all"),
    Tuned(f"{_FIT}local_optima", "GRID_STARTS", "fits from that grid per assumed error", "count"),
    Tuned(f"{_FIT}local_optima", "MOST_FINE_FITS", "fits with fine columns", "count"),
    Tuned(f"{_FIT}local_optima", "FINE_GRID_CELLS", "reach of the fine grid", "first"),
    Tuned(f"{_FIT}local_optima", "MOMENT_GRID_CELLS", "reach of the grid of the second moment", "first"),
    Tuned(f"{_FIT}local_optima", "MOMENT_NATS", "evidence that a place on that grid may lack"),
    Tuned(f"{_FIT}local_optima", "LIKELY_OPTIMUM_SHARE", "likelihood ratio of optima that count"),
    Tuned(f"{_FIT}local_optima", "CLEAN_INLIER_SHARE", "inlier share that needs no strict fit", "complement"),
    Tuned(f"{_FIT}local_optima", "STRICT_SIGMA_FACTOR", "factor on the DEM error in a strict fit"),
    Tuned(f"{_FIT}problems", "MIDDLE_COLUMNS", "columns in comparisons", "count"),
    Tuned(f"{_FIT}problems", "COARSE_COLUMNS", "columns in coarse fits", "count"),
    Tuned(f"{_FIT}problems", "FINE_COLUMNS", "columns in fine fits", "count"),
    Tuned(
        f"{_FIT}refine", "LIKELIHOOD_FROM", "iteration from which the noise is fitted by likelihood", "count"
    ),
    Tuned(f"{_FIT}refine", "LEAST_GAIN_NATS", "gain below which a fit ends"),
    Tuned(
        f"{_FIT}local_grid", "CHECKED_SHARE", "share of the likelihood from which a distant place is checked"
    ),
    Tuned(f"{_FIT}correlated_errors", "NEGLIGIBLE_SHARE", "likelihood ratio of error models that count"),
    Tuned(
        f"{_FIT}problem",
        "CONTOUR_DISTANCE_CELLS",
        "distance that stands for the contour's shared error",
        setting="exact DEM",
    ),
    Tuned(
        f"{_FIT}problem",
        "USUAL_CONTOUR_SHARE",
        "initial shared part of the contour's error",
        setting="exact DEM",
    ),
    Tuned(
        f"{_FIT}problem",
        "LARGEST_CONTOUR_SHARE",
        "largest shared part of the contour's error",
        setting="exact DEM",
    ),
)
