"""A fix as text, with its error if the truth is known."""

import numpy as np

from localizer.bundle import Bundle
from localizer.dem.crs import readable_name
from localizer.dem.geodesy import meridian_convergence_deg
from localizer.dem.ground import ground_offset_m, map_metres
from localizer.dem.lattice import Dem
from localizer.fix import Fix, Position, ellipse, lat_lon
from localizer.search.altitude_reference import altitude_note, reason_note
from localizer.search.details import INCONSISTENT_BELOW, LocateDetails, LocateResult
from localizer.truth import Truth

CHI2_95 = 5.991
"""95 % quantile of the chi-square distribution with two degrees of freedom: the 95 % ellipse."""

NOTED_DEM_EDGE_SHARE = 0.2
NOTED_SCALE = 0.01
"""A map scale that differs from 1 by more is noted."""


def sigmas_off(fix: Fix, truth: Truth, dem: Dem) -> float:
    """The error of a fix in its own standard deviations (Mahalanobis distance)."""
    assert fix.position is not None
    assert fix.covariance_m2 is not None
    off_m = ground_offset_m(dem.metric_crs, fix.position.easting_northing_m, truth.metric(dem))
    return float(np.sqrt(off_m @ np.linalg.solve(np.array(fix.covariance_m2), off_m)))


def fix_text(fix: Fix, dem: Dem, truth: Truth | None = None) -> str:
    """The fix in lines for people to read."""
    lines = [f"bundle      {fix.bundle}", f"status      {STATUS_IN_WORDS[fix.status]}"]
    if fix.reason is not None:
        lines.append(f"reason      {fix.reason.text}")
    if fix.position is not None:
        lines += _position_lines(fix, fix.position, dem)
    if fix.position is not None and truth is not None:
        lines.append(
            f"true error  {truth.distance_m(fix.position, dem):.1f} m  ({_error_in_sigmas(fix, truth, dem)})"
        )
    lines += [
        f"{'candidate' if i else 'candidates':11} {c.easting_m:.1f} E  {c.northing_m:.1f} N  "
        f"probability {c.probability:.3f}  rms {c.rms_px:.2f} px"
        for i, c in enumerate(fix.candidates)
    ]
    lines += _search_lines(fix)
    return "\n".join(lines)


def notes(result: LocateResult, bundle: Bundle, dem: Dem) -> list[str]:
    """Notes for users beside the fix, one line each: on single frames, and on possible causes of a ``none``."""
    said = frame_notes(result.details)
    errors, stage1 = result.details.errors, result.fix.stage1
    if dem.error_m == 0.0 and errors is not None and errors.dem_error_m > 0.0:
        said.append(
            "the DEM does not explain the frames as the terrain itself would (--dem-error 0); its error was estimated instead"
        )
    looked = any(np.count_nonzero(frame.used) > 1 for frame in result.details.frames)
    empty = result.fix.status == "none" and looked and stage1.after_altitude == 0
    if empty:
        where = "in the DEM" if bundle.prior is None else "in the circle of the bundle's prior"
        said.append(
            f"no ground {where} lies as high as the altitude and the mast's height say; check these, the unit of the DEM's "
            f"elevations{'' if bundle.prior is None else ', and the prior'}"
        )
    if fix_note := altitude_note(result.fix, bundle, dem):
        said.append(fix_note)
    reason = (
        reason_note(result.fix) if dem.shift.known else None
    )  # the DEM's own notes say what is not known of it
    if reason is not None and not (empty and _is_redundant(reason, bundle)):
        said.append(reason)
    return said


def _is_redundant(reason: str, bundle: Bundle) -> bool:
    """Whether a reason only says that no ground lies at the altitude, which another note says already."""
    from localizer.search.reasons import no_ground_at_altitude  # beside the search, which is slow to import

    return bundle.altitude is not None and reason == no_ground_at_altitude(bundle.altitude.value_m).text


def frame_notes(details: LocateDetails) -> list[str]:
    """Notes on single frames, one line each; none if all frames were used and agree."""
    notes = []
    for frame in details.frames:
        share = "" if frame.agreement is None else f"{100.0 * frame.agreement:.0f} %"
        if np.count_nonzero(frame.used) < 2:
            notes.append(f"frame {frame.label}: no usable skyline was found in it")
        elif frame.left_out:
            notes.append(
                f"frame {frame.label}: left out, for it contradicts the others; {share} of its skyline fits the place "
                "that they agree on; look at its picture, azimuth, tilt and roll"
            )
        elif frame.agreement is not None and frame.agreement < INCONSISTENT_BELOW:
            notes.append(f"frame {frame.label}: only {share} of its skyline fits the place found")
        if frame.dem_edge_share > NOTED_DEM_EDGE_SHARE:
            notes.append(
                f"frame {frame.label}: {frame.dem_edge_share:.0%} of its horizon lies where the DEM ends or has voids, and "
                "is not used; a larger DEM would help"
            )
    return notes


STATUS_IN_WORDS = {
    "fix": "fix: one place stands out",
    "ambiguous": "ambiguous: several places fit, or one that is poorly known",
    "none": "none: the frames fit no place in this DEM",
}


def _datum(dem: Dem) -> str:
    """Datum of latitudes and longitudes, and its accuracy."""
    if not dem.shift.known:
        return "not on WGS84: the DEM's datum is not known"
    return f"WGS84, datum good to {dem.shift.accuracy_m:g} m" if dem.shift.accuracy_m else "WGS84"


def _error_in_sigmas(fix: Fix, truth: Truth, dem: Dem) -> str:
    return "no sigma" if fix.covariance_m2 is None else f"{sigmas_off(fix, truth, dem):.1f} sigma"


def _map_name(position: Position, dem: Dem) -> str:
    """The map's name, and its scale if that differs noticeably from 1."""
    name = readable_name(dem.metric_crs)
    scale = map_metres(dem.metric_crs, *position.easting_northing_m).scale
    return (
        name if abs(scale - 1.0) < NOTED_SCALE else f"{name}; a metre of this map is {1.0 / scale:.2f} m here"
    )


def _position_lines(fix: Fix, position: Position, dem: Dem) -> list[str]:
    lines = [
        f"position    {lat_lon(position)}  ({_datum(dem)})",
        f"            {position.easting_m:.1f} E  {position.northing_m:.1f} N  ({_map_name(position, dem)})",
        f"            row {position.row:.2f}  col {position.col:.2f}  ground {position.ground_m:.1f} m",
    ]
    if fix.covariance_m2 is not None:
        axes = ellipse(fix.covariance_m2)
        convergence_deg = float(meridian_convergence_deg(dem, position.row, position.col))
        azimuth_deg = (axes.grid_azimuth_deg + convergence_deg) % 180.0
        lines.append(
            f"1 sigma     {axes.major_m:.1f} m x {axes.minor_m:.1f} m, the longer towards {azimuth_deg:.0f}° true"
        )
    lines.append(f"probability {fix.probability:.3f}")
    return lines


def _search_lines(fix: Fix) -> list[str]:
    stage1 = fix.stage1
    stage1_steps = [f"{stage1.cells} cells", f"altitude {stage1.after_altitude}"]
    stage1_steps += [f"{label} {left}" for label, left in stage1.after.items()]
    lines = [f"stage 1     {' > '.join(stage1_steps)}  ({stage1.points_explored} points explored)"]
    if fix.residual:
        residual = "  ".join(f"{label} {value:.2f}" for label, value in fix.residual.items())
        lines.append(f"residual    {residual}  px")
    if fix.nuisance is not None:
        altitude_bias_m = fix.nuisance.altitude_bias_m  # exactly 0 where there is no altimeter
        altitude = f"  altitude {altitude_bias_m:+.1f} m" if altitude_bias_m else ""
        lines.append(
            f"biases      azimuth {fix.nuisance.azimuth_bias_deg:+.3f}°  tilt {fix.nuisance.tilt_bias_deg:+.3f}°{altitude}"
        )
    timing = "  ".join(f"{part} {seconds:.2f}" for part, seconds in fix.timing_s.items())
    lines.append(f"time        {timing}  s")
    return lines
