"""A frame that contradicts the others: left out where the others agree on one place without it, and named.

Its picture may show another place, its tilt may have been read while the head moved, its skyline may be a bank of cloud. The
search weighs single columns down, but a whole frame of them pulls the fit away or leaves no place at all.
"""

import dataclasses
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from localizer.dem.horizon import Terrain, at_dem_edge, horizon
from localizer.observation import FrameObservation, Observation
from localizer.search.answer import Located
from localizer.search.contours import frame_contour
from localizer.search.decide import FIX_EVIDENCE
from localizer.search.details import INCONSISTENT_BELOW
from localizer.search.fit.refine import Refined

LEAST_INLIERS = 0.75
"""The others must fit better than is asked of a whole bundle: one of several was picked for them to do so."""
LEAST_FRAMES = 3
"""Of two frames that contradict each other none is the wrong one."""
MOST_FRAMES_TRIED = 6
"""Where a bundle of more frames fits nowhere, its one bad frame is not what is wrong."""
MOST_SUSPECTS = 2
"""Where it fits somewhere, the frames that fit worst are tried."""
SIGMAS = 3.0
LEAST_DEM_ERROR = 0.3
"""Of what is usual for a DEM of its kind, however well the others fit."""
FAR_COLUMNS = 20
"""A frame with fewer columns whose horizon a DEM can tell, neither close by nor where it ends, is not judged."""
SAME_ANSWER_CELLS = 5.0


@dataclass(frozen=True)
class CheckedAnswer:
    """The search's answer and what became of the frames.

    ``agreement``: by label, the share of a frame's columns that fit the place found; without frames that cannot be judged.
    ``left_out``: the label of the frame that the answer does without.
    """

    located: Located
    agreement: Mapping[str, float]
    left_out: str | None = None


def check_frames(
    terrain: Terrain, observation: Observation, located: Located, search: Callable[[Observation], Located]
) -> CheckedAnswer:
    """Look for a frame that contradicts the others, and for the place without it by ``search``.

    The answer is replaced only by a fix that all remaining frames agree on and that the frame left out contradicts.
    """
    agreement = _agreements(terrain, observation, located)
    unchanged = CheckedAnswer(located, agreement)
    seeing = [frame.label for frame in observation.frames if len(frame.u_px) > 1]
    if located.best is None:
        suspects = seeing if len(seeing) <= MOST_FRAMES_TRIED else []
    else:
        doubtful = located.decision.status != "fix"
        suspects = [label for label in seeing if doubtful or agreement.get(label, 1.0) < INCONSISTENT_BELOW]
        suspects = sorted(suspects, key=lambda label: agreement.get(label, 1.0))[:MOST_SUSPECTS]
    if len(seeing) < LEAST_FRAMES or not suspects:
        return unchanged
    answers = []
    for label in suspects:
        others = tuple(frame for frame in observation.frames if frame.label != label)
        answer = search(dataclasses.replace(observation, frames=others))
        shares = _agreements(terrain, observation, answer)
        if _is_convincing(answer, shares, label, len(suspects)):
            answers.append(CheckedAnswer(answer, shares, label))
    places = [(s.located.best.row, s.located.best.col) for s in answers if s.located.best is not None]
    if not places or max(math.dist(places[0], p) for p in places) > SAME_ANSWER_CELLS:
        return unchanged
    return max(answers, key=lambda s: s.located.best.evidence if s.located.best is not None else 0.0)


def _is_convincing(answer: Located, shares: Mapping[str, float], left_out: str, tried: int) -> bool:
    best = answer.best
    return (
        best is not None
        and answer.decision.status == "fix"
        and best.evidence >= FIX_EVIDENCE + math.log(tried)
        and best.inlier_share >= LEAST_INLIERS
        and all((share < INCONSISTENT_BELOW) == (label == left_out) for label, share in shares.items())
        and left_out in shares
    )


def _agreements(terrain: Terrain, observation: Observation, answer: Located) -> dict[str, float]:
    if answer.best is None:
        return {}
    # even where the DEM is said to be the terrain: no frame goes because a stone stands before it
    inexact = terrain.with_error_model() if terrain.exact else terrain
    shares = {
        frame.label: frame_agreement(inexact, frame, answer.best)
        for frame in observation.frames
        if len(frame.u_px) > 1
    }
    return {label: share for label, share in shares.items() if share is not None}


def frame_agreement(terrain: Terrain, frame: FrameObservation, place: Refined) -> float | None:
    """Share of a frame's columns within three sigmas of the skyline seen from a place; None where too few can tell.

    Sigma is made up of the column's own, the DEM's error at that distance, and the frame's own errors by its sensors.
    """
    contour = frame_contour(frame)
    azimuth_rad, elevation_rad = contour.directions(
        frame.azimuth_deg - place.azimuth_bias_deg, frame.tilt_deg - place.tilt_bias_deg, frame.roll_deg
    )
    azimuth_deg = np.degrees(azimuth_rad)
    aside = max(frame.azimuth_sigma_deg, 0.01)
    seen, distance_m = horizon(terrain, place.row, place.col, place.altitude_m, azimuth_deg)
    beside = [
        horizon(terrain, place.row, place.col, place.altitude_m, azimuth_deg + side)[0][0]
        for side in (-aside, aside)
    ]
    far = (distance_m[0] >= terrain.near_m) & ~at_dem_edge(
        terrain, place.row, place.col, azimuth_rad, distance_m[0]
    )
    if np.count_nonzero(far) < FAR_COLUMNS:
        return None
    by_azimuth = np.radians(np.maximum(abs(beside[0] - seen[0]), abs(beside[1] - seen[0])))
    by_roll = np.radians(frame.roll_sigma_deg) * abs(frame.u_px - frame.camera.cx_px) / frame.camera.fx_px
    with np.errstate(invalid="ignore"):
        by_dem = np.nan_to_num(
            max(place.dem_error_m, LEAST_DEM_ERROR * terrain.nominal_error_m) / distance_m[0]
        )
    variance = contour.sigma_rad**2 + by_dem**2 + by_azimuth**2 + by_roll**2
    sigma = np.sqrt(variance + np.radians(frame.tilt_sigma_deg) ** 2)
    fits = np.abs(elevation_rad - np.radians(seen[0])) < SIGMAS * sigma
    return float(fits[far].mean())
