"""The tracker: the state carried from bundle to bundle, and the step for one bundle (prediction, search, update).

If one place is known, the next bundle is searched for around it (bootstrap), and in the whole DEM if that result is not
convincing. If there are several places, the whole DEM is searched.

Two measurements from the same spot have the same errors, so they are not independent. The second one replaces the first if its
evidence is larger; otherwise it is not used.
"""

import dataclasses
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from localizer.bundle import Bundle
from localizer.dem.geodesy import lonlat_to_rowcol, rowcol_to_lonlat
from localizer.dem.horizon import Terrain
from localizer.dem.lattice import Dem
from localizer.dem.prepared import prepared
from localizer.documents import DocumentError, json_text
from localizer.errors import SkyfixError
from localizer.fix import Fix
from localizer.observation import Observation, PriorCircle
from localizer.search.altitude_reference import with_datum_uncertainty
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
from localizer.search.leave_one_out import CheckedAnswer
from localizer.search.locate import check_located, diagnosed_fix, load_kernels, locate, observe
from localizer.search.reasons import excluded_by_track, several_places
from localizer.skyline.upright import frame_skyline
from localizer.track.gaussian_place import GEOD, GaussianPlace, gaussian_place
from localizer.track.mixture import (
    Hypothesis,
    MeasuredPlace,
    Measurement,
    Mixture,
    Posterior,
    mixture_of,
    outlier_probability,
    predict,
    update,
)
from localizer.track.odometry import Movement

if TYPE_CHECKING:
    from localizer.track.document import TrackHypothesis

Mode = Literal["bootstrap", "whole DEM", "whole DEM after bootstrap failed"]

COMMON_COVARIANCE_SHARE = 0.5
"""Share of a measurement's covariance that measurements nearby may have in common: errors of DEM, lens and refraction."""
UNMODELLED_ERROR_CELLS = 0.25
"""Standard deviation, in cells, of errors that neither odometry nor search accounts for."""
SAME_SPOT_CELLS, SAME_SPOT_M = 2.0, 50.0
"""After a movement shorter than the larger of these, a measurement is from the same spot."""
BOOTSTRAP_PROBABILITY = 0.9
"""Probability of a place from which only its surroundings are searched."""
RADIUS_SIGMAS, RADIUS_CELLS = 5.0, 5.0
"""Radius of the circle that is searched: the sum of both."""
INNER_RADIUS_SHARE = 0.9
"""A place outside this share of the radius is not accepted: its optimum may lie outside the circle."""
LONGEST_REPEATED_SEARCH_S = 30.0
"""A search that took longer is not repeated without the altimeter, because a vehicle waits for the result."""
WIDEST_RADIUS_SHARE = 0.25
"""Largest radius as a share of the DEM's side: a larger circle saves no time."""
BOOTSTRAP_EVIDENCE_SHARE = 0.95
"""A bootstrap search needs this share of the evidence of the last measurement, or the whole DEM is searched: near a wrong place
the evidence is smaller."""


class TrackerError(SkyfixError):
    """A stored state that cannot be used."""


class Tracker(BaseModel):
    """What is believed of a vehicle's position from one bundle to the next.

    A tracker does not change: `step` returns the next one. It is JSON both ways (`to_json`, `from_json`) and valid for any
    DEM.

    Attributes
    ----------
    now : Mixture
        What is believed: the possible places, each with its probability.
    before : Mixture
        The same without the last bundle that counted.
    since_m : tuple of float, or None
        How far the vehicle went, to east and north, since that; None where that is unknown.
    look_evidence : float
        How well the terrain explained that bundle: log likelihood ratio to chance.

    See Also
    --------
    locate : One bundle by itself.
    load_odometry : What lies between the bundles, from a file.

    Notes
    -----
    The state is a mixture of Gaussians plus the probability of being elsewhere. A movement shifts and widens them; a bundle
    multiplies them with what its search found. A second bundle from the same spot has the same errors as the first, and is
    not counted as independent.

    Examples
    --------
    >>> dem = localizer.load_dem("terrain.tif")
    >>> tracker = localizer.Tracker()
    >>> for name in ["first"]:
    ...     step = tracker.step(localizer.load_bundle(f"bundles/{name}"), dem)
    ...     tracker = step.tracker
    ...     print(step.fix.status, len(step.hypotheses))
    fix 1
    >>> localizer.Tracker.from_json(tracker.to_json()) == tracker
    True
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    schema_name: Literal["skyfix.tracker/1"] = Field(default="skyfix.tracker/1", alias="schema")
    now: Mixture = Mixture()
    before: Mixture = Mixture()
    since_m: tuple[float, float] | None = None
    look_evidence: float = 0.0

    def step(
        self,
        measurement: Bundle | Observation,
        dem: Dem,
        *,
        movement: Movement | None = None,
        name: str = "observation",
    ) -> "TrackStep":
        """Move what is believed, and compare it with the next bundle.

        Parameters
        ----------
        measurement : Bundle or Observation
            The next bundle, or contours of your own.
        dem : Dem
            The elevation model.
        movement : Movement, optional
            How the vehicle moved since the last step; unknown unless given. Of no account in the first step.
        name : str, optional
            What the result calls an observation; a bundle goes by its id.

        Returns
        -------
        TrackStep
            The fix, all places that are possible now, and the tracker for the next step.

        Raises
        ------
        BundleError
            A picture of the bundle cannot be read.
        """
        terrain = prepared(dem)
        load_kernels(terrain)
        if isinstance(measurement, Bundle):
            made = follow_bundle(self, movement, terrain, measurement)
        else:
            made = follow(self, movement, terrain, measurement, name)
        from localizer.track.document import track_line  # which needs this module

        line = track_line(made, dem)
        return TrackStep(
            fix=line.fix,
            hypotheses=line.hypotheses,
            elsewhere=line.elsewhere,
            searched=line.mode,
            left_out=line.left_out,
            tracker=made.tracker,
        )

    def to_json(self) -> str:
        """The tracker as one JSON object on one line."""
        return self.model_dump_json(by_alias=True)

    @classmethod
    def from_json(cls, text: str | bytes) -> Self:
        """Read what `to_json` wrote. Raises `TrackerError`."""
        try:
            return cls.model_validate_json(json_text(text))
        except DocumentError as error:
            raise TrackerError(f"state of a track: {error}; start a new track") from None
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            where = ".".join(str(part) for part in first["loc"])
            raise TrackerError(f"state of a track: {where}: {first['msg']}; start a new track") from None


@dataclass(frozen=True)
class TrackStep:
    """What one bundle of a drive came to; what `Tracker.step` returns.

    Attributes
    ----------
    fix : Fix
        The bundle's answer, with what was believed before.
    hypotheses : tuple of TrackHypothesis
        All places that are possible now, the most probable first.
    elsewhere : float
        The probability of none of them.
    searched : str
        ``"bootstrap"`` (near the one known place), ``"whole DEM"``, or ``"whole DEM after bootstrap failed"``.
    left_out : str or None
        The label of a frame that contradicts the others, which the answer does without.
    tracker : Tracker
        What is believed now: the next step starts from it.
    """

    fix: Fix
    hypotheses: "tuple[TrackHypothesis, ...]"
    elsewhere: float
    searched: Mode
    left_out: str | None
    tracker: Tracker


@dataclass(frozen=True)
class Step:
    """The result of one bundle. ``posteriors``: all hypotheses after it, measured by it or not; ``tracker``: the new state.

    ``best``: the place of the fix with all estimated quantities, None without one. ``left_out``: the label of a frame that was
    excluded because it contradicts the others.
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
    """As ``follow``, from the bundle's pictures. Raises ``BundleError`` if one cannot be read."""
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
    """Predict the hypotheses by ``leg`` (None: unknown; ignored before the first measurement) and update them by a search.

    If the search finds no place, the predicted hypotheses are kept, and the fix is ``none``. ``terrain`` is prepared once for
    all steps.
    """
    observation = with_datum_uncertainty(observation, terrain.dem)
    area_m2 = _area_m2(terrain)
    displaced = _predicted(tracker, leg, area_m2)
    mode, checked = _search(displaced, terrain, observation)
    located = checked.located
    timing = {**(timing_s or {}), **located.timing_s}
    if located.best is None:
        fix = diagnosed_fix(terrain, observation, located, bundle_id, timing, LONGEST_REPEATED_SEARCH_S)
        kept = tuple(Posterior(h, None) for h in displaced.now.hypotheses)
        return Step(bundle_id, mode, fix, kept, displaced, None)
    decision = located.decision
    candidates = list(zip(decision.candidates, (float(p) for p in decision.probabilities), strict=True))
    measurement = _measurement(terrain, located, candidates, area_m2)
    same_spot = displaced.since_m is not None and float(np.hypot(*displaced.since_m)) < _same_spot_m(terrain)
    known = displaced.before if same_spot else displaced.now
    posteriors = update(known, measurement)
    # Without a history the result is that of the search.
    answer = _combined(terrain, located, candidates, posteriors) if known.hypotheses else located
    fix = fix_of(terrain, observation, answer, bundle_id, timing)
    if same_spot and located.best.evidence < displaced.look_evidence:
        return Step(bundle_id, mode, fix, posteriors, displaced, answer.best, checked.left_out)
    after = Tracker(
        now=mixture_of(posteriors),
        before=known,
        since_m=(0.0, 0.0),
        look_evidence=located.best.evidence,
    )
    return Step(bundle_id, mode, fix, posteriors, after, answer.best, checked.left_out)


def _predicted(tracker: Tracker, leg: Movement | None, area_m2: float) -> Tracker:
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
    """Search around the known place, if there is one, else in the whole DEM or the bundle's own prior."""
    circle = _bootstrap_circle(tracker, terrain)
    if circle is None:
        return "whole DEM", _checked_search(terrain, observation)
    bootstrap = _checked_search(terrain, dataclasses.replace(observation, prior=circle))
    if _is_convincing(bootstrap.located, circle, tracker, terrain):
        return "bootstrap", bootstrap
    return "whole DEM after bootstrap failed", _checked_search(terrain, observation)


def _checked_search(terrain: Terrain, observation: Observation) -> CheckedAnswer:
    """Search, with the leave-one-out check of the frames."""
    return check_located(terrain, observation, locate(terrain, observation))


def _bootstrap_circle(tracker: Tracker, terrain: Terrain) -> PriorCircle | None:
    if not tracker.now.hypotheses:
        return None
    first = tracker.now.hypotheses[0]
    radius_m = RADIUS_SIGMAS * first.place.widest_m + RADIUS_CELLS * terrain.cell_m
    checked = first.probability >= BOOTSTRAP_PROBABILITY and first.evidence >= FIX_EVIDENCE
    if not checked or radius_m > WIDEST_RADIUS_SHARE * np.sqrt(_area_m2(terrain)):
        return None
    return PriorCircle(first.place.lat_deg, first.place.lon_deg, radius_m)


def _is_convincing(bootstrap: Located, circle: PriorCircle, tracker: Tracker, terrain: Terrain) -> bool:
    """Whether a bootstrap result is accepted without a search of the whole DEM."""
    best = bootstrap.best
    if best is None or bootstrap.decision.status != "fix":
        return False
    lon_deg, lat_deg = (float(value) for value in rowcol_to_lonlat(terrain.dem, best.row, best.col))
    off_m = GEOD.inv(circle.lon_deg, circle.lat_deg, lon_deg, lat_deg)[2]
    return bool(
        off_m <= INNER_RADIUS_SHARE * circle.radius_m
        and best.evidence >= BOOTSTRAP_EVIDENCE_SHARE * tracker.look_evidence
    )


def _measurement(
    terrain: Terrain, located: Located, candidates: list[tuple[Refined, float]], area_m2: float
) -> Measurement:
    assert located.best is not None
    seen = []
    for number, (refined, probability) in enumerate(candidates):
        lon_deg, lat_deg = rowcol_to_lonlat(terrain.dem, refined.row, refined.col)
        covariance = refined.covariance_enu_m2
        at = gaussian_place(float(lat_deg), float(lon_deg), covariance, COMMON_COVARIANCE_SHARE * covariance)
        seen.append(MeasuredPlace(number, at, probability, refined.evidence))
    return Measurement(
        measured=tuple(seen),
        outlier_probability=outlier_probability(located.best.evidence),
        area_m2=area_m2,
        model_error_m=UNMODELLED_ERROR_CELLS * terrain.cell_m,
        same_m=SAME_PLACE_CELLS * terrain.cell_m,
    )


def _combined(
    terrain: Terrain,
    located: Located,
    candidates: list[tuple[Refined, float]],
    posteriors: tuple[Posterior, ...],
) -> Located:
    """Posterior of the places that this bundle measured; hypotheses that it did not measure are no result."""
    measured = [
        (_at_posterior(terrain, candidates[p.number][0], p.hypothesis.place), p.hypothesis)
        for p in posteriors
        if p.number is not None
    ]
    if not measured:
        return dataclasses.replace(located, decision=no_place(excluded_by_track()), best=None)
    best, first = measured[0]
    status: Literal["fix", "ambiguous"] = "fix" if stands_out(first, terrain.cell_m) else "ambiguous"
    kept = [measured[0], *(s for s in measured[1:] if s[1].probability >= NEGLIGIBLE)]
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
    """Whether a hypothesis is a fix, by the same criteria as a single search."""
    return (
        hypothesis.probability >= FIX_PROBABILITY
        and hypothesis.evidence >= FIX_EVIDENCE
        and hypothesis.place.widest_m <= LARGEST_FIX_SIGMA_CELLS * cell_m
    )


def _at_posterior(terrain: Terrain, candidate: Refined, at: GaussianPlace) -> Refined:
    row, col = lonlat_to_rowcol(terrain.dem, at.lon_deg, at.lat_deg)
    return dataclasses.replace(candidate, row=float(row), col=float(col), covariance_enu_m2=at.covariance)


def _same_spot_m(terrain: Terrain) -> float:
    return max(SAME_SPOT_M, SAME_SPOT_CELLS * terrain.cell_m)


def _area_m2(terrain: Terrain) -> float:
    """Area that the DEM covers."""
    dem = terrain.dem
    return float(np.isfinite(dem.z_m).sum() * abs(dem.spacing_ns_m * dem.spacing_ew_m))
