"""Uncertain vertical references: of the DEM's elevations and of the altimeter, and the notes about them."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from localizer.bundle import Bundle
from localizer.dem.geodesy import rowcol_to_lonlat
from localizer.dem.lattice import Dem
from localizer.fix import Fix, Reason
from localizer.observation import Observation

if TYPE_CHECKING:  # slow to import; printing a result does not need it
    from localizer.dem.horizon import Terrain
    from localizer.search.answer import Located

ALTITUDE_BIAS_SIGMAS = 4.0
"""An altitude bias beyond this many sigmas indicates a wrong reference rather than noise."""


def with_datum_uncertainty(observation: Observation, dem: Dem) -> Observation:
    """The observation with the uncertainty of the DEM's vertical datum added to the altitude's sigma."""
    datum_sigma_m = dem.heights.altitude_sigma_m
    if observation.altitude_m is None or not datum_sigma_m:
        return observation
    return replace(observation, altitude_sigma_m=float(np.hypot(observation.altitude_sigma_m, datum_sigma_m)))


def diagnose_altimeter(
    terrain: "Terrain",
    observation: Observation,
    fix: Fix,
    search: "Callable[[Observation], Located]",
    within_s: float = math.inf,
) -> Fix:
    """If the result is ``none``: repeat the search without the altitude, and say in the reason what that shows.

    The status stays ``none``. A search that took longer than ``within_s`` is not repeated.
    """
    if sum(fix.timing_s.values()) > within_s:
        return fix
    has_skyline = any(len(frame.u_px) > 1 for frame in observation.frames)
    if fix.status != "none" or observation.altitude_m is None or not has_skyline:
        return fix
    without = search(replace(observation, altitude_m=None, altitude_sigma_m=np.inf))
    best = without.best
    if best is None or without.decision.status == "none":
        from localizer.search.reasons import no_match  # beside the search, which is slow to import

        return fix if fix.reason is not None else fix.model_copy(update={"reason": no_match(360.0)})
    off_m = observation.altitude_m - best.altitude_m
    lon_deg, lat_deg = (float(angle) for angle in rowcol_to_lonlat(terrain.dem, best.row, best.col))
    several = "" if without.decision.status == "fix" else ", among others,"
    text = (
        f"without the altimeter the terrain fits{several} at {lat_deg:.5f}, {lon_deg:.5f} with the altitude off by "
        f"{off_m:+.0f} m ({abs(off_m) / observation.altitude_sigma_m:.1f} sigma); check the altimeter's setting and what the "
        "model's elevations count from (--geoid-offset, --vertical-unit)"
    )
    return fix.model_copy(update={"reason": Reason(code="no_ground_at_altitude", text=text)})


def reason_note(fix: Fix) -> str | None:
    """The reason of a ``none`` or of an unknown datum; None otherwise, since the result itself shows several places."""
    if fix.reason is None or not (fix.status == "none" or fix.reason.code == "unknown_datum"):
        return None
    return fix.reason.text


def altitude_note(fix: Fix, bundle: Bundle, dem: Dem) -> str | None:
    """A note on an altitude bias beyond ALTITUDE_BIAS_SIGMAS; None if there is none."""
    if fix.nuisance is None or bundle.altitude is None or fix.status == "none":
        return None
    bias_m = fix.nuisance.altitude_bias_m
    sigma_m = float(np.hypot(max(bundle.altitude.sigma_m, 0.01), dem.heights.altitude_sigma_m))
    if abs(bias_m) <= ALTITUDE_BIAS_SIGMAS * sigma_m:
        return None
    return (
        f"the altimeter reads {bias_m:+.0f} m off the place found, {abs(bias_m) / sigma_m:.1f} of its sigmas; its setting is "
        f"wrong, or the elevations ({dem.heights.name or 'of no stated vertical datum'}) count from something else: if from "
        f"the ellipsoid, say --geoid-offset {-bias_m:.0f}"
    )
