"""Searches the whole DEM for a standpoint, with and without heading, and judges the answer."""

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from pyproj import Transformer

from localizer import (
    Bundle,
    ColumnState,
    Dem,
    Observation,
    Skyline,
    find_skyline,
    frame_image,
    load_bundle,
    load_dem,
    observation_from_bundle,
    rowcol_to_metric,
)
from localizer.experiments import (
    Located,
    Refined,
    Terrain,
    ground_distance_m,
    load_kernels,
    prepare_terrain,
    search_observation,
)
from sim.evaluate.photos.standpoints import Standpoint

Floats = NDArray[np.float64]

HEADING_SIGMA_DEG = 2.0
NO_COMPASS_SIGMA_DEG = 180.0
"""By which a bundle says that there was no compass."""
UNKNOWN_TURN_DEG = 137.0
"""Without a heading the azimuths are rotated by this angle, so that nothing can use them by accident."""
TRACE_SIGMA_PX = 1.0
"""Accuracy of a hand-traced ridge."""
NEAR_CELLS, NEAR_SIGMAS = 5.0, 5.0
"""A place counts as the true one within this many cells or standard deviations (its own and the truth's)."""


HEADING_AND_ALTITUDE = {
    "found": (("2 deg", "known"), ("none", "known"), ("2 deg", "none")),
    "known": (("2 deg", "known"), ("none", "known")),
}
"""Known quantities in the searches with each skyline. Without both a search takes minutes."""


@dataclass(frozen=True)
class Trial:
    """One search of one standpoint.

    Attributes:
        skyline: "found" in the picture, or "known": traced by hand, or computed by the engine.
        heading, altitude: "2 deg" or "none"; "known" or "none".
        status: of the fix.
        error_m, sigma_m: of the best place, NaN where there is none; sigma along the covariance's longer axis.
        truth_probability: of the candidate at the true place; NaN where no candidate lies there.
        evidence, inlier_share, dem_error_m: of the best place.
        verdict: see `judge`.
    """

    dataset: str
    name: str
    skyline: str
    heading: str
    altitude: str
    status: str
    error_m: float
    sigma_m: float
    truth_probability: float
    candidates: int
    evidence: float
    inlier_share: float
    dem_error_m: float
    seconds: float
    verdict: str


@dataclass(frozen=True)
class Place:
    """A place in the terrain's metric CRS with the standard deviation along the longer axis, metres of the ground."""

    easting_m: float
    northing_m: float
    sigma_m: float


def judge(status: str, best_is_true: bool, truth_among: bool) -> str:
    """The verdict: right, WRONG (a fix elsewhere), fair (several, the truth among them), missed or none."""
    if status == "none":
        return "none"
    if status == "fix":
        return "right" if best_is_true else "WRONG"
    return "fair" if truth_among else "missed"


def is_true_place(error_m: float, sigma_m: float, truth_sigma_m: float, cell_m: float) -> bool:
    """Whether a place at this distance counts as the true one."""
    return error_m <= max(NEAR_CELLS * cell_m, NEAR_SIGMAS * math.hypot(sigma_m, truth_sigma_m))


def search(
    standpoint: Standpoint,
    terrain: Terrain | None = None,
    knowing: Mapping[str, Sequence[tuple[str, str]]] = HEADING_AND_ALTITUDE,
) -> Iterator[Trial]:
    """Search for a standpoint with each skyline and each of `knowing`.

    `knowing`: by "found" and "known", the skyline searched by; heading "2 deg" or "none", altitude "known" or "none".
    `terrain`: that of `standpoint.dem`, if it was prepared before.
    """
    terrain = terrain or terrain_of(standpoint)
    bundle = load_bundle(standpoint.bundle)
    found = [find_skyline(frame_image(bundle, frame)) for frame in bundle.frames]
    skylines = {"found": found}
    if standpoint.traced:
        skylines["known"] = [skyline_of_trace(standpoint.traced[frame.label]) for frame in bundle.frames]
    for skyline, rows in skylines.items():
        observation = observation_from_bundle(bundle, rows)
        for heading, altitude in knowing[skyline]:
            given = _with_heading(bundle, observation, standpoint, heading == "2 deg")
            if altitude == "none":
                given = replace(given, altitude_m=None, altitude_sigma_m=math.inf)
            begin = time.perf_counter()
            located = search_observation(terrain, given)
            seconds = time.perf_counter() - begin
            yield _trial(standpoint, terrain.dem, (skyline, heading, altitude), located, seconds)


def terrain_of(standpoint: Standpoint) -> Terrain:
    """The DEM of a standpoint, ready to be searched."""
    terrain = prepare_terrain(load_dem([standpoint.dem], nodata=standpoint.dem_nodata))
    load_kernels(terrain)
    return terrain


def skyline_of_trace(row_px: Floats) -> Skyline:
    """A traced skyline (width,) in the form of a found one; NaN without a trace."""
    known = np.isfinite(row_px)
    return Skyline(
        row_px=row_px,
        sigma_px=np.where(known, TRACE_SIGMA_PX, np.nan),
        confidence=known.astype(float),
        state=np.where(known, ColumnState.OK, ColumnState.DOUBTFUL).astype(np.uint8),
    )


def _with_heading(
    bundle: Bundle, observation: Observation, standpoint: Standpoint, heading: bool
) -> Observation:
    """The observation with a heading of sigma HEADING_SIGMA_DEG, or without.

    A photograph's published heading is rotated by one sigma, with a sign that depends on its name, so that the stated
    sigma is true. A rendered bundle already has a compass's errors.
    """
    if heading:
        sign = 1.0 if sum(map(ord, standpoint.name)) % 2 else -1.0
        measured = bundle.azimuth_bias_sigma_deg < NO_COMPASS_SIGMA_DEG
        turn_deg = 0.0 if measured else sign * HEADING_SIGMA_DEG
        sigma_deg = HEADING_SIGMA_DEG
    else:
        turn_deg, sigma_deg = UNKNOWN_TURN_DEG, NO_COMPASS_SIGMA_DEG
    frames = tuple(
        replace(frame, azimuth_deg=(frame.azimuth_deg + turn_deg) % 360.0) for frame in observation.frames
    )
    return replace(observation, frames=frames, azimuth_bias_sigma_deg=sigma_deg)


def _trial(
    standpoint: Standpoint, dem: Dem, given: tuple[str, str, str], located: Located, seconds: float
) -> Trial:
    to_metric = Transformer.from_crs(standpoint.crs, dem.metric_crs, always_xy=True)
    easting_m, northing_m = to_metric.transform(standpoint.easting_m, standpoint.northing_m)
    cell_m = math.sqrt(dem.spacing_ns_m * dem.spacing_ew_m)

    def off(refined: Refined) -> tuple[float, float, bool]:
        place = place_of(dem, refined)
        error_m = ground_distance_m(
            dem.metric_crs, (place.easting_m, place.northing_m), (easting_m, northing_m)
        )
        return error_m, place.sigma_m, is_true_place(error_m, place.sigma_m, standpoint.truth_sigma_m, cell_m)

    decision, best = located.decision, located.best
    error_m, sigma_m, best_is_true = off(best) if best else (math.nan, math.nan, False)
    truth = [float(p) for c, p in zip(decision.candidates, decision.probabilities, strict=True) if off(c)[2]]
    return Trial(
        standpoint.dataset,
        standpoint.name,
        *given,
        status=decision.status,
        error_m=error_m,
        sigma_m=sigma_m,
        truth_probability=sum(truth) if truth else math.nan,
        candidates=len(decision.candidates),
        evidence=best.evidence if best else math.nan,
        inlier_share=best.inlier_share if best else math.nan,
        dem_error_m=best.dem_error_m if best else math.nan,
        seconds=seconds,
        verdict=judge(decision.status, best_is_true, bool(truth)),
    )


def place_of(dem: Dem, refined: Refined) -> Place:
    """Position of a candidate."""
    easting_m, northing_m = rowcol_to_metric(dem, refined.row, refined.col)
    sigma_m = float(np.sqrt(np.linalg.eigvalsh(refined.covariance_enu_m2)[-1]))
    return Place(float(easting_m), float(northing_m), sigma_m)
