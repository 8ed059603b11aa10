"""The places as waypoints of GPX 1.1, for navigation devices."""

from collections.abc import Sequence

import numpy as np
from gpxpy.gpx import GPX, GPXWaypoint

from localizer.bundle import Bundle
from localizer.dem.crs import wrapped_lon_deg
from localizer.fix import Fix
from localizer.show.candidates import CandidatePlace, place_description, place_name

DECIMALS = 7


def fix_gpx(places: Sequence[CandidatePlace], fix: Fix, bundle: Bundle) -> str:
    """The fix alone; all candidates where the result is ambiguous."""
    gpx = GPX()
    gpx.creator = "skyfix"
    gpx.name = bundle.id
    gpx.time = bundle.created
    shown = places[:1] if fix.status == "fix" else places
    for place in shown:
        gpx.waypoints.append(
            GPXWaypoint(
                latitude=round(place.lat_deg, DECIMALS),
                longitude=wrapped_lon_deg(round(place.lon_deg, DECIMALS)),
                elevation=round(place.ground_m, 1) if np.isfinite(place.ground_m) else None,
                time=bundle.created,
                name=place_name(place, fix.status, len(shown), bundle.id),
                description=place_description(place, fix.status),
                type=fix.status,
            )
        )
    return gpx.to_xml(version="1.1")
