"""How the camera sits against head and sensors, from the skyline that a DEM has at a known place.

Unknown are the camera's azimuth, tilt and roll in the head and an error of the heading. Beside them, as well as they are known
beforehand: where exactly the camera stood, and each frame's own errors of azimuth and tilt. Camera azimuth and heading are told
apart by what is known of the compass only; their sum is measured.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from localizer.camera import azimuth_elevation_deg, camera_to_world
from rig.calibrate.horizon_profile import HorizonProfile
from rig.calibrate.solve import solve
from rig.calibration import CalibrationError
from rig.kinematics import Attitude, body_rotation, wrapped_deg

Vector = NDArray[np.float64]

SEARCH_STEP_DEG = 0.25
RIVAL_APART_DEG = 3.0
RIVAL_FACTOR = 1.3
LEAST_FRAMES = 3
LEAST_SHARE = 0.25
MISFIT_LIMIT_DEG = 0.2
MISFIT_SIGMAS = 3.0
PLACE_SIGMAS = 4.0
BORESIGHT_PRIOR_DEG = 30.0
MAD_TO_SIGMA = 1.4826
SEARCH_ROUNDS = 4


@dataclass(frozen=True)
class SkylineFrame:
    """One frame: the head as joints, heading and inclinometer say, and the skyline's rays (n, 3) in the camera with sigmas.

    ``share`` is the part of the columns that showed it. Sigmas of azimuth and tilt are this frame's own.
    """

    label: str
    head: Attitude
    rays: Vector
    sigma_deg: Vector
    share: float
    azimuth_sigma_deg: float
    tilt_sigma_deg: float


@dataclass(frozen=True)
class PlaceSigmas:
    """How well the place is known: horizontally and in altitude, metres, and the heights of the DEM."""

    horizontal_m: float
    altitude_m: float
    dem_m: float


@dataclass(frozen=True)
class BoresightFit:
    """The camera in the head, and by how much headings have to be corrected.

    ``covariance_deg2`` (3, 3) is of the sum of these two azimuths, of tilt and of roll. ``off_m`` is east, north, up of the
    place given. Per point: its frame's number, azimuth and elevation as seen, and what is left after the fit, degrees.
    """

    boresight: Attitude
    heading_offset_deg: float
    covariance_deg2: Vector
    off_m: tuple[float, float, float]
    misfit_deg: float
    misfit_sigmas: float
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
    """Fit. ``CalibrationError`` where the skyline is hidden, or is not the one that the DEM has there."""
    _require_skyline(frames)
    points = _Points(frames)
    search_deg = min(max(4.0 * heading_sigma_deg, 40.0), 180.0)
    shift_deg, tilt_deg, roll_deg = _search(points, profile, start, search_deg)
    n = len(frames)
    boresight = np.array([start.azimuth_deg, start.tilt_deg, start.roll_deg])
    # A large turn is the camera's as far as a camera can be turned in its head, the rest the heading's.
    of_camera_deg = shift_deg if abs(shift_deg) < 40.0 else 0.0
    first = np.concatenate(
        [
            boresight + np.array([of_camera_deg, tilt_deg, roll_deg]),
            [shift_deg - of_camera_deg, 0.0, 0.0, 0.0],
            np.zeros(2 * n),
        ]
    )
    prior_sigmas = np.concatenate(
        [
            np.full(3, BORESIGHT_PRIOR_DEG),
            [heading_sigma_deg, place.horizontal_m, place.horizontal_m, place.altitude_m],
            [frame.azimuth_sigma_deg for frame in frames],
            [frame.tilt_sigma_deg for frame in frames],
        ]
    )
    priors_at = np.concatenate([boresight, np.zeros(4 + 2 * n)])

    def left(unknowns: Vector) -> tuple[Vector, Vector, Vector, Vector]:
        turns_deg = unknowns[3] + unknowns[7 : 7 + n][points.frame]
        azimuth, elevation = points.seen(Attitude(*unknowns[:3].tolist()), turns_deg)
        elevation = elevation + unknowns[7 + n :][points.frame]
        horizon, slope, sigma = profile.at(azimuth, unknowns[4:7], place.dem_m)
        # Across the skyline: on a steep flank a small turn makes a large difference of heights.
        across = np.sqrt(1.0 + (slope / np.cos(np.radians(elevation))) ** 2)
        return azimuth, elevation, (elevation - horizon) / across, np.hypot(points.sigma_deg, sigma / across)

    def weighted(unknowns: Vector, doubt: float) -> Vector:
        _, _, residual, sigma = left(unknowns)
        return np.concatenate([residual / (sigma * doubt), (unknowns - priors_at) / prior_sigmas])

    solved = solve(lambda unknowns: weighted(unknowns, 1.0), first, loss="soft_l1")
    _, _, residual, sigma = left(solved.unknowns)
    misfit_sigmas = MAD_TO_SIGMA * float(np.median(np.abs(residual / sigma)))
    # Once more, each point with the weight that it has beside others that repeat it.
    doubt = float(np.sqrt(_repeated(residual / sigma, points.frame))) * max(1.0, misfit_sigmas)
    solved = solve(lambda unknowns: weighted(unknowns, doubt), solved.unknowns, loss="soft_l1")
    azimuth, elevation, residual, _ = left(solved.unknowns)
    misfit_deg = MAD_TO_SIGMA * float(np.median(np.abs(residual)))
    together = np.zeros((3, len(first)))
    together[[0, 1, 2], [0, 1, 2]] = 1.0
    together[0, 3] = 1.0
    east_m, north_m, up_m = (float(x) for x in solved.unknowns[4:7])
    fit = BoresightFit(
        Attitude(*(wrapped_deg(float(x)) for x in solved.unknowns[:3])),
        wrapped_deg(float(solved.unknowns[3])),
        together @ solved.covariance @ together.T,
        (east_m, north_m, up_m),
        misfit_deg,
        misfit_sigmas,
        points.frame,
        azimuth,
        elevation,
        residual,
    )
    _require_place(fit, place)
    return fit


class _Points:
    """The points of all frames, one after the other."""

    def __init__(self, frames: Sequence[SkylineFrame]) -> None:
        self.frame = np.concatenate([np.full(len(f.rays), i) for i, f in enumerate(frames)])
        self.sigma_deg = np.concatenate([f.sigma_deg for f in frames])
        self._rays = [f.rays for f in frames]
        self._heads = [body_rotation(f.head) for f in frames]

    def seen(self, boresight: Attitude, turn_deg: Vector) -> tuple[Vector, Vector]:
        """Azimuth (turned further by ``turn_deg``) and elevation of all points, for a camera that sits so in the head."""
        camera = camera_to_world(boresight.azimuth_deg, boresight.tilt_deg, boresight.roll_deg)
        world = np.concatenate([r @ (h @ camera).T for r, h in zip(self._rays, self._heads, strict=True)])
        azimuth, elevation = azimuth_elevation_deg(world)
        return azimuth + turn_deg, elevation

    @property
    def across(self) -> Vector:
        """How far right of the optical axis each point lies, as an angle in radians: what a roll lifts."""
        rays = np.concatenate(self._rays)
        return np.asarray(np.arctan2(rays[:, 0], rays[:, 2]))


def _search(
    points: _Points, profile: HorizonProfile, start: Attitude, within_deg: float
) -> tuple[float, float, float]:
    """Turn, tilt and roll (degrees) by which the skyline fits best, roughly. ``CalibrationError`` where two turns fit alike."""
    azimuth, elevation = points.seen(start, np.zeros(len(points.frame)))
    design = np.column_stack([np.ones(len(azimuth)), np.degrees(points.across)])
    shifts = np.arange(-within_deg, within_deg + SEARCH_STEP_DEG / 2, SEARCH_STEP_DEG)
    scores, levels = [], []
    for shift in shifts:
        difference = profile.elevation(azimuth + shift) - elevation
        weights = np.ones(len(difference))
        for _ in range(SEARCH_ROUNDS):  # least absolute differences
            weighted = design * (weights**2)[:, None]
            level = np.linalg.solve(design.T @ weighted, weighted.T @ difference)
            off = np.abs(difference - design @ level)
            weights = 1.0 / np.sqrt(np.maximum(off, 0.02))
        scores.append(float(np.median(off)))
        levels.append(level)
    best = int(np.argmin(scores))
    rivals = np.abs((shifts - shifts[best] + 180.0) % 360.0 - 180.0) > RIVAL_APART_DEG
    if rivals.any() and np.array(scores)[rivals].min() < RIVAL_FACTOR * scores[best]:
        raise CalibrationError(
            "boresight: the skyline fits no one direction better than the others: this is another place than given, or too "
            "little of the ridge is seen; check --at, wait for better sight, or drive where the skyline is rugged"
        )
    # A roll to the right lowers the right of the world in the camera's view, so the fit's sign is turned.
    return float(shifts[best]), float(levels[best][0]), -float(np.degrees(levels[best][1]))


def _repeated(residual: Vector, frame: NDArray[np.int64]) -> float:
    """How much neighbours repeat each other: 1 + 2 sum of the residuals' autocorrelations, while these are positive."""
    bounded = np.clip(residual - np.median(residual), -3.0, 3.0)
    total = float(np.mean(bounded**2))
    factor, lag = 1.0, 1
    while total > 0.0 and lag < 40:
        pairs = frame[lag:] == frame[:-lag]
        if not pairs.any():
            break
        correlation = float(np.mean((bounded[lag:] * bounded[:-lag])[pairs])) / total
        if correlation < 0.05:
            break
        factor += 2.0 * correlation
        lag += 1
    return factor


def _require_skyline(frames: Sequence[SkylineFrame]) -> None:
    seeing = [frame for frame in frames if frame.share >= LEAST_SHARE]
    if len(seeing) < LEAST_FRAMES:
        shares = ", ".join(f"{frame.label} {frame.share:.0%}" for frame in frames)
        raise CalibrationError(
            f"boresight: the skyline shows in {len(seeing)} of {len(frames)} frames only ({shares} of the columns); "
            "wait until clouds and haze clear the ridge, and look at lens and light"
        )


def _require_place(fit: BoresightFit, place: PlaceSigmas) -> None:
    if fit.misfit_deg > MISFIT_LIMIT_DEG or fit.misfit_sigmas > MISFIT_SIGMAS:
        raise CalibrationError(
            f"boresight: the skyline is {fit.misfit_deg:.2f} deg ({fit.misfit_sigmas:.1f} sigma) off the DEM's at that "
            "place: this is another place, or cloud stands for the ridge; check --at and the sight, and calibrate again"
        )
    far_m = float(np.hypot(*fit.off_m[:2]))
    if far_m > PLACE_SIGMAS * place.horizontal_m:
        raise CalibrationError(
            f"boresight: the skyline fits better {far_m:.0f} m away (east {fit.off_m[0]:.0f}, north {fit.off_m[1]:.0f}); "
            "check --at, or say with --place-sigma how well it is known"
        )
