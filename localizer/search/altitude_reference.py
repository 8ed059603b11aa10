"""What the DEM's datum and the altimeter's reference leave in doubt of an answer, and how that is said."""

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

if TYPE_CHECKING:  # slow to import, and who only prints needs none of it
    from localizer.dem.horizon import Terrain
    from localizer.search.answer import Located

ALTITUDE_BIAS_SIGMAS = 4.0
"""An altimeter so far off is not scattered but referred to something else."""


def with_datum_uncertainty(observation: Observation, dem: Dem) -> Observation:
    """The altitude as far as it can be compared with the DEM's elevations, where these count from the ellipsoid."""
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
    """What the frames say once the altitude is left out, where they fit no place with it. The answer stays ``none``.

    Where the search took longer than ``within_s``, it is not made anew.
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
    """Why there is no place, or none on WGS84; None of several places, which the answer itself shows."""
    if fix.reason is None or not (fix.status == "none" or fix.reason.code == "unknown_datum"):
        return None
    return fix.reason.text


def altitude_note(fix: Fix, bundle: Bundle, dem: Dem) -> str | None:
    """A bias of the altimeter beyond what its sigma allows; None where there is none."""
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
