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
    """A place in a metric CRS, on WGS84, and in the DEM's own grid.

    Attributes
    ----------
    easting_m, northing_m : float
        In ``crs``.
    crs : str
        The DEM's own CRS if it is projected in metres, else the WGS84 UTM zone of its centre, as ``EPSG:32610``.
    lat_deg, lon_deg : float
        WGS84, -180 <= lon_deg < 180.
    ground_m : float
        Elevation of the ground above the DEM's vertical datum.
    row, col : float
        In the DEM's cells, centres at whole numbers.
    """

    easting_m: float
    northing_m: float
    crs: str
    lat_deg: float
    lon_deg: Annotated[float, AfterValidator(wrapped_lon_deg)]
    ground_m: float
    row: float
    col: float

    @property
    def easting_northing_m(self) -> tuple[float, float]:
        """In ``crs``."""
        return self.easting_m, self.northing_m


class Candidate(_Part):
    """One of the places that the pictures fit.

    Attributes
    ----------
    easting_m, northing_m : float
        In the CRS of the fix.
    probability : float
        That it is the place.
    rms_px : float
        Root mean square of found minus predicted skyline over all frames, the biases solved for.
    """

    easting_m: float
    northing_m: float
    probability: Probability
    rms_px: Annotated[float, Field(ge=0.0)]


class Stage1Counts(_Part):
    """How many cells stage 1 of the search left, as in Table I of Talluri and Aggarwal (1992).

    Attributes
    ----------
    cells : int
        Cells of the DEM that have an elevation.
    after_altitude : int
        Cells left after the altitude.
    after : dict of str to int
        Cells left after each direction, by the frame's label, in the order searched.
    points_explored : int
        POINTs (the paper's term) visited in all directions together.
    """

    cells: int
    after_altitude: int
    after: dict[str, int]
    points_explored: int


class Nuisance(_Part):
    """The errors common to all frames, solved for with the position: reading minus truth.

    Attributes
    ----------
    azimuth_bias_deg, tilt_bias_deg : float
        Of the camera's angles.
    altitude_bias_m : float
        Of the altimeter; 0 without one.
    """

    azimuth_bias_deg: float
    tilt_bias_deg: float
    altitude_bias_m: float


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
    """Why a result is no fix.

    Attributes
    ----------
    code : str
        ``several_places``, ``too_little_skyline``, ``contradicted``, ``dem_error``, ``outside``, ``unknown_datum`` or
        ``no_ground_at_altitude``.
    text : str
        One sentence for people, with what would help.
    """

    code: ReasonCode
    text: Annotated[str, Field(min_length=1)]


class Fix(_Part):
    """The result of a search, ``skyfix.fix/1``.

    Attributes
    ----------
    bundle : str
        The bundle's id.
    status : str
        ``"fix"``: one place stands out. ``"ambiguous"``: several do; all are in ``candidates``. ``"none"``: the terrain
        explains the pictures nowhere.
    position : Position or None
        The most probable place; None where there is none.
    covariance_m2 : tuple, 2 x 2, or None
        Of easting and northing, along the map's axes, square metres on the ground.
    probability : float
        Of the position.
    elsewhere : float
        Probability of all places that are not among ``candidates``, those that were not compared included.
    reason : Reason or None
        Why it is no fix; None for one.
    candidates : tuple of Candidate
        The places that could be it, the most probable first.
    stage1 : Stage1Counts
        How many cells stage 1 left.
    residual : dict of str to float
        Root mean square of found minus predicted skyline in pixels, by the frame's label.
    nuisance : Nuisance or None
        Errors common to all frames; None without a position.
    timing_s : dict of str to float
        Seconds taken by the parts of the search.

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
    bundle: str
    status: Status
    position: Position | None
    covariance_m2: tuple[tuple[float, float], tuple[float, float]] | None
    probability: Probability
    elsewhere: Probability = 0.0
    reason: Reason | None = None
    candidates: tuple[Candidate, ...]
    stage1: Stage1Counts
    residual: dict[str, float]
    nuisance: Nuisance | None
    timing_s: dict[str, float]

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
