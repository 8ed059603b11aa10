"""How the vehicle moved between two bundles, and the file that says so: JSON Lines, one line a leg.

The first line leads from the first bundle to the second, and so on: one line fewer than bundles. A line is one of

    {"distance_m": 200, "distance_sigma_m": 4, "heading_deg": 90, "heading_sigma_deg": 2}
    {"east_m": 200, "north_m": 0, "sigma_m": 5}
    {"east_m": 200, "north_m": 0, "covariance_m2": [[25, 0], [0, 16]]}
    {"unknown": true}

Distances are horizontal, headings those of the movement, true, clockwise from north; east and north are true. ``sigma_m`` is in
each of both directions. Empty lines and lines that begin with # are ignored.
"""

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
    """Odometry that cannot be used; names the file and the line."""


class Movement(NamedTuple):
    """The step (2,) to true east and north in metres and its covariance (2, 2)."""

    step_m: Floats
    covariance_m2: Floats


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


def load_odometry(path: Path, legs: int) -> Odometry:
    """Read the file for that many legs. Raises ``OdometryError`` that names the file and the line."""
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
    if len(movements) != legs:
        raise OdometryError(
            f"{path}: has {len(movements)} legs, but {legs + 1} bundles have {legs} between them; "
            'give one line a leg, {"unknown": true} where nothing is known'
        )
    return tuple(movements)
