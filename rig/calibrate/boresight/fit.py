"""Fit of the boresight: the camera's mounting in the head, from the DEM's skyline at a known place.

Unknowns: azimuth, tilt and roll of the camera in the head, and the heading offset. Nuisance parameters with priors: the
camera's position, the azimuth error of each pan stop and the tilt error of each frame. Camera azimuth and heading
offset are separated by frames of one ridge at several tilts; their sum is determined best.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rig.attitude.kinematics import Attitude, wrapped_deg
from rig.calibrate.boresight.coarse_alignment import align_coarsely
from rig.calibrate.boresight.dem_error_model import covariance_deg2, fit_dem_error_model
from rig.calibrate.boresight.horizon_profile import HorizonProfile
from rig.calibrate.boresight.known_place import PlaceSigmas
from rig.calibrate.boresight.skyline_frame import Points, SkylineFrame
from rig.calibrate.least_squares import Solved, solve
from rig.config.calibration_files import CalibrationError

Vector = NDArray[np.float64]

MIN_FRAMES = 3
MIN_SHARE = 0.25
MISFIT_LIMIT_DEG = 0.2
MISFIT_SIGMAS = 3.0
DEM_FACTOR_LIMIT = 5.0
TILT_SIGMA_LIMIT_DEG = 0.05
PLACE_SIGMAS = 4.0
BORESIGHT_PRIOR_DEG = 30.0
MAD_TO_SIGMA = 1.4826
ROUNDS = 12
CONVERGED_DEG = 1e-4
TRACED_SIGMA_DEG = 0.01
"""Systematic error of the traced skyline: a bright sky shifts it by a tenth of a pixel, which averaging over points
does not reduce.
"""


@dataclass(frozen=True)
class BoresightFit:
    """Camera mounting in the head, and correction of headings.

    ``covariance_deg2`` (3, 3) is of the sum of these two azimuths, of tilt and of roll. ``off_m`` is east, north, up of
    the fitted position from the given one. ``dem_factor`` is the actual DEM error over the stated one. Per point: frame
    number, observed azimuth and elevation, and residual, degrees.
    """

    boresight: Attitude
    heading_offset_deg: float
    covariance_deg2: Vector
    off_m: tuple[float, float, float]
    misfit_deg: float
    misfit_sigmas: float
    dem_factor: float
    frame: NDArray[np.int64]
    azimuth_deg: Vector
    elevation_deg: Vector
    residual_deg: Vector


def fit_boresight(
    frames: Sequence[SkylineFrame],
    profile: HorizonProfile,
    start: Attitude,
    heading_sigma_deg: float,
    place: PlaceSigmas,
) -> BoresightFit:
    """Fit. ``CalibrationError`` if the skyline is hidden, or does not match the DEM's."""
    _require_skyline(frames)
    search_deg = min(max(4.0 * heading_sigma_deg, 40.0), 180.0)
    shift_deg, tilt_deg, roll_deg = align_coarsely(Points(frames), profile, start, search_deg)
    frames = _inside_dem(frames, profile, start, shift_deg)
    points = Points(frames)
    stops = max(frame.stop for frame in frames) + 1
    boresight = np.array([start.azimuth_deg, start.tilt_deg, start.roll_deg])
    # A large rotation is attributed to the camera up to the range of its prior, the rest to the heading.
    of_camera_deg = shift_deg if abs(shift_deg) < 40.0 else 0.0
    own = np.zeros(stops + len(frames))
    first = np.concatenate(
        [
            boresight + np.array([of_camera_deg, tilt_deg, roll_deg]),
            [shift_deg - of_camera_deg, 0.0, 0.0, 0.0],
            own,
        ]
    )
    stop_sigmas = {frame.stop: frame.azimuth_sigma_deg for frame in frames}
    prior_sigmas = np.concatenate(
        [
            np.full(3, BORESIGHT_PRIOR_DEG),
            [heading_sigma_deg, place.horizontal_m, place.horizontal_m, place.altitude_m],
            [stop_sigmas[stop] for stop in range(stops)],
            [frame.tilt_sigma_deg for frame in frames],
        ]
    )
    priors_at = np.concatenate([boresight, np.zeros(4), own])

    def residuals(unknowns: Vector) -> _Residuals:
        turns_deg = unknowns[3] + unknowns[7 : 7 + stops][points.stop]
        azimuth, elevation = points.seen(Attitude(*unknowns[:3].tolist()), turns_deg)
        elevation = elevation + unknowns[7 + stops :][points.frame]
        horizon, slope, sigma = profile.at(azimuth, unknowns[4:7], place.dem_m)
        # Measured across the skyline: on a steep flank a small rotation makes a large difference in
        # elevation.
        across = np.sqrt(1.0 + (slope / np.cos(np.radians(elevation))) ** 2)
        return _Residuals(azimuth, elevation, (elevation - horizon) / across, sigma / across)

    def known(unknowns: Vector) -> Vector:
        return np.asarray((unknowns - priors_at) / prior_sigmas)

    def uncorrelated(unknowns: Vector) -> Vector:
        at = residuals(unknowns)
        return np.concatenate([at.residual_deg / np.hypot(points.sigma_deg, at.dem_deg), known(unknowns)])

    solved = solve(uncorrelated, first, loss="soft_l1")
    at = residuals(solved.unknowns)
    misfit_sigmas = MAD_TO_SIGMA * float(
        np.median(np.abs(at.residual_deg / np.hypot(points.sigma_deg, at.dem_deg)))
    )
    solved, dem_factor = _fit_with_correlations(residuals, known, points.sigma_deg, profile, solved.unknowns)
    at = residuals(solved.unknowns)
    misfit_deg = MAD_TO_SIGMA * float(np.median(np.abs(at.residual_deg)))
    together = np.zeros((3, len(first)))
    together[[0, 1, 2], [0, 1, 2]] = 1.0
    together[0, 3] = 1.0
    covariance = together @ solved.covariance @ together.T
    covariance[1, 1] += TRACED_SIGMA_DEG**2
    east_m, north_m, up_m = (float(x) for x in solved.unknowns[4:7])
    fit = BoresightFit(
        Attitude(*(wrapped_deg(float(x)) for x in solved.unknowns[:3])),
        wrapped_deg(float(solved.unknowns[3])),
        covariance,
        (east_m, north_m, up_m),
        misfit_deg,
        misfit_sigmas,
        dem_factor,
        points.frame,
        at.azimuth_deg,
        at.elevation_deg,
        at.residual_deg,
    )
    _require_place(fit, place)
    return fit


@dataclass(frozen=True)
class _Residuals:
    """Per point: observed azimuth and elevation, residual across the skyline, and the DEM's sigma there, degrees."""

    azimuth_deg: Vector
    elevation_deg: Vector
    residual_deg: Vector
    dem_deg: Vector


def _fit_with_correlations(
    residuals: Callable[[Vector], _Residuals],
    known: Callable[[Vector], Vector],
    image_deg: Vector,
    profile: HorizonProfile,
    start: Vector,
) -> tuple[Solved, float]:
    """The fit with correlated weights for points of the same ridge, and the DEM's error factor, from a close start."""
    unknowns = start
    for _ in range(ROUNDS):
        at = residuals(unknowns)
        alike = covariance_deg2(at.dem_deg, at.azimuth_deg, profile.distance(at.azimuth_deg))
        errors = fit_dem_error_model(at.residual_deg, image_deg, at.dem_deg, alike)
        whiten = errors.whiten

        def misfit(unknowns: Vector, whiten: Vector = whiten) -> Vector:
            return np.concatenate([whiten @ residuals(unknowns).residual_deg, known(unknowns)])

        solved = solve(misfit, unknowns)
        moved = np.abs(solved.unknowns - unknowns)[:4]
        unknowns = solved.unknowns
        if moved.max() < CONVERGED_DEG:
            break
    white = errors.whiten @ residuals(unknowns).residual_deg
    return Solved(unknowns, solved.covariance * max(1.0, float(np.mean(white**2)))), errors.dem_factor


def _inside_dem(
    frames: Sequence[SkylineFrame], profile: HorizonProfile, start: Attitude, shift_deg: float
) -> list[SkylineFrame]:
    """The frames without points where the skyline lies at the DEM's edge. ``CalibrationError`` if too little is left."""
    kept = []
    for frame in frames:
        azimuth, _ = Points([frame]).seen(start, np.full(len(frame.rays), shift_deg))
        known = ~profile.ends(azimuth)
        share = frame.share * float(known.mean()) if len(known) else 0.0
        kept.append(replace(frame, rays=frame.rays[known], sigma_deg=frame.sigma_deg[known], share=share))
    clear = sum(frame.share >= MIN_SHARE for frame in frames)
    usable = sum(frame.share >= MIN_SHARE for frame in kept)
    if usable < MIN_FRAMES:
        raise CalibrationError(
            f"boresight: in {clear - usable} of the {clear} frames that show a skyline it is where the DEM ends; take a larger"
        )
    return kept


def _require_skyline(frames: Sequence[SkylineFrame]) -> None:
    seeing = [frame for frame in frames if frame.share >= MIN_SHARE]
    if len(seeing) < MIN_FRAMES:
        shares = ", ".join(f"{frame.label} {frame.share:.0%}" for frame in frames)
        raise CalibrationError(
            f"boresight: the skyline shows in {len(seeing)} of {len(frames)} frames only ({shares} of the columns); "
            "wait until clouds and haze clear the ridge, and look at lens and light"
        )


def _require_place(fit: BoresightFit, place: PlaceSigmas) -> None:
    # Residuals of near ridges may exceed the limit and still agree with the DEM's error.
    unlike = fit.misfit_deg > MISFIT_LIMIT_DEG and fit.misfit_sigmas > 1.0
    if unlike or fit.misfit_sigmas > MISFIT_SIGMAS or fit.dem_factor > DEM_FACTOR_LIMIT:
        raise CalibrationError(
            f"boresight: the skyline is {fit.misfit_deg:.2f} deg ({fit.misfit_sigmas:.1f} sigma) off the DEM's at that place, "
            f"as if its ridges were {place.dem_m * fit.dem_factor:.1f} m off: this is another place, or cloud stands for the "
            "ridge; check --at and the sight, and calibrate again"
        )
    far_m = float(np.hypot(*fit.off_m[:2]))
    if far_m > PLACE_SIGMAS * place.horizontal_m:
        raise CalibrationError(
            f"boresight: the skyline fits better {far_m:.0f} m away (east {fit.off_m[0]:.0f}, north {fit.off_m[1]:.0f}); "
            "check --at, or say with --place-sigma how well it is known"
        )
    tilt_sigma_deg = float(np.sqrt(fit.covariance_deg2[1, 1]))
    if tilt_sigma_deg > TILT_SIGMA_LIMIT_DEG:
        raise CalibrationError(
            f"boresight: the ridges are so near that the DEM's error leaves the tilt uncertain by {tilt_sigma_deg:.2f} deg; "
            "drive where they are far: rig calibrate sites says where"
        )
