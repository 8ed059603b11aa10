"""Selects the fix that may be published: still current, with its uncertainty in true directions."""

from dataclasses import dataclass
from datetime import datetime

import numpy as np
from numpy.typing import NDArray

from localizer.dem.crs import wrapped_lon_deg
from localizer.dem.ground import map_metres
from localizer.fix import Covariance, Position, ellipse
from rig.clock import Instant
from rig.daemon.state import Answer, Snapshot


@dataclass(frozen=True)
class PublishedFix:
    """A fix for navigation. Every sigma is one standard deviation."""

    bundle: str
    captured: Instant
    """Time of position and heading."""
    lat_deg: float
    lon_deg: float
    altitude_m: float | None
    """Above the DEM's vertical datum."""
    sigma_north_m: float
    sigma_east_m: float
    sigma_major_m: float
    sigma_minor_m: float
    major_azimuth_deg: float
    """Azimuth of the ellipse's longer axis from true north, 0 to 180."""
    heading_deg: float | None
    """Of the vehicle, from true north."""

    @property
    def utc(self) -> datetime:
        """UTC of the capture."""
        return self.captured.utc

    def age_s(self, now: Instant) -> float:
        """Age since the capture, by the monotonic clock."""
        return now.monotonic_s - self.captured.monotonic_s


def current_fix(snapshot: Snapshot, now: Instant, valid_s: float) -> PublishedFix | None:
    """The fix of the latest capture, unless ``expiry_reason`` gives one.

    None if that capture gave no fix: an earlier one must not replace it.
    """
    latest = newest_answer(snapshot)
    if latest is None or latest.fix.status != "fix" or expiry_reason(latest, snapshot, now, valid_s):
        return None
    return published(latest)


def newest_answer(snapshot: Snapshot) -> Answer | None:
    """The answer to the newest capture; late answers to older bundles say nothing about the present."""
    answers = [answer for answer in (snapshot.last_fix, snapshot.last) if answer is not None]
    return max(answers, key=lambda answer: answer.captured.monotonic_s, default=None)


def expiry_reason(answer: Answer, snapshot: Snapshot, now: Instant, valid_s: float) -> str | None:
    """Why the vehicle may have left the fix's position; None while the fix is current."""
    age_s = now.monotonic_s - answer.captured.monotonic_s
    if not 0.0 <= age_s <= valid_s:
        return f"captured {age_s:.0f} s ago"
    if answer.before_start:
        return "captured before the restart, and nobody has seen since whether the vehicle moved"
    if snapshot.moved is not None and snapshot.moved.monotonic_s > answer.captured.monotonic_s:
        return "the vehicle has moved on"
    return None


def published(answer: Answer) -> PublishedFix:
    """An answer with status ``fix`` in published form."""
    position, covariance_m2 = answer.fix.position, answer.fix.covariance_m2
    if position is None or covariance_m2 is None:
        raise ValueError(f"{answer.bundle} is no fix")
    of_true_m2 = true_covariance_m2(position, covariance_m2)
    of_true_m2 = of_true_m2 + answer.wgs84_accuracy_m**2 * np.eye(2)
    (east_m2, between_m2), (_, north_m2) = of_true_m2.tolist()
    axes = ellipse(((east_m2, between_m2), (between_m2, north_m2)))
    return PublishedFix(
        bundle=answer.bundle,
        captured=answer.captured,
        lat_deg=position.lat_deg,
        lon_deg=wrapped_lon_deg(position.lon_deg),
        altitude_m=answer.altitude_m,
        sigma_north_m=float(np.sqrt(north_m2)),
        sigma_east_m=float(np.sqrt(east_m2)),
        sigma_major_m=axes.major_m,
        sigma_minor_m=axes.minor_m,
        major_azimuth_deg=axes.grid_azimuth_deg,
        heading_deg=answer.vehicle_heading_deg,
    )


def true_covariance_m2(position: Position, covariance_m2: Covariance) -> NDArray[np.float64]:
    """(2, 2) of true east and north, from a fix's along the map's axes: turned by the convergence."""
    here = map_metres(position.crs, *position.easting_northing_m)
    return here.true_covariance(covariance_m2)
