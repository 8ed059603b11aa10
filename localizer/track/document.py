"""The result of each bundle of a track, as a line of text and as JSON (``skyfix.track/1``)."""

from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from localizer.dem.crs import wrapped_lon_deg
from localizer.dem.geodesy import lonlat_to_rowcol, map_metres_at, rowcol_to_metric
from localizer.dem.lattice import Dem
from localizer.fix import Fix, Probability, ellipse, lat_lon
from localizer.track.gaussian_place import Matrix, matrix
from localizer.track.mixture import Posterior
from localizer.track.tracker import Mode, Step


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class TrackHypothesis(_Part):
    """A place where the vehicle may be."""

    easting_m: float
    """Easting in the fix's CRS."""
    northing_m: float
    """Northing in the fix's CRS."""
    lat_deg: float
    """Latitude, WGS84."""
    lon_deg: Annotated[float, AfterValidator(wrapped_lon_deg)]
    """Longitude, WGS84, -180 <= lon < 180."""
    row: float
    """Row in the DEM's grid."""
    col: float
    """Column in the DEM's grid."""
    covariance_m2: Matrix
    """Covariance of easting and northing, in metres on the ground."""
    probability: Probability
    """That the vehicle is there."""
    seen: bool
    """Whether this bundle's images fit the place."""


class TrackLine(_Part):
    """The result of one bundle. ``elsewhere``: the probability of none of the hypotheses.

    ``left_out``: the frame that was excluded because it contradicts the others, if any.
    """

    schema_name: Literal["skyfix.track/1"] = Field(default="skyfix.track/1", alias="schema")
    """What the document is, and its version."""
    bundle: str
    """Id of the bundle."""
    mode: Mode
    """Where it was searched for: near the places that were known ("bootstrap"), in the whole DEM, or first the one and then
    the other."""
    fix: Fix
    """What is known of the place after this bundle."""
    hypotheses: tuple[TrackHypothesis, ...]
    """All places that are still possible, the likeliest first."""
    elsewhere: Probability
    """Probability of none of the hypotheses."""
    left_out: str | None = None
    """Label of the frame that contradicts the others and was left out; null where none was."""

    def to_json(self) -> str:
        """One JSON object on one line."""
        return self.model_dump_json(by_alias=True)


def track_line(step: Step, dem: Dem) -> TrackLine:
    """The step as ``skyfix.track/1``."""
    return TrackLine(
        bundle=step.bundle,
        mode=step.mode,
        fix=step.fix,
        hypotheses=tuple(_hypothesis(p, dem) for p in step.posteriors),
        elsewhere=step.elsewhere,
        left_out=step.left_out,
    )


def _hypothesis(posterior: Posterior, dem: Dem) -> TrackHypothesis:
    at = posterior.hypothesis.place
    row, col = lonlat_to_rowcol(dem, at.lon_deg, at.lat_deg)
    easting_m, northing_m = rowcol_to_metric(dem, row, col)
    here = map_metres_at(dem, float(row), float(col))
    return TrackHypothesis(
        easting_m=float(easting_m),
        northing_m=float(northing_m),
        lat_deg=at.lat_deg,
        lon_deg=at.lon_deg,
        row=float(row),
        col=float(col),
        covariance_m2=matrix(here.ground_covariance(at.covariance) + dem.metric_accuracy_m**2 * np.eye(2)),
        probability=posterior.hypothesis.probability,
        seen=posterior.number is not None,
    )


def step_text(step: Step) -> str:
    """The step in one line, as ``20261123T043151Z-3f9a  fix        46.19901° N  122.19203° W  ...``."""
    fix = step.fix
    parts = [step.bundle, f"{fix.status:9}"]
    if fix.position is not None and fix.covariance_m2 is not None:
        axes = ellipse(fix.covariance_m2)
        parts += [
            lat_lon(fix.position),
            f"1 sigma {axes.major_m:.1f} x {axes.minor_m:.1f} m",
            f"probability {fix.probability:.3f}",
        ]
    if fix.status == "ambiguous" and len(fix.candidates) > 1:
        parts.append(f"{len(fix.candidates)} places")
    if fix.status == "none":
        kept = len(step.posteriors)
        parts.append(f"{kept} earlier {'place' if kept == 1 else 'places'} kept")
    if fix.reason is not None:
        parts.append(f"({fix.reason.code})")
    if step.left_out is not None:
        parts.append(f"without frame {step.left_out}, which contradicts the others")
    parts.append(f"({step.mode})")
    return "  ".join(parts)
