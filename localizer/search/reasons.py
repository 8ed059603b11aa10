"""Why a result is no fix, in one sentence that says what would help."""

from localizer.fix import Reason
from localizer.search.fit.refine import Refined

LITTLE_SKYLINE_DEG = 40.0
"""Less of it distinguishes a place from all others in a small DEM only. A limit of the wording, not of the decision."""


def no_skyline() -> Reason:
    """No frame shows one."""
    return Reason(
        code="too_little_skyline",
        text="No frame shows a skyline that can be relied upon; take the pictures again in better light, or from a place with"
        " an open view.",
    )


def no_ground_at_altitude(altitude_m: float) -> Reason:
    """The altimeter excludes every cell."""
    return Reason(
        code="no_ground_at_altitude",
        text=f"The DEM has no ground at the camera's altitude of {altitude_m:.0f} m; check the altimeter's reference and the"
        " heights' datum, or use a DEM that covers the place.",
    )


def no_match(skyline_deg: float) -> Reason:
    """No place explains the skyline better than chance."""
    if skyline_deg < LITTLE_SKYLINE_DEG:
        return Reason(
            code="too_little_skyline",
            text=f"Only {skyline_deg:.0f} deg of skyline can be relied upon, too little to tell a place; take more directions.",
        )
    return Reason(
        code="outside",
        text="The skyline fits no place in this DEM; use one that covers the place and reaches past the ridges that are seen.",
    )


def beyond_dem() -> Reason:
    """The best place lies where the DEM has no cell."""
    return Reason(
        code="outside",
        text="The place that fits best lies beyond the end of the DEM; use a DEM that covers it.",
    )


def large_dem_error(error_m: float) -> Reason:
    """The ridges would need an error larger than is plausible for a DEM."""
    return Reason(
        code="dem_error",
        text=f"At the place that fits best the DEM's ridges would be off by {error_m:.0f} m or more; use a finer or newer DEM,"
        " or state its error.",
    )


def contradicted(best: Refined, least_inliers: float) -> Reason:
    """The readings, or too many columns, contradict the best place."""
    if best.inlier_share < least_inliers:
        return Reason(
            code="contradicted",
            text=f"At the place that fits best only {best.inlier_share:.0%} of the skyline agrees with the terrain; look for a"
            " frame that shows cloud, trees or another place.",
        )
    return Reason(
        code="contradicted",
        text="At the place that fits best the readings are off by more than their sigmas allow; check altimeter, compass and"
        " inclinometer.",
    )


def several_places(count: int) -> Reason:
    """More than one place explains the observation."""
    places = f"{count} places" if count > 1 else "The place found and others that were not compared"
    return Reason(
        code="several_places",
        text=f"{places} fit what is seen; another direction, a better heading or altitude, or a look from farther on would tell"
        " them apart.",
    )


def weak_evidence(evidence: float, wanted: float) -> Reason:
    """One place, but with too little evidence for a fix."""
    return Reason(
        code="too_little_skyline",
        text=f"One place fits, on evidence of {evidence:.1f} where {wanted:.0f} is wanted to be sure; take more directions.",
    )


def large_uncertainty(widest_m: float) -> Reason:
    """One place with too large a standard deviation."""
    return Reason(
        code="too_little_skyline",
        text=f"The place is known to {widest_m:.0f} m (one sigma) only; more directions, nearer ridges or a finer DEM would"
        " help.",
    )


def excluded_by_track() -> Reason:
    """The observation fits only places that the track excludes."""
    return Reason(
        code="contradicted",
        text="What is seen here fits none of the places that the drive allows; check the odometry, or start a new track.",
    )
