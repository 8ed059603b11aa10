"""Leave-one-out check of the frames: a frame that contradicts all others is excluded and named.

Such a frame may show another place, have a tilt that was read while the head moved, or a bank of cloud for a skyline. Robust
weights reduce the influence of single columns. A whole frame of outliers, however, shifts the fit or leaves no place at all.
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
"""Least inlier share without the frame. It is higher than for a whole bundle, because the frame was chosen so that the others
fit. Tuned on rendered bundles with one frame misread; not in docs/sensitivity.md, whose cases leave no frame out."""
LEAST_FRAMES = 3
"""Of two frames that contradict each other, neither can be identified as the wrong one."""
MOST_FRAMES_TRIED = 6
"""If a bundle with more frames fits nowhere, one frame is unlikely to be the cause."""
MOST_SUSPECTS = 2
"""If the bundle fits a place, only the frames that fit worst are tried."""
SIGMAS = 3.0
"""A column fits within so many standard deviations."""
LEAST_DEM_ERROR = 0.3
"""Least DEM error assumed, as a share of the nominal one, however well the other frames fit."""
FAR_COLUMNS = 20
"""A frame with fewer columns whose horizon is neither near nor at the DEM edge is not judged."""
SAME_ANSWER_CELLS = 5.0
"""Results without different frames agree if their places lie this close together."""


@dataclass(frozen=True)
class CheckedAnswer:
    """The result of the search, and how each frame fits it.

    ``agreement``: by label, the share of a frame's columns that fit the place; frames that cannot be judged are absent.
    ``left_out``: the label of the excluded frame.
    """

    located: Located
    agreement: Mapping[str, float]
    left_out: str | None = None


def check_frames(
    terrain: Terrain, observation: Observation, located: Located, search: Callable[[Observation], Located]
) -> CheckedAnswer:
    """Check each suspect frame by a ``search`` without it.

    The result is replaced only by a fix that all remaining frames agree with and that the excluded frame contradicts.
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
    # also for an exact DEM: an object in the foreground must not exclude a frame
    inexact = terrain.with_error_model() if terrain.exact else terrain
    shares = {
        frame.label: frame_agreement(inexact, frame, answer.best)
        for frame in observation.frames
        if len(frame.u_px) > 1
    }
    return {label: share for label, share in shares.items() if share is not None}


def frame_agreement(terrain: Terrain, frame: FrameObservation, place: Refined) -> float | None:
    """Share of a frame's columns within SIGMAS of the skyline predicted at a place; None if too few columns can be judged.

    The variance is that of the contour, of the DEM error at the horizon's distance, and of the frame's attitude by its sensors.
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
