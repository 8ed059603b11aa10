"""The Cramér-Rao lower bound of the position for these contours and sensors.

Computed from the simulator's geometry and the scenario's noise, without the localizer: the exact contour is
differentiated numerically by all unknowns, and the information of columns and sensors is added.

The unknowns are the place, the camera's height above the ground (the mast's, as far as the DEM is right), and the
sensors' errors. Place and ground move together, which matters where the slope itself is the skyline. The DEM's error at
the camera and at the skyline is part of the noise. Columns that show no terrain are assumed known and left out.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from sim.evaluate.disturb import Disturbed
from sim.evaluate.scenario import DemError, EvaluationScenario
from sim.evaluate.truth import NO_COMPASS_SIGMA_DEG, TrueFrame, Truth
from sim.world.contour import skyline_contour, undistorted
from sim.world.mechanics import camera_in_world
from sim.world.scenario import CameraOptics
from sim.world.surface import Observer, Surface

Array = NDArray[np.float64]

EAST, NORTH, HEIGHT, AZIMUTH_BIAS, TILT_BIAS, FIRST_FRAME = range(6)
STEP_M = 0.02  # short: near ground as skyline changes its slope within decimetres
STEP_DEG = 0.01
COLUMNS_EACH = 4  # one of these columns is differentiated and represents all
MIN_SIGMA_PX = 1e-3
MIN_SIGMA_DEG = 1e-6
UNKNOWN_M = 1e5  # no altimeter
GROUND_SIGMA_M = 0.001  # the mast's height is known
NEAR_CELLS = 2.0  # a DEM does not resolve nearer terrain, unless it is the true surface itself


@dataclass(frozen=True)
class Bound:
    """Covariances (2, 2) of true east and north, metres squared; None if the contours do not determine the place.

    ``free_altitude_m2`` ignores that the camera stands on the DEM's ground: altitude comes from the altimeter alone.
    ``far_horizon_m2`` omits columns whose horizon is nearer than NEAR_CELLS. ``wary_m2`` does both, like a search that
    trusts neither the DEM's ground under the camera nor near terrain.
    """

    covariance_m2: Array | None
    free_altitude_m2: Array | None
    far_horizon_m2: Array | None
    wary_m2: Array | None


def rms_m(covariance_m2: Array | None) -> float | None:
    """Root mean squared distance of a covariance."""
    return None if covariance_m2 is None else float(np.sqrt(np.trace(covariance_m2)))


def cramer_rao_bound(
    truth: Truth, scenario: EvaluationScenario, columns_px: Array, disturbed: Disturbed
) -> Bound:
    """The bound of one case at contour level."""
    parts = []
    for rows, genuine in zip(disturbed.rows_px, disturbed.genuine, strict=True):
        use = np.nonzero(np.isfinite(rows) & genuine)[0][COLUMNS_EACH // 2 :: COLUMNS_EACH]
        parts.append(columns_px[use])
    jacobian = contour_jacobian(truth, scenario.camera, parts)
    crests = _crests(truth, scenario.camera, parts)
    ok = np.isfinite(jacobian).all(axis=1) & np.isfinite(crests).all(axis=1)
    size = jacobian.shape[1]
    altimeter, ground_prior = np.zeros(size), np.zeros(size)
    altimeter[[EAST, NORTH]], altimeter[HEIGHT] = _ground_slope(truth.surface, truth.observer), 1.0
    ground_prior[HEIGHT] = 1.0  # the observation that the mast's foot is on the ground of the DEM
    altitude_sigma_m = scenario.errors.altitude_sigma_m if scenario.errors.altimeter else UNKNOWN_M
    noise = block_diag(
        _contour_noise(scenario, parts)[np.ix_(ok, ok)], np.diag([altitude_sigma_m, GROUND_SIGMA_M]) ** 2
    )
    if scenario.dem_error is not None:
        # Raising a crest by a metre is equivalent to lowering the camera by one.
        per_m = np.concatenate([jacobian[ok, HEIGHT], [0.0, 1.0]])
        places = np.vstack([crests[ok], np.zeros((2, 2))])
        noise += dem_error_covariance(scenario.dem_error, places) * np.outer(per_m, per_m)
    seen = np.vstack([jacobian[ok], altimeter, ground_prior])
    prior = _prior_information(scenario, size)
    near_m = NEAR_CELLS * float(np.mean(truth.surface.terrain.cell_size_m()))
    far = np.append(np.hypot(*crests[ok].T) >= near_m, [True, True])
    wary = np.append(far[:-1], False)
    return Bound(
        covariance_m2=position_covariance(seen, noise, prior),
        free_altitude_m2=position_covariance(seen[:-1], noise[:-1, :-1], prior),
        far_horizon_m2=position_covariance(seen[far], noise[np.ix_(far, far)], prior),
        wary_m2=position_covariance(seen[wary], noise[np.ix_(wary, wary)], prior),
    )


def position_covariance(jacobian: Array, noise: Array, prior: Array) -> Array | None:
    """Covariance (2, 2) of east and north; None if they are not determined.

    Args:
        jacobian: of the observations (n, m) by the unknowns, east and north first.
        noise: covariance (n, n) of the observations.
        prior: information (m,) that there is about each unknown without them.
    """
    information = jacobian.T @ np.linalg.solve(noise, jacobian) + np.diag(prior)
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-30))
    scaled = information * np.outer(scale, scale)
    if np.linalg.cond(scaled) > 1e13:
        return None
    covariance: Array = (np.linalg.inv(scaled) * np.outer(scale, scale))[:2, :2]
    return covariance


def contour_jacobian(truth: Truth, optics: CameraOptics, columns_px: list[Array]) -> Array:
    """Change of the contours' rows (n, 5 + 3 frames) by east, north, height (px/m), biases and frames' errors (px/deg).

    Errors are measured minus true; ``columns_px`` are those of each frame.
    """
    surface, here = truth.surface, truth.observer
    steps = [(STEP_M, 0.0, 0.0), (0.0, STEP_M, 0.0), (0.0, 0.0, STEP_M)]
    moved = [(_moved(surface, here, *step), _moved(surface, here, *(-s for s in step))) for step in steps]
    blocks = []
    for number, (frame, columns) in enumerate(zip(truth.frames, columns_px, strict=True)):
        block = np.zeros((len(columns), FIRST_FRAME + 3 * len(truth.frames)))
        for k, (ahead, behind) in enumerate(moved):
            block[:, k] = (
                skyline_contour(surface, ahead, optics, frame.rotation, columns)
                - skyline_contour(surface, behind, optics, frame.rotation, columns)
            ) / (2.0 * STEP_M)
        own = _by_attitude(surface, here, optics, frame, columns)
        block[:, FIRST_FRAME + 3 * number :][:, :3] = own
        block[:, AZIMUTH_BIAS], block[:, TILT_BIAS] = own[:, 0], own[:, 1]
        blocks.append(block)
    return np.vstack(blocks)


def _by_attitude(
    surface: Surface, here: Observer, optics: CameraOptics, frame: TrueFrame, columns: Array
) -> Array:
    """Derivatives by measured minus true azimuth, tilt and roll (n, 3)."""
    attitude = np.array([frame.attitude.heading_deg, frame.attitude.pitch_deg, frame.attitude.roll_deg])
    out = np.empty((len(columns), 3))
    for k, step in enumerate(np.eye(3) * STEP_DEG):
        ahead, behind = (
            skyline_contour(surface, here, optics, camera_in_world(*turned), columns)
            for turned in (attitude - step, attitude + step)
        )
        out[:, k] = (ahead - behind) / (2.0 * STEP_DEG)
    return out


def _moved(surface: Surface, here: Observer, east_m: float, north_m: float, up_m: float) -> Observer:
    """The observer moved along the ground, then up."""
    row, col = _lattice_at(surface, here, east_m, north_m)
    rise_m = surface.height(row, col) - surface.height(here.row, here.col)
    return surface.observer(row, col, here.altitude_m + rise_m + up_m)


def _lattice_at(surface: Surface, here: Observer, east_m: float, north_m: float) -> tuple[float, float]:
    azimuth = np.degrees(np.arctan2(east_m, north_m))
    row, col = surface.lattice(here, np.array([azimuth]), np.array([np.hypot(east_m, north_m)]))
    return float(row[0]), float(col[0])


def _ground_slope(surface: Surface, here: Observer) -> tuple[float, float]:
    """Rise of the ground per metre east and north."""

    def rise(east_m: float, north_m: float) -> float:
        ahead, behind = (_lattice_at(surface, here, s * east_m, s * north_m) for s in (1.0, -1.0))
        return (surface.height(*ahead) - surface.height(*behind)) / (2.0 * STEP_M)

    return rise(STEP_M, 0.0), rise(0.0, STEP_M)


def _prior_information(scenario: EvaluationScenario, size: int) -> Array:
    errors = scenario.errors
    sigma = np.full(size, np.inf)
    if errors.azimuth_bias_sigma_deg < NO_COMPASS_SIGMA_DEG:
        sigma[AZIMUTH_BIAS] = max(errors.azimuth_bias_sigma_deg, MIN_SIGMA_DEG)
    sigma[TILT_BIAS] = max(errors.tilt_bias_sigma_deg, MIN_SIGMA_DEG)
    own = [errors.azimuth_sigma_deg, errors.tilt_sigma_deg, errors.roll_sigma_deg]
    sigma[FIRST_FRAME:] = np.tile(np.maximum(own, MIN_SIGMA_DEG), (size - FIRST_FRAME) // 3)
    return np.asarray(sigma**-2.0)


def _contour_noise(scenario: EvaluationScenario, columns_px: list[Array]) -> Array:
    """Covariance (n, n), px^2, of the chosen columns, each representing COLUMNS_EACH."""
    errors = scenario.errors
    columns = np.concatenate(columns_px)
    frame_of = np.repeat(np.arange(len(columns_px)), [len(c) for c in columns_px])
    noise = max(errors.contour_sigma_px, MIN_SIGMA_PX) ** 2 / COLUMNS_EACH * np.eye(len(columns))
    if errors.contour_correlated_sigma_px > 0.0:
        apart = (columns[:, None] - columns[None, :]) / errors.contour_correlation_px
        same = frame_of[:, None] == frame_of[None, :]
        noise += errors.contour_correlated_sigma_px**2 * np.exp(-(apart**2)) * same
    return noise


def dem_error_covariance(error: DemError, places_m: Array) -> Array:
    """Covariance (n, n), m^2, of a DEM's errors at places (n, 2), east and north in metres."""
    apart2 = np.square(places_m[:, None] - places_m[None, :]).sum(axis=2)
    return np.asarray(error.rms_m**2 * np.exp(-apart2 / error.correlation_m**2))


def _crests(truth: Truth, optics: CameraOptics, columns_px: list[Array]) -> Array:
    """Position of the skyline's terrain (n, 2), metres east and north of the camera."""
    places = []
    intrinsics = np.array([optics.fx_px, optics.fy_px, optics.cx_px, optics.cy_px, *optics.distortion])
    for frame, columns in zip(truth.frames, columns_px, strict=True):
        rows = skyline_contour(truth.surface, truth.observer, optics, frame.rotation, columns)
        rays = np.array([[*undistorted(intrinsics, u, v), 1.0] for u, v in zip(columns, rows, strict=True)])
        east, north, _ = frame.rotation @ rays.reshape(-1, 3).T
        azimuth = np.arctan2(east, north)
        _, distance_m = truth.surface.horizon(truth.observer, np.degrees(azimuth))
        places.append(np.column_stack([np.sin(azimuth), np.cos(azimuth)]) * distance_m[:, None])
    return np.vstack(places)
