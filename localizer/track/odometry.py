"""How the vehicle moved between two bundles, and the file that says so: JSON Lines, one line a leg.

The first line leads from the first bundle to the second, and so on: one line fewer than bundles. A line is one of

    {"distance_m": 200, "distance_sigma_m": 4, "heading_deg": 90, "heading_sigma_deg": 2}
    {"east_m": 200, "north_m": 0, "sigma_m": 5}
    {"east_m": 200, "north_m": 0, "covariance_m2": [[25, 0], [0, 16]]}
    {"unknown": true}

Distances are horizontal, headings those of the movement, true, clockwise from north; east and north are true. ``sigma_m`` is in
each of both directions. Empty lines and lines that begin with # are ignored.
"""

from os import PathLike
from pathlib import Path
from typing import Annotated, Literal, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, JsonValue, TypeAdapter, ValidationError, model_validator

from localizer.documents import MOST_JSON_BYTES, DocumentError, json_text, read_file
from localizer.errors import SkyfixError
from localizer.os_errors import why_not_read
from localizer.track.gaussian_place import Matrix

Floats = NDArray[np.float64]

FORMS = (
    "distance_m, distance_sigma_m, heading_deg, heading_sigma_deg; "
    "or east_m, north_m and sigma_m or covariance_m2; or unknown: true"
)
FARTHEST_M = 1e6

Metres = Annotated[float, Field(ge=-FARTHEST_M, le=FARTHEST_M)]
SigmaMetres = Annotated[float, Field(gt=0.0, le=FARTHEST_M)]


class OdometryError(SkyfixError):
    """Odometry that cannot be used; names the file and the line, or the number."""


class Movement(NamedTuple):
    """How a vehicle moved from one stop to the next.

    Attributes
    ----------
    step_m : ndarray of float, shape (2,)
        Horizontal metres to true east and north.
    covariance_m2 : ndarray of float, shape (2, 2)
        Of the same.

    Examples
    --------
    >>> import numpy as np
    >>> movement = localizer.Movement(np.array([200.0, 0.0]), np.diag([16.0, 25.0]))
    >>> movement = localizer.Movement.from_heading(200.0, 90.0, distance_sigma_m=4.0, heading_sigma_deg=2.0)
    >>> movement.step_m.round(1)
    array([199.9,   0. ])
    """

    step_m: Floats
    covariance_m2: Floats

    @classmethod
    def from_heading(
        cls, distance_m: float, heading_deg: float, *, distance_sigma_m: float, heading_sigma_deg: float
    ) -> Self:
        """Make a movement of a distance and a direction, as a wheel odometer and a heading give them.

        Parameters
        ----------
        distance_m : float
            Horizontal distance.
        heading_deg : float
            True direction of the movement, clockwise from north.
        distance_sigma_m, heading_sigma_deg : float
            One standard deviation of each, greater than 0.

        Returns
        -------
        Movement
            Exact mean and covariance of the end of the leg. With a poor heading it lies on an arc, whose mean is nearer than
            its length.

        Raises
        ------
        OdometryError
            A number is out of range.
        """
        try:
            leg = DistanceLeg(
                distance_m=distance_m,
                distance_sigma_m=distance_sigma_m,
                heading_deg=heading_deg,
                heading_sigma_deg=heading_sigma_deg,
            )
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            raise OdometryError(f"{first['loc'][0]}: {first['msg']} (got {first['input']!r})") from None
        return cls(*leg.movement())


class _Leg(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, strict=True)


class DistanceLeg(_Leg):
    """Distance and heading, as of a wheel odometer and a compass."""

    distance_m: Annotated[float, Field(ge=0.0, le=FARTHEST_M)]
    distance_sigma_m: SigmaMetres
    heading_deg: Annotated[float, Field(ge=-360.0, le=360.0)]
    heading_sigma_deg: Annotated[float, Field(gt=0.0, le=180.0)]

    def movement(self) -> Movement:
        """Mean and covariance of a distance and a direction that are both Gaussian.

        Exact moments instead of a linearisation: with a poor heading the end point lies on an arc, whose mean is nearer.
        """
        heading, sigma = np.radians(self.heading_deg), np.radians(self.heading_sigma_deg)
        ahead = np.array([np.sin(heading), np.cos(heading)])
        aside = np.array([np.cos(heading), -np.sin(heading)])
        mean_m = self.distance_m * np.exp(-0.5 * sigma**2)
        square_m2 = self.distance_m**2 + self.distance_sigma_m**2
        along_m2 = 0.5 * square_m2 * (1.0 + np.exp(-2.0 * sigma**2)) - mean_m**2
        across_m2 = 0.5 * square_m2 * (1.0 - np.exp(-2.0 * sigma**2))
        covariance_m2 = along_m2 * np.outer(ahead, ahead) + across_m2 * np.outer(aside, aside)
        return Movement(mean_m * ahead, covariance_m2)


class VectorLeg(_Leg):
    """East and north, as of an inertial system or visual odometry."""

    east_m: Metres
    north_m: Metres
    sigma_m: SigmaMetres | None = None
    covariance_m2: Matrix | None = None
    """Of (east, north)."""

    @model_validator(mode="after")
    def _one_uncertainty(self) -> Self:
        if (self.sigma_m is None) == (self.covariance_m2 is None):
            raise ValueError("give sigma_m or covariance_m2, one of both")
        if self.covariance_m2 is not None:
            c = np.array(self.covariance_m2)
            if c[0, 1] != c[1, 0] or np.linalg.eigvalsh(c)[0] <= 0.0 or c.max() > FARTHEST_M**2:
                raise ValueError("covariance_m2 should be symmetric and positive definite")
        return self

    def movement(self) -> Movement:
        covariance_m2 = (
            np.eye(2) * self.sigma_m**2 if self.sigma_m is not None else np.array(self.covariance_m2)
        )
        return Movement(np.array([self.east_m, self.north_m]), covariance_m2)


class UnknownLeg(_Leg):
    """An unknown movement."""

    unknown: Literal[True]

    def movement(self) -> None:
        return None


Odometry = tuple[Movement | None, ...]
"""One movement for each leg; None if unknown."""

MOST_LEG_BYTES = 100_000

_OBJECT = TypeAdapter(dict[str, JsonValue])


def parse_leg(text: str | bytes) -> Movement | None:
    """One line of an odometry file. Raises ``ValueError`` with one line of what is wrong."""
    try:
        text = json_text(text, MOST_LEG_BYTES)
        fields = _OBJECT.validate_json(text)
    except DocumentError as error:
        raise ValueError(f"is no JSON object: {error}") from None
    except ValidationError:
        raise ValueError("is no JSON object") from None
    kind: type[DistanceLeg | VectorLeg | UnknownLeg]
    if "distance_m" in fields or "heading_deg" in fields:
        kind = DistanceLeg
    elif "unknown" in fields:
        kind = UnknownLeg
    elif "east_m" in fields or "north_m" in fields:
        kind = VectorLeg
    else:
        raise ValueError(f"says nothing of a movement; give {FORMS}")
    try:
        return kind.model_validate_json(text).movement()
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        field = ".".join(str(part) for part in first["loc"])
        what = (
            f"is not a field of such a leg; give {FORMS}"
            if first["type"] == "extra_forbidden"
            else first["msg"].removeprefix("Value error, ")
        )
        given = first["input"]
        got = f" (got {given!r})" if field and isinstance(given, str | int | float | bool) else ""
        raise ValueError(f"{field}{': ' if field else ''}{what}{got}") from None


def load_odometry(path: str | PathLike[str], legs: int | None = None) -> Odometry:
    """Read how a vehicle moved between the stops of a drive.

    Parameters
    ----------
    path : path-like
        JSON Lines, one line for each leg between two bundles; empty lines and such that begin with # are skipped.
    legs : int, optional
        How many there should be; any number unless given.

    Returns
    -------
    tuple of Movement or None
        One for each leg; None where the file says that it is unknown.

    Raises
    ------
    OdometryError
        The file cannot be read, a line is wrong, or there are more or fewer legs. Names the file and the line.

    Notes
    -----
    A line is one of ::

        {"distance_m": 200, "distance_sigma_m": 4, "heading_deg": 90, "heading_sigma_deg": 2}
        {"east_m": 200, "north_m": 0, "sigma_m": 5}
        {"east_m": 200, "north_m": 0, "covariance_m2": [[25, 0], [0, 16]]}
        {"unknown": true}

    Examples
    --------
    >>> for movement in localizer.load_odometry("legs.jsonl"):
    ...     print("unknown" if movement is None else movement.step_m.round())
    [201.  -2.]
    """
    path = Path(path)
    try:
        lines = read_file(path, MOST_JSON_BYTES).decode("utf-8-sig").splitlines()
    except OSError as error:
        raise OdometryError(f"{path}: {why_not_read(error, path)}") from None
    except DocumentError as error:
        raise OdometryError(f"{path}: {error}") from None
    except UnicodeDecodeError:
        raise OdometryError(f"{path}: is no text; odometry is JSON Lines, one line a leg") from None
    movements = []
    for number, line in enumerate(lines, 1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        try:
            movements.append(parse_leg(line))
        except ValueError as error:
            raise OdometryError(f"{path}:{number}: {error}") from None
    if legs is not None and len(movements) != legs:
        raise OdometryError(
            f"{path}: has {len(movements)} legs, but {legs + 1} bundles have {legs} between them; "
            'give one line a leg, {"unknown": true} where nothing is known'
        )
    return tuple(movements)
