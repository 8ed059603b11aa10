"""The state that goes from bundle to bundle, and the one step that a bundle makes.

Where the last look left one place, the next is searched for near there, and in the whole DEM only if nothing convincing turns
up; where it left several, in the whole DEM.

A second look from the same spot sees the same errors as the first: what spoke for a wrong place then speaks for it again. It is
no second witness, and counts in place of the first if it explains more, else not at all.
"""

import dataclasses
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from localizer.bundle import Bundle
from localizer.dem.geodesy import lonlat_to_rowcol, rowcol_to_lonlat
from localizer.dem.horizon import Terrain
from localizer.documents import DocumentError, json_text
from localizer.errors import SkyfixError
from localizer.fix import Fix
from localizer.observation import Observation, PriorCircle
from localizer.search.altitude_reference import diagnose_altimeter, with_datum_uncertainty
from localizer.search.answer import Located, fix_of
from localizer.search.decide import (
    FIX_EVIDENCE,
    FIX_PROBABILITY,
    LARGEST_FIX_SIGMA_CELLS,
    NEGLIGIBLE,
    Decision,
    no_place,
)
from localizer.search.fit.local_optima import SAME_PLACE_CELLS
from localizer.search.fit.refine import Refined
from localizer.search.leave_one_out import CheckedAnswer, check_frames
from localizer.search.locate import locate, observe
from localizer.search.reasons import excluded_by_track, several_places
from localizer.skyline.upright import frame_skyline
from localizer.track.gaussian_place import GEOD, Place, place
from localizer.track.mixture import (
    Hypothesis,
    Look,
    Mixture,
    Posterior,
    Seen,
    mixture_of,
    outlier_probability,
    predict,
    update,
)
from localizer.track.odometry import Movement

Mode = Literal["bootstrap", "whole DEM", "whole DEM after bootstrap failed"]

COMMON_COVARIANCE_SHARE = 0.5
"""Of a look's covariance that looks from places near by may share: DEM, lens, refraction."""
UNMODELLED_ERROR_CELLS = 0.25
"""Two looks whose places differ by this much more than their sigmas say do not contradict each other."""
SAME_SPOT_CELLS, SAME_SPOT_M = 2.0, 50.0
"""Moved by less than either, a vehicle sees the same again."""
BOOTSTRAP_PROBABILITY = 0.9
"""Probability from which a place is worth a search around it alone."""
RADIUS_SIGMAS, RADIUS_CELLS = 5.0, 5.0
"""Of the circle that is searched."""
INNER_RADIUS_SHARE = 0.9
"""Of its radius: a place nearer its edge may only be the way to one outside."""
LONGEST_REPEATED_SEARCH_S = 30.0
"""A search that took longer is not made anew without the altimeter: a vehicle waits for the answer."""
WIDEST_RADIUS_SHARE = 0.25
"""Of the DEM's side: a wider circle saves nothing."""
BOOTSTRAP_EVIDENCE_SHARE = 0.95
"""A true place explains one look about as well as the next; one found near a wrong place explains less. A search near by needs
that share of the last look's evidence, or the whole DEM is asked."""


class TrackerError(SkyfixError):
    """A stored state that cannot be used."""


class Tracker(BaseModel):
    """All that goes from one bundle to the next; JSON both ways (``to_json``, ``from_json``), valid for any DEM.

    ``now`` is what is believed; ``before`` the same without the last look that counted, ``since_m`` how far (east, north) the
    vehicle went since that, and ``look_evidence`` how well the terrain explained it.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    schema_name: Literal["skyfix.tracker/1"] = Field(default="skyfix.tracker/1", alias="schema")
    now: Mixture = Mixture()
    before: Mixture = Mixture()
    since_m: tuple[float, float] | None = None
    """None: no look has counted yet, or nothing is known of the way since."""
    look_evidence: float = 0.0

    def to_json(self) -> str:
        """One JSON object on one line."""
        return self.model_dump_json(by_alias=True)

    @classmethod
    def from_json(cls, text: str | bytes) -> Self:
        """What ``to_json`` wrote. Raises ``TrackerError``."""
        try:
            return cls.model_validate_json(json_text(text))
        except DocumentError as error:
            raise TrackerError(f"state of a track: {error}; start a new track") from None
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            where = ".".join(str(part) for part in first["loc"])
            raise TrackerError(f"state of a track: {where}: {first['msg']}; start a new track") from None


@dataclass(frozen=True)
class Step:
    """What one bundle came to. ``posteriors`` are all hypotheses after it, seen by it or not; ``tracker`` the new state.

    ``best`` is the fix's place with all that was solved for there, None where there is none. ``left_out``: the label of a
    frame that contradicts the others, which the answer does without.
    """

    bundle: str
    mode: Mode
    fix: Fix
    posteriors: tuple[Posterior, ...]
    tracker: Tracker
    best: Refined | None
    left_out: str | None = None

    @property
    def elsewhere(self) -> float:
        """The probability of none of them."""
        return max(0.0, 1.0 - sum(p.hypothesis.probability for p in self.posteriors))


def follow_bundle(tracker: Tracker, leg: Movement | None, terrain: Terrain, bundle: Bundle) -> Step:
    """As ``follow``, from the pictures. Raises ``BundleError`` where one cannot be read."""
    begin = time.perf_counter()
    skylines = [frame_skyline(bundle, frame) for frame in bundle.frames]
    timing_s = {"horizon": time.perf_counter() - begin}
    return follow(tracker, leg, terrain, observe(bundle, skylines), bundle.id, timing_s)


def follow(
    tracker: Tracker,
    leg: Movement | None,
    terrain: Terrain,
    observation: Observation,
    bundle_id: str,
    timing_s: Mapping[str, float] | None = None,
) -> Step:
    """Move the hypotheses along ``leg`` (None: unknown; of no account before the first look) and look.

    A look that fits no place leaves the moved hypotheses as they are, and its own answer is ``none``. ``terrain`` is prepared
    once for all steps.
    """
    observation = with_datum_uncertainty(observation, terrain.dem)
    area_m2 = _area_m2(terrain)
    moved = _moved(tracker, leg, area_m2)
    mode, settled = _search(moved, terrain, observation)
    located = settled.located
    timing = {**(timing_s or {}), **located.timing_s}
    if located.best is None:
        fix = fix_of(terrain, observation, located, bundle_id, timing)
        fix = diagnose_altimeter(
            terrain,
            observation,
            fix,
            lambda o: locate(terrain, o, retry_all_cells=False),
            LONGEST_REPEATED_SEARCH_S,
        )
        kept = tuple(Posterior(h, None) for h in moved.now.hypotheses)
        return Step(bundle_id, mode, fix, kept, moved, None)
    decision = located.decision
    candidates = list(zip(decision.candidates, (float(p) for p in decision.probabilities), strict=True))
    look = _look(terrain, located, candidates, area_m2)
    again = moved.since_m is not None and float(np.hypot(*moved.since_m)) < _same_spot_m(terrain)
    known = moved.before if again else moved.now
    posteriors = update(known, look)
    # Without a history the search's own answer stands.
    answer = _answer(terrain, located, candidates, posteriors) if known.hypotheses else located
    fix = fix_of(terrain, observation, answer, bundle_id, timing)
    if again and located.best.evidence < moved.look_evidence:
        return Step(bundle_id, mode, fix, posteriors, moved, answer.best, settled.left_out)
    after = Tracker(
        now=mixture_of(posteriors),
        before=known,
        since_m=(0.0, 0.0),
        look_evidence=located.best.evidence,
    )
    return Step(bundle_id, mode, fix, posteriors, after, answer.best, settled.left_out)


def _moved(tracker: Tracker, leg: Movement | None, area_m2: float) -> Tracker:
    since_m = None
    if leg is not None and tracker.since_m is not None:
        since_m = (tracker.since_m[0] + float(leg.step_m[0]), tracker.since_m[1] + float(leg.step_m[1]))
    return tracker.model_copy(
        update={
            "now": predict(tracker.now, leg, area_m2),
            "before": predict(tracker.before, leg, area_m2),
            "since_m": since_m,
        }
    )


def _search(tracker: Tracker, terrain: Terrain, observation: Observation) -> tuple[Mode, CheckedAnswer]:
    """Near the one place known, if there is one, else everywhere that the bundle itself allows."""
    circle = _circle(tracker, terrain)
    if circle is None:
        return "whole DEM", _settled(terrain, observation)
    near = _settled(terrain, dataclasses.replace(observation, prior=circle))
    if _is_convincing(near.located, circle, tracker, terrain):
        return "bootstrap", near
    return "whole DEM after bootstrap failed", _settled(terrain, observation)


def _settled(terrain: Terrain, observation: Observation) -> CheckedAnswer:
    """The place, without a frame that contradicts the others."""
    located = locate(terrain, observation)
    return check_frames(
        terrain, observation, located, lambda fewer: locate(terrain, fewer, retry_all_cells=False)
    )


def _circle(tracker: Tracker, terrain: Terrain) -> PriorCircle | None:
    if not tracker.now.hypotheses:
        return None
    first = tracker.now.hypotheses[0]
    radius_m = RADIUS_SIGMAS * first.place.widest_m + RADIUS_CELLS * terrain.cell_m
    settled = first.probability >= BOOTSTRAP_PROBABILITY and first.evidence >= FIX_EVIDENCE
    if not settled or radius_m > WIDEST_RADIUS_SHARE * np.sqrt(_area_m2(terrain)):
        return None
    return PriorCircle(first.place.lat_deg, first.place.lon_deg, radius_m)


def _is_convincing(near: Located, circle: PriorCircle, tracker: Tracker, terrain: Terrain) -> bool:
    """Whether a search that saw only a circle may do without the rest of the DEM."""
    best = near.best
    if best is None or near.decision.status != "fix":
        return False
    lon_deg, lat_deg = (float(value) for value in rowcol_to_lonlat(terrain.dem, best.row, best.col))
    off_m = GEOD.inv(circle.lon_deg, circle.lat_deg, lon_deg, lat_deg)[2]
    return bool(
        off_m <= INNER_RADIUS_SHARE * circle.radius_m
        and best.evidence >= BOOTSTRAP_EVIDENCE_SHARE * tracker.look_evidence
    )


def _look(
    terrain: Terrain, located: Located, candidates: list[tuple[Refined, float]], area_m2: float
) -> Look:
    assert located.best is not None
    seen = []
    for number, (refined, probability) in enumerate(candidates):
        lon_deg, lat_deg = rowcol_to_lonlat(terrain.dem, refined.row, refined.col)
        covariance = refined.covariance_enu_m2
        at = place(float(lat_deg), float(lon_deg), covariance, COMMON_COVARIANCE_SHARE * covariance)
        seen.append(Seen(number, at, probability, refined.evidence))
    return Look(
        seen=tuple(seen),
        chance=outlier_probability(located.best.evidence),
        area_m2=area_m2,
        floor_m=UNMODELLED_ERROR_CELLS * terrain.cell_m,
        same_m=SAME_PLACE_CELLS * terrain.cell_m,
    )


def _answer(
    terrain: Terrain,
    located: Located,
    candidates: list[tuple[Refined, float]],
    posteriors: tuple[Posterior, ...],
) -> Located:
    """What the look and the history say together, of the places that this look shows: an old place is no answer."""
    shown = [
        (_refined(terrain, candidates[p.number][0], p.hypothesis.place), p.hypothesis)
        for p in posteriors
        if p.number is not None
    ]
    if not shown:
        return dataclasses.replace(located, decision=no_place(excluded_by_track()), best=None)
    best, first = shown[0]
    status: Literal["fix", "ambiguous"] = "fix" if stands_out(first, terrain.cell_m) else "ambiguous"
    kept = [shown[0], *(s for s in shown[1:] if s[1].probability >= NEGLIGIBLE)]
    probabilities = np.array([hypothesis.probability for _, hypothesis in kept])
    return dataclasses.replace(
        located,
        decision=Decision(
            status,
            [refined for refined, _ in kept],
            probabilities,
            max(0.0, 1.0 - float(probabilities.sum())),
            None if status == "fix" else located.decision.reason or several_places(len(kept)),
        ),
        best=best,
    )


def stands_out(hypothesis: Hypothesis, cell_m: float) -> bool:
    """Whether it may be called a fix, by the same measures as a single look's."""
    return (
        hypothesis.probability >= FIX_PROBABILITY
        and hypothesis.evidence >= FIX_EVIDENCE
        and hypothesis.place.widest_m <= LARGEST_FIX_SIGMA_CELLS * cell_m
    )


def _refined(terrain: Terrain, candidate: Refined, at: Place) -> Refined:
    row, col = lonlat_to_rowcol(terrain.dem, at.lon_deg, at.lat_deg)
    return dataclasses.replace(candidate, row=float(row), col=float(col), covariance_enu_m2=at.covariance)


def _same_spot_m(terrain: Terrain) -> float:
    return max(SAME_SPOT_M, SAME_SPOT_CELLS * terrain.cell_m)


def _area_m2(terrain: Terrain) -> float:
    """Of the ground that the DEM covers."""
    dem = terrain.dem
    return float(np.isfinite(dem.z_m).sum() * abs(dem.spacing_ns_m * dem.spacing_ew_m))
