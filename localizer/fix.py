"""The fix, ``skyfix.fix/1``: position, covariance, probabilities, and statistics of the search."""

from typing import Annotated, Literal, NamedTuple, Self

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from localizer.dem.crs import wrapped_lon_deg

Probability = Annotated[float, Field(ge=0.0, le=1.0)]
Status = Literal["fix", "ambiguous", "none"]

EXIT_STATUS: dict[Status, int] = {"fix": 0, "ambiguous": 3, "none": 4}
"""Exit statuses of ``localizer locate``."""


class _Part(BaseModel):
    """Immutable, finite numbers only, and no field that the contract does not know."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Position(_Part):
    """A place in a metric CRS, on WGS84, and in the DEM's own grid."""

    easting_m: float
    """Easting in ``crs``."""
    northing_m: float
    """Northing in ``crs``."""
    crs: str
    """The metric CRS: the DEM's own where that is projected, else the UTM zone of the DEM's centre."""
    lat_deg: float
    """Latitude, WGS84."""
    lon_deg: Annotated[float, AfterValidator(wrapped_lon_deg)]
    """Longitude, WGS84, -180 <= lon < 180."""
    ground_m: float
    """Elevation of the ground there, above the DEM's vertical datum."""
    row: float
    """Row in the DEM's grid; row 0 is the northernmost, cell centres are at whole numbers."""
    col: float
    """Column in the DEM's grid; cell centres are at whole numbers."""

    @property
    def easting_northing_m(self) -> tuple[float, float]:
        """In ``crs``."""
        return self.easting_m, self.northing_m


class Candidate(_Part):
    """One of the places that the pictures fit."""

    easting_m: float
    """Easting in the position's CRS."""
    northing_m: float
    """Northing in the position's CRS."""
    probability: Probability
    """That the camera stood there."""
    rms_px: Annotated[float, Field(ge=0.0)]
    """Root mean square of found minus predicted skyline, over all frames, the biases solved for."""


class Stage1Counts(_Part):
    """How many cells stage 1 of the search left, as in Table I of Talluri and Aggarwal (1992)."""

    cells: int
    """Cells of the DEM that have an elevation."""
    after_altitude: int
    """Cells left by the altitude."""
    after: dict[str, int]
    """Cells left after each direction, by the frame's label, in the order searched."""
    points_explored: int
    """POINTs (the paper's term) visited in all directions together."""


class Nuisance(_Part):
    """The errors common to all frames, solved for with the position: reading minus truth."""

    azimuth_bias_deg: float
    """Of the azimuths of all frames."""
    tilt_bias_deg: float
    """Of the tilts of all frames."""
    altitude_bias_m: float
    """Of the altitude; 0 without an altimeter."""


ReasonCode = Literal[
    "several_places",
    "too_little_skyline",
    "contradicted",
    "dem_error",
    "outside",
    "unknown_datum",
    "no_ground_at_altitude",
]


class Reason(_Part):
    """Why a result is no fix."""

    code: ReasonCode
    """For programs."""
    text: Annotated[str, Field(min_length=1)]
    """For people."""


class Fix(_Part):
    """The result of a search, ``skyfix.fix/1``.

    Examples
    --------
    >>> fix = result.fix  # of locate
    >>> fix.status, fix.position.crs
    ('fix', 'EPSG:32610')
    >>> localizer.Fix.model_validate_json(fix.to_json()) == fix  # JSON is what localizer locate --json prints
    True
    >>> fix.error_ellipse().semi_major_m < 5.0
    True
    """

    schema_name: Literal["skyfix.fix/1"] = Field(default="skyfix.fix/1", alias="schema")
    """What the document is, and its version."""
    bundle: str
    """Id of the bundle that was located."""
    status: Status
    """One place stands out ("fix"), several do or one is not certain enough ("ambiguous"), or the images fit no place
    in the DEM ("none")."""
    position: Position | None
    """The likeliest place; null where status is "none"."""
    covariance_m2: tuple[tuple[float, float], tuple[float, float]] | None
    """Covariance of easting and northing, in metres on the ground; null where status is "none"."""
    probability: Probability
    """Of the position."""
    elsewhere: Probability = 0.0
    """Probability of all places that are not among ``candidates``, those that were not compared included."""
    reason: Reason | None = None
    """Why the result is no fix; null for a fix."""
    candidates: tuple[Candidate, ...]
    """All places that the images fit, the likeliest first; the first is the position."""
    stage1: Stage1Counts
    """How many cells each test of stage 1 left."""
    residual: dict[str, float]
    """Root mean square of found minus predicted skyline of each frame, pixels, by its label."""
    nuisance: Nuisance | None
    """The sensors' errors at the position; null where status is "none"."""
    timing_s: dict[str, float]
    """Seconds that each part of the search took."""

    @model_validator(mode="after")
    def _fix_has_a_place(self) -> Self:
        if self.status == "fix" and (self.position is None or self.covariance_m2 is None):
            raise ValueError("a fix has a position and its covariance")
        return self

    @property
    def exit_status(self) -> int:
        """The exit status of ``localizer locate`` for this result."""
        return EXIT_STATUS[self.status]

    def error_ellipse(self, confidence: float = 0.95) -> "ErrorEllipse":
        """Compute the ellipse that holds the true position with a probability.

        Parameters
        ----------
        confidence : float, optional
            The probability, between 0 and 1; 0.393 gives one standard deviation along each axis.

        Returns
        -------
        ErrorEllipse
            Its semi-axes and direction, from ``covariance_m2``.

        Raises
        ------
        ValueError
            There is no position, or the confidence is out of range.
        """
        if self.covariance_m2 is None:
            raise ValueError("a result without a position has no ellipse; look at the status first")
        if not 0.0 < confidence < 1.0:
            raise ValueError(f"confidence: is {confidence:g}; should be between 0 and 1")
        one_sigma = ellipse(self.covariance_m2)
        sigmas = float(np.sqrt(-2.0 * np.log1p(-confidence)))  # chi-square quantile for two dimensions
        return ErrorEllipse(
            sigmas * one_sigma.major_m, sigmas * one_sigma.minor_m, one_sigma.grid_azimuth_deg
        )

    def to_json(self) -> str:
        """The fix as one JSON object on one line."""
        return self.model_dump_json(by_alias=True)


Covariance = tuple[tuple[float, float], tuple[float, float]]


class ErrorEllipse(NamedTuple):
    """An ellipse around a position.

    Attributes
    ----------
    semi_major_m, semi_minor_m : float
        Half the lengths of its axes, metres on the ground.
    grid_azimuth_deg : float
        Direction of the major axis, clockwise from the map's north, 0 to 180.
    """

    semi_major_m: float
    semi_minor_m: float
    grid_azimuth_deg: float


class EllipseAxes(NamedTuple):
    """Axes of the one-sigma ellipse."""

    major_m: float
    minor_m: float
    grid_azimuth_deg: float
    """Of the major axis, 0 to 180."""


def ellipse(covariance_m2: Covariance) -> EllipseAxes:
    """The axes of the one-sigma ellipse."""
    variances, axes = np.linalg.eigh(np.array(covariance_m2))
    minor_m, major_m = np.sqrt(np.clip(variances, 0.0, None))
    east, north = axes[:, 1]
    return EllipseAxes(float(major_m), float(minor_m), float(np.degrees(np.arctan2(east, north)) % 180.0))


def lat_lon(position: Position) -> str:
    """As ``46.19901° N  122.19203° W``: five decimals are a metre."""
    north, east = "N" if position.lat_deg >= 0.0 else "S", "E" if position.lon_deg >= 0.0 else "W"
    return f"{abs(position.lat_deg):.5f}° {north}  {abs(position.lon_deg):.5f}° {east}"
