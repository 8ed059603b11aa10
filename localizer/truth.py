"""The true position of the camera, from a simulation or a survey."""

from os import PathLike
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pyproj import CRS
from pyproj.exceptions import CRSError

from localizer.dem.crs import WGS84, transform_xy
from localizer.dem.ground import ground_distance_m
from localizer.dem.lattice import Dem
from localizer.documents import MOST_JSON_BYTES, DocumentError, json_text, read_file
from localizer.errors import SkyfixError
from localizer.fix import Position
from localizer.os_errors import why_not_read

FARTHEST_M = 1e8

"""Beyond any coordinate of a map."""


class Truth(BaseModel):
    """Where the camera really stood, as a simulation or a survey says it.

    Attributes
    ----------
    easting_m, northing_m : float
        In ``crs``.
    crs : str
        A projected coordinate reference system, as pyproj understands it.
    """

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)

    easting_m: Annotated[float, Field(ge=-FARTHEST_M, le=FARTHEST_M)]
    northing_m: Annotated[float, Field(ge=-FARTHEST_M, le=FARTHEST_M)]
    crs: Annotated[str, Field(min_length=1)]

    def metric(self, dem: Dem) -> tuple[float, float]:
        """Easting and northing in ``dem.metric_crs``."""
        return self.within(dem.metric_crs)

    def within(self, crs: CRS | str) -> tuple[float, float]:
        """Easting and northing in another projected CRS."""
        easting_m, northing_m = transform_xy(
            CRS.from_user_input(self.crs), CRS.from_user_input(crs), self.easting_m, self.northing_m
        )
        return float(easting_m), float(northing_m)

    def distance_m(self, position: Position, dem: Dem) -> float:
        """Measure how far on the ground a position lies from the true one.

        Parameters
        ----------
        position : Position
            As a fix has it.
        dem : Dem
            The elevation model that was searched.

        Returns
        -------
        float
            Metres.
        """
        return ground_distance_m(dem.metric_crs, position.easting_northing_m, self.metric(dem))


def _in_short(text: str) -> str:
    """In printable letters and not all of it: WKT has lines."""
    return "".join(letter if letter.isprintable() else " " for letter in text[:200])


def load_truth(path: str | PathLike[str]) -> Truth:
    """Read a known position, to compare a result with.

    Parameters
    ----------
    path : path-like
        JSON file with ``easting_m``, ``northing_m`` and ``crs``. The simulator writes such files.

    Returns
    -------
    Truth
        The position.

    Raises
    ------
    SkyfixError
        The file cannot be read, or holds something else.

    Examples
    --------
    >>> truth = localizer.load_truth("truth.json")
    >>> truth.crs
    'EPSG:32610'
    """
    path = Path(path)
    try:
        truth = Truth.model_validate_json(json_text(read_file(path, MOST_JSON_BYTES)))
        crs = CRS.from_user_input(truth.crs)
    except OSError as error:
        raise SkyfixError(f"{path}: {why_not_read(error, path)}") from None
    except DocumentError as error:
        raise SkyfixError(f"{path}: {error}") from None
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        field = ".".join(str(part) for part in first["loc"])
        raise SkyfixError(
            f"{path}: {field}{': ' if field else ''}{first['msg']}; a truth has easting_m, northing_m and crs"
        ) from None
    except (CRSError, RecursionError):  # the latter of JSON in the text
        raise SkyfixError(
            f"{path}: crs: {_in_short(truth.crs)} is not a coordinate reference system"
        ) from None
    if not crs.is_projected:
        raise SkyfixError(
            f"{path}: crs: {_in_short(truth.crs)} has no eastings and northings; name a projected one"
        )
    if not np.isfinite(transform_xy(crs, WGS84, truth.easting_m, truth.northing_m)).all():
        raise SkyfixError(f"{path}: easting_m, northing_m: lie where {truth.crs} is not defined")
    return truth
