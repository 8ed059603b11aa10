"""Response models of the HTTP API, as OpenAPI describes them. Times are UTC, ages and durations seconds."""

from datetime import datetime
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from localizer.dem.ground import MapError, map_metres
from localizer.fix import Fix, Status
from localizer.track.document import TrackHypothesis
from localizer.track.tracker import Mode
from rig.clock import Instant
from rig.daemon.publish.published import expiry_reason, newest_answer
from rig.daemon.spool.index import BundleState, Entry
from rig.daemon.state import (
    Activity,
    Answer,
    DeviceState,
    Event,
    EventKind,
    Snapshot,
    TriggerAnswer,
    TriggerSource,
)
from rig.version import __version__

MAX_HYPOTHESES = 50


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True)


class Problem(_Part):
    """Why something was not done, in a sentence."""

    detail: str


class BundleAnswer(_Part):
    """What one bundle came to; all of it is of the moment of the capture. Hypotheses: the likeliest ones."""

    bundle: str
    captured: datetime
    answered: datetime
    trigger: TriggerSource
    mode: Mode
    fix: Fix
    hypotheses: tuple[TrackHypothesis, ...]
    elsewhere: float
    """The probability of none of the hypotheses."""
    altitude_m: float | None
    """Of the camera, above the DEM's vertical datum."""
    vehicle_heading_deg: float | None
    """From true north."""
    vehicle_heading_sigma_deg: float | None
    wgs84_accuracy_m: float
    """What latitude and longitude are the more uncertain by than the fix's covariance says, by the way from the DEM's datum."""


class LatestAnswer(BundleAnswer):
    """The same at the moment of asking."""

    age_s: float
    """Since the capture."""
    current: bool
    """A fix not older than ``valid_s``, and no motion of the vehicle since: only then it may still be valid."""
    valid_s: float
    map_from_ground: tuple[tuple[float, float], tuple[float, float]] | None
    """From metres of the ground along the map's axes, as in ``covariance_m2``, to metres of easting and northing."""
    convergence_deg: float | None
    """Of the map's north from true north, clockwise."""
    before_start: bool
    """Captured before the daemon started: motion since then is unknown, so it is not current."""
    moved_on: bool
    """The vehicle has moved since the capture. False proves nothing without motion detection."""


class FixAnswer(LatestAnswer):
    """The newest answer, and the last known position beside it where it is none itself."""

    last_fix: LatestAnswer | None
    """The latest fix where this is no fix, possibly of long ago: see its age. It is not current."""


class Device(_Part):
    """One device of the rig."""

    name: str
    state: DeviceState
    detail: str
    since: datetime
    for_s: float


class State(_Part):
    """Everything at this moment."""

    version: str
    """Of skyfix."""

    now: datetime
    started: datetime
    up_s: float
    activity: Activity
    activity_for_s: float
    locating: str | None
    """The bundle that is being searched for."""
    waiting: int
    """Bundles that have not been located yet."""
    storage: str | None
    """Why the spool takes no further bundle; null where it does."""
    degraded: bool
    """A device that should work does not."""
    devices: tuple[Device, ...]
    last: LatestAnswer | None
    """The answer to the newest capture that has one, whatever its status."""
    last_fix: LatestAnswer | None
    """The latest answer that is a fix, possibly of long ago: see its age."""
    counts: dict[str, int]
    """What has happened so often since the start."""
    valid_s: float
    """A fix is current for so long."""
    can_act: bool
    """Whether there is a token at all: without one ``POST /capture`` is refused to all."""


class BundleItem(_Part):
    """One bundle of the spool's index."""

    number: int
    """Counts up with each bundle taken in."""
    id: str
    captured: datetime
    trigger: TriggerSource
    state: BundleState
    tries: int
    reason: str | None
    """Why its search failed the last time."""
    size_bytes: int
    here: bool
    """Whether its frames are still in the spool."""
    status: Status | None
    """Its answer's."""


class TrackPoint(_Part):
    """A fix of the past."""

    bundle: str
    captured: datetime
    crs: str
    easting_m: float
    northing_m: float
    lat_deg: float
    lon_deg: float
    covariance_m2: tuple[tuple[float, float], tuple[float, float]]


class MapSheet(_Part):
    """A picture of the whole DEM: which rectangle of which metric CRS it shows, north up, and where it is."""

    crs: str
    west_m: float
    east_m: float
    south_m: float
    north_m: float
    width_px: int
    height_px: int
    lowest_m: float
    highest_m: float
    scales: tuple[float, ...]
    """Metres of the map in a metre of the ground, at even steps from the sheet's north to its south."""
    image: str
    """Path on this server; another one for another picture."""


class LogEvent(_Part):
    """Something that happened."""

    number: int
    kind: EventKind
    at: datetime
    data: dict[str, Any]


class CaptureAnswer(_Part):
    """A capture has begun."""

    answer: Literal["started"]


TRIGGER_STATUS: dict[TriggerAnswer, int] = {"started": 202, "busy": 409, "not ready": 503, "stopping": 503}
TRIGGER_PROBLEM: dict[TriggerAnswer, str] = {
    "busy": "busy: a capture is going on; ask again when it has ended",
    "not ready": "not ready",
    "stopping": "stopping: the daemon ends",
}


def age_s(moment: Instant, now: Instant) -> float:
    """Seconds from then to now; never less than nothing."""
    return max(0.0, now.monotonic_s - moment.monotonic_s)


def _answer_fields(answer: Answer) -> dict[str, Any]:
    return {
        "bundle": answer.bundle,
        "captured": answer.captured.utc,
        "answered": answer.answered.utc,
        "trigger": answer.trigger,
        "mode": answer.mode,
        "fix": answer.fix,
        "hypotheses": answer.hypotheses[:MAX_HYPOTHESES],
        "elsewhere": answer.elsewhere,
        "altitude_m": answer.altitude_m,
        "vehicle_heading_deg": answer.vehicle_heading_deg,
        "vehicle_heading_sigma_deg": answer.vehicle_heading_sigma_deg,
        "wgs84_accuracy_m": answer.wgs84_accuracy_m,
    }


def bundle_answer(answer: Answer) -> BundleAnswer:
    """An answer as response model."""
    return BundleAnswer(**_answer_fields(answer))


def latest_answer(answer: Answer, snapshot: Snapshot, valid_s: float, now: Instant) -> LatestAnswer:
    """One of the snapshot's answers with its age and validity."""
    moved, place = snapshot.moved, answer.fix.position
    try:
        here = None if place is None else map_metres(place.crs, place.easting_m, place.northing_m)
    except MapError:  # stored by another version
        here = None
    return LatestAnswer(
        **_answer_fields(answer),
        age_s=age_s(answer.captured, now),
        current=answer.fix.status == "fix" and expiry_reason(answer, snapshot, now, valid_s) is None,
        valid_s=valid_s,
        before_start=answer.before_start,
        map_from_ground=None if here is None else _matrix(here.map_from_ground),
        convergence_deg=None if here is None else here.convergence_deg,
        moved_on=moved is not None and moved.monotonic_s > answer.captured.monotonic_s,
    )


def fix_answer(answer: Answer, snapshot: Snapshot, valid_s: float, now: Instant) -> FixAnswer:
    """The newest of the snapshot's answers, and the last fix where that is another."""
    before = snapshot.last_fix if answer.fix.status != "fix" else None
    last_fix = None
    if before is not None:  # a newer capture exists, so it is not current at any age
        last_fix = latest_answer(before, snapshot, valid_s, now).model_copy(update={"current": False})
    return FixAnswer(**dict(latest_answer(answer, snapshot, valid_s, now)), last_fix=last_fix)


def _matrix(values: NDArray[np.float64]) -> tuple[tuple[float, float], tuple[float, float]]:
    (a, b), (c, d) = values.tolist()
    return (a, b), (c, d)


def state_of(snapshot: Snapshot, valid_s: float, can_act: bool, now: Instant) -> State:
    """The daemon state's snapshot with ages."""

    def latest(answer: Answer | None) -> LatestAnswer | None:
        return latest_answer(answer, snapshot, valid_s, now) if answer else None

    return State(
        version=__version__,
        storage=snapshot.storage,
        now=now.utc,
        started=snapshot.started.utc,
        up_s=age_s(snapshot.started, now),
        activity=snapshot.activity,
        activity_for_s=age_s(snapshot.activity_since, now),
        locating=snapshot.locating,
        waiting=snapshot.waiting,
        degraded=snapshot.degraded,
        devices=tuple(
            Device(
                name=device.name,
                state=device.state,
                detail=device.detail,
                since=device.since.utc,
                for_s=age_s(device.since, now),
            )
            for device in snapshot.devices
        ),
        last=latest(newest_answer(snapshot)),
        last_fix=latest(snapshot.last_fix),
        counts=dict(snapshot.counts),
        valid_s=valid_s,
        can_act=can_act,
    )


def bundle_item(entry: Entry) -> BundleItem:
    """A row of the index."""
    return BundleItem(
        number=entry.number,
        id=entry.bundle,
        captured=entry.answer.captured.utc if entry.answer else entry.captured,
        trigger=entry.trigger,
        state=entry.state,
        tries=entry.tries,
        reason=entry.reason,
        size_bytes=entry.size_bytes,
        here=entry.here,
        status=entry.answer.fix.status if entry.answer else None,
    )


def track_point(entry: Entry) -> TrackPoint | None:
    """A bundle's fix as track point; None if it is no fix."""
    answer = entry.answer
    if answer is None or answer.fix.status != "fix":
        return None
    position, covariance_m2 = answer.fix.position, answer.fix.covariance_m2
    assert position is not None
    assert covariance_m2 is not None
    return TrackPoint(
        bundle=entry.bundle,
        captured=answer.captured.utc,
        crs=position.crs,
        easting_m=position.easting_m,
        northing_m=position.northing_m,
        lat_deg=position.lat_deg,
        lon_deg=position.lon_deg,
        covariance_m2=covariance_m2,
    )


def log_event(event: Event) -> LogEvent:
    """An event as JSON."""
    return LogEvent(number=event.number, kind=event.kind, at=event.at.utc, data=dict(event.data))
